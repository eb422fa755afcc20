"""A server whose open split is the home, and what the pages of its episodes say."""

import json
import re
from collections.abc import Mapping
from html import unescape
from pathlib import Path
from xml.etree import ElementTree as ET

import httpx
import pytest

from tests.support.home_world import OTHER_WALKS, WALKS, home_scores, records
from tests.support.serving import OPEN, OWNER, OpenServer, Serving
from tests.support.visiting import Visitor, signed_in


def visitor(server: Serving, who: str | None) -> Visitor:
    """Return somebody's browser."""
    return signed_in(server, who) if who else Visitor(server)


def walks(walked: Mapping[str, tuple[list[str], int]] = WALKS) -> bytes:
    return json.dumps(records(dict(walked))).encode()


@pytest.fixture
def home(open_server: OpenServer, folder: Path, tmp_path: Path) -> Serving:
    """Return a server whose open split is the home, where every outcome is known by hand."""
    home_scores(tmp_path, go_there="turn on the lamp")
    (folder / "bundles" / f"{OPEN}.npz").write_bytes((tmp_path / "home.npz").read_bytes())
    return open_server()


@pytest.fixture
def submission(home: Serving) -> str:
    return send(home, walks())


@pytest.fixture
def other(home: Serving) -> str:
    return send(home, walks(OTHER_WALKS), name="Other")


def send(server: Serving, content: bytes, who: str = OWNER, split: str = OPEN, **said: str) -> str:
    """Upload a submission and return its id."""
    reply = server.upload(who, content, split, **said)
    assert reply.status_code == 201, reply.text
    identity: str = reply.json()["submission"]["id"]
    return identity


def listed(reply: httpx.Response) -> list[str]:
    """Return the ids of the episodes on a page of the list."""
    assert reply.status_code == 200, reply.text
    return re.findall(r'<th scope="row"><a href="/episodes/[^"]*">([^<]*)</a></th>', reply.text)


def linked(reply: httpx.Response, way: str) -> str | None:
    """Return where the link to the episode before or after leads."""
    found = re.search(rf'<a rel="{way}" href="([^"]*)"', reply.text)
    return unescape(found[1]) if found else None


def picture(reply: httpx.Response) -> ET.Element:
    """Return the map on a page."""
    found = re.search(r'<svg class="episode-map[^"]* walkable".*?</svg>', reply.text, re.DOTALL)
    assert found
    return ET.fromstring(found[0])


def drawn(svg: ET.Element, kind: str) -> list[ET.Element]:
    return [each for each in svg.iter() if kind in each.get("class", "").split()]
