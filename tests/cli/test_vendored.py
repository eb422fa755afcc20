"""Other people's scripts in the package are what ``web/package-lock.json`` pins, with licences."""

import json

import pytest

from reverie_eval.server.http.rendering import STATIC_FOLDERS
from tests.conftest import REPOSITORY

VENDOR = REPOSITORY.joinpath("reverie_eval/server/http", STATIC_FOLDERS[0][1], "vendor")
BUNDLED = ("chart.js", "@kurkle/color")


@pytest.mark.parametrize("name", BUNDLED)
@pytest.mark.parametrize("file", ["chart.min.js", "chart.LICENSE.md"])
def test_a_file_says_where_its_content_is_from(file: str, name: str) -> None:
    lock = json.loads((REPOSITORY / "web" / "package-lock.json").read_text())
    package = lock["packages"][f"node_modules/{name}"]
    text = (VENDOR / file).read_text()
    assert f"{name} {package['version']} (npm), MIT\n{package['integrity']}" in text
