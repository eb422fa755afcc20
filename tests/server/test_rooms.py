"""The rooms of the server: the way of an upload through them, and those that can be left out."""

import inspect
import pkgutil
import re
import subprocess
import sys
import threading
from collections.abc import Collection
from pathlib import Path

from starlette.testclient import TestClient

import reverie_eval
from reverie_eval.server.app import create_app
from tests.conftest import REPOSITORY
from tests.support.serving import GOOD, OPEN, OWNER, Serving

LEFT_OUT = {"explore", "platforms"}
START = f"""
import sys
from datetime import datetime, timezone
from pathlib import Path
from starlette.testclient import TestClient
from reverie_eval.server.app import create_app
from reverie_eval.server.opening import open_server
from reverie_eval.server.operations.folder import make_server
from reverie_eval.server.settings import load_settings

folder = Path(sys.argv[1])
token = make_server(folder, now=datetime.now(timezone.utc), actor="test")
app = create_app(open_server(load_settings(folder)))
with TestClient(app, headers={{"Sec-Fetch-Site": "same-origin"}}) as client:
    for path in ("/", "/splits/{OPEN}", "/guide", "/healthz", "/episodes", "/play/{OPEN}"):
        print(path, client.get(path).status_code)
    client.post("/sign-in", data={{"token": token}})
    desk = client.get("/desk")
    print("/desk", desk.status_code, "Corrections" in desk.text)
"""


def linked(folder: Path, package: Path, without: Collection[str] = ()) -> None:
    """Make a folder with links to what is in another one, but for some."""
    folder.mkdir(parents=True)
    for each in package.iterdir():
        if each.name not in without:
            (folder / each.name).symlink_to(each)


def test_a_server_starts_without_rooms_that_nothing_needs(tmp_path: Path) -> None:
    package = Path(reverie_eval.__path__[0])
    linked(tmp_path / "reverie_eval", package, {"server"})
    linked(tmp_path / "reverie_eval" / "server", package / "server", LEFT_OUT)
    done = subprocess.run(
        [sys.executable, "-c", START, str(tmp_path / "lab")],
        cwd=tmp_path,
        env={"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.splitlines() == [
        "/ 200",
        f"/splits/{OPEN} 200",
        "/guide 200",
        "/healthz 200",
        "/episodes 404",
        f"/play/{OPEN} 404",
        "/desk 200 True",
    ], done.stderr


def test_an_upload_takes_the_steps_of_the_page(server: Serving) -> None:
    """They are called in the page's order, in the loop's thread and in those that it starts."""
    page = (REPOSITORY / "docs" / "explanation" / "architecture.md").read_text("utf-8")
    way = page.partition("### The way of an upload")[2].partition("\n## ")[0]
    steps = re.findall(r"^\| \d \| `([\w.]+)` \|", way, re.MULTILINE)
    assert len(steps) == 7
    codes = [
        inspect.unwrap(pkgutil.resolve_name(f"reverie_eval.{step}")).__code__ for step in steps
    ]
    called: dict[object, None] = {}
    threading.setprofile(lambda frame, *_: called.setdefault(frame.f_code))
    try:
        reply = TestClient(create_app(server.state)).post(
            f"/api/v1/splits/{OPEN}/submissions?name=Walker",
            content=GOOD,
            headers={"Authorization": f"Bearer {server.tokens[OWNER]}"},
        )
    finally:
        threading.setprofile(None)
    assert reply.status_code == 201, reply.text
    assert [code for code in called if code in codes] == codes
