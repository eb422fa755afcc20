"""Rooms of the server that nothing else needs can be left out."""

import subprocess
import sys
from collections.abc import Collection
from pathlib import Path

import reverie_eval
from tests.support.serving import OPEN

LEFT_OUT = {"explore", "integrity", "platforms"}
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
    print("/desk", desk.status_code, "Evidence" in desk.text, "Corrections" in desk.text)
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
        "/desk 200 False True",
    ], done.stderr
