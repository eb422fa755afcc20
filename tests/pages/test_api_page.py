"""The page on the API says what the server does: its commands run, and no code is missing."""

import os
import re
import shutil
import subprocess
from pathlib import Path

from reverie_eval.schemas.service import Method, SubmissionChange
from tests.conftest import REPOSITORY, unavailable
from tests.support.participants import RealServer
from tests.support.serving import PRIVATE, submission_for

PAGE = (REPOSITORY / "docs" / "how-to" / "http-api.md").read_text()
_SET_BY_THE_READER = "export SERVER="


def commands() -> str:
    """Return the commands of the page, without those that say who the reader is."""
    blocks = re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
    return "\n".join(block for block in blocks if _SET_BY_THE_READER not in block)


def first_column(above: str) -> list[str]:
    """Return the names in the first column of the table with these headings."""
    table = PAGE.partition(above)[2].partition("\n\n")[0]
    firsts = re.findall(r"^\| (`.*?) \|", table, re.MULTILINE)
    return [name for first in firsts for name in re.findall(r"`(\w[\w-]*)`", first)]


def test_every_field_of_a_method_and_of_a_change_is_explained() -> None:
    assert first_column("| field | meaning |") == list(Method.model_fields)
    assert set(first_column("| field | what it does |")) == set(SubmissionChange.model_fields)


def test_the_commands_of_the_page_do_what_it_says(real_server: RealServer, tmp_path: Path) -> None:
    for tool in ("curl", "jq"):
        if shutil.which(tool) is None:
            unavailable(f"{tool} is not here")
    (tmp_path / "submit.json").write_bytes(submission_for(PRIVATE, seed=71))
    name = real_server.newcomer()
    words = {
        "SERVER": real_server.url,
        "TOKEN": real_server.mint(name),
        "INVITATION": real_server.mint(name, "invite"),
        "ORGANISER": real_server.mint(real_server.newcomer("organiser")),
    }
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", commands()],
        cwd=tmp_path,
        env=os.environ | words,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    assert '"is_repeat":true' in done.stdout  # the second upload of the file, by form
    assert '"name":"Walker 2"' in done.stdout
    assert "our disk was full" in done.stdout
    board = (tmp_path / "leaderboard.csv").read_text().splitlines()
    assert any("Walker 2" in row and f"Team of {name}" in row for row in board)
