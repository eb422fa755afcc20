"""What every page's reply carries, and that its HTML is sound, whoever looks."""

import re
from itertools import pairwise
from xml.etree import ElementTree as ET

import html5lib
import httpx
import pytest

from reverie_eval.server.app import create_app
from tests.support.demo_site import MARKUP, Site
from tests.support.page_routes import EXAMPLES, NO_PAGES, Example, page_routes
from tests.support.serving import NO_TLS, Serving
from tests.support.waiting import PATIENCE

HTML = "{http://www.w3.org/1999/xhtml}"
POLICY = {
    "default-src": "'none'",
    "script-src": "'self'",
    "style-src": "'self'",
    "img-src": "'self' data:",
    "connect-src": "'self'",
    "form-action": "'self'",
    "base-uri": "'none'",
    "frame-ancestors": "'none'",
}
"""Nothing of another host, nothing that is written in the page."""

every_page = pytest.mark.parametrize("example", EXAMPLES, ids=[each.name for each in EXAMPLES])


_replies: dict[tuple[str, Example], httpx.Response] = {}
_documents: dict[tuple[str, Example], ET.Element] = {}


def connect(site: Site) -> httpx.Client:
    return httpx.Client(base_url=site.url, timeout=PATIENCE, verify=NO_TLS)


def get(site: Site, example: Example) -> httpx.Response:
    """Return a page's reply, which several tests look at and none changes."""
    if (site.url, example) not in _replies:
        with connect(site) as client:
            if example.who is not None:
                client.post("/sign-in", data={"token": site.tokens[example.who]})
            _replies[site.url, example] = client.get(example.path(site))
    return _replies[site.url, example]


def parsed(site: Site, example: Example) -> ET.Element:
    """Read HTML as the standard has it, and accept no error in it."""
    if (site.url, example) not in _documents:
        document = html5lib.HTMLParser(strict=True).parse(get(site, example).text)
        _documents[site.url, example] = document
    return _documents[site.url, example]


def test_every_page_has_an_example(server: Serving) -> None:
    shown = {path for method, path in page_routes(create_app(server.state)) if method == "GET"}
    assert shown - NO_PAGES <= {each.route for each in EXAMPLES}


@every_page
def test_what_a_page_may_do(example: Example, site: Site) -> None:
    headers = get(site, example).headers
    rules = [rule.strip().partition(" ") for rule in headers["content-security-policy"].split(";")]
    assert {name: value for name, _, value in rules} == POLICY
    assert headers["content-type"] == "text/html; charset=utf-8"
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["referrer-policy"] == "same-origin"
    assert headers["x-frame-options"] == "DENY"
    assert headers["cache-control"] == "no-store"


@every_page
def test_sound_html(example: Example, site: Site) -> None:
    document = parsed(site, example)
    assert document.get("lang") == "en"
    title = document.findtext(f".//{HTML}title") or ""
    assert title.endswith(" - REVERIE evaluation server")
    levels = [
        int(each.tag[-1]) for each in document.iter() if re.fullmatch(f"{HTML}h[1-6]", each.tag)
    ]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(later <= earlier + 1 for earlier, later in pairwise(levels))
    ids = [each.get("id") for each in document.iter() if each.get("id")]
    assert len(ids) == len(set(ids))


@every_page
def test_nothing_is_written_in_the_page_that_runs_or_styles(example: Example, site: Site) -> None:
    document = parsed(site, example)
    for element in document.iter():
        written = [name for name in element.attrib if name == "style" or name.startswith("on")]
        assert written == []
        assert element.tag != f"{HTML}style"
    for script in document.iter(f"{HTML}script"):
        assert (script.get("src") or "").startswith("/static/") or script.get(
            "type"
        ) == "application/json"
    assert MARKUP not in get(site, example).text


@every_page
def test_every_field_has_a_label(example: Example, site: Site) -> None:
    document = parsed(site, example)
    labels = {each.get("for") for each in document.iter(f"{HTML}label")}
    inside = {field for label in document.iter(f"{HTML}label") for field in label.iter()}
    for kind in ("input", "select", "textarea"):
        for field in document.iter(f"{HTML}{kind}"):
            is_seen = field.get("type") not in ("hidden", "submit")
            is_named = field.get("id") in labels or field in inside or field.get("aria-label")
            assert is_named or not is_seen, ET.tostring(field)


@every_page
def test_what_a_page_needs_is_kept_for_a_year(example: Example, site: Site) -> None:
    document = parsed(site, example)
    needed = {
        each.get("src") or each.get("href") or ""
        for each in document.iter()
        if each.tag in (f"{HTML}script", f"{HTML}link", f"{HTML}img")
    }
    with connect(site) as client:
        for address in needed:
            if address.startswith("/static/"):
                reply = client.get(address)
                assert reply.status_code == 200
                assert reply.headers["cache-control"] == "public, max-age=31536000, immutable"
