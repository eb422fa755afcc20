"""The participant's page: its session is what a session is, and its messages are the program's."""

import re
import sys
from collections.abc import Iterator
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import REPOSITORY
from tests.support.flat_world import Run
from tests.support.participants import RealServer
from tests.support.serving import PRIVATE, submission_for
from tests.support.signing import receipt_in

PAGE = (REPOSITORY / "docs" / "how-to" / "submit.md").read_text()
SERVER = "https://reverie.example.org"
PROMPT = "token or invitation: \n"
SOURCES = [
    *(REPOSITORY / "cli" / "reverie_eval_cli").rglob("*.py"),
    *(REPOSITORY / "reverie_eval" / "client").rglob("*.py"),
    *(REPOSITORY / "reverie_eval" / "server").rglob("*.py"),
    REPOSITORY / "reverie_eval" / "errors.py",
]


def session() -> Iterator[tuple[list[str], str]]:
    """Return the page's commands, each with what is shown below it."""
    text = PAGE.partition("```\n$ ")[2].partition("```")[0]
    for part in text.split("\n$ "):
        line, _, shown = part.partition("\n")
        words = line.partition(" > ")[0].split()[1:]
        yield words, "" if " > " in line else shown.removeprefix(PROMPT).rstrip("\n")


def timeless(text: str) -> str:
    """Blot out what is different every time: times, ids and digests."""
    text = re.sub(r"\d{4}-\d\d-\d\d( \d\d:\d\d:\d\d( \w+ \([^)]*\)| UTC))?", "TIME", text)
    return re.sub(r"\b([0-9a-f]{64}|[0-9a-f]{16})\b", "ID", text)


def test_the_session_is_what_is_shown(
    real_server: RealServer, at_home: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = real_server.newcomer()
    Path("submit.json").write_bytes(submission_for(PRIVATE))
    monkeypatch.setattr(sys, "stdin", StringIO(real_server.mint(name, "invite")))
    written = {
        real_server.url: SERVER,
        str(at_home): "~/.config/reverie-eval/logins.json",
        f"Team of {name}": "Blue",
        name: "Ada",
    }
    seen = []
    for words, expected in session():
        outcome = run(*(word.replace(SERVER, real_server.url) for word in words))
        assert outcome.status == 0, outcome.err
        shown = outcome.out
        for ours, theirs in written.items():
            shown = shown.replace(ours, theirs)
        if words[0] == "leaderboard":  # others have published, too
            assert "Ours" in shown
        elif expected:
            assert timeless(shown).rstrip("\n") == timeless(expected)
        seen.append(words[0])
    assert seen == ["login", "submit", "submit", "leaderboard", "verify"]


def test_the_notebook_s_lines_run(real_server: RealServer, at_home: Path) -> None:
    Path("submit.json").write_bytes(submission_for(PRIVATE))
    section = PAGE.partition("## In scripts and notebooks")[2]
    lines = section.partition("```python\n")[2].partition("```")[0]
    names: dict[str, Any] = {"token": real_server.mint(real_server.newcomer())}
    exec(lines.replace(SERVER, real_server.url), names)
    assert names["scores"]["spl"] == receipt_in(names["accepted"].submission.receipt).scores["spl"]


def test_every_message_that_is_explained_is_one() -> None:
    sources = "\n".join(source.read_text() for source in SOURCES)
    sources = re.sub(r'"\s*f?"', "", sources)  # strings over several lines
    explained = PAGE.partition("| message |")[2].partition("\n\n")[0].splitlines()[2:]
    assert len(explained) > 15
    for line in explained:
        for message in re.findall(r"`([^`]+)`", line.split("|")[1]):
            for part in re.split(r"\.\.\.|;|\d+", message.removeprefix("submission ")):
                assert part.strip("; ").removesuffix("s") in sources, message
