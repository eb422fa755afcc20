"""The tutorials lead where they say: every command runs, and prints what is shown below it."""

import re
import runpy
import shlex
import socket
import sys
from collections.abc import Iterator
from io import StringIO
from pathlib import Path
from subprocess import Popen

import pytest

from tests.conftest import REPOSITORY
from tests.support.ports import free_port
from tests.support.processes import Laptop
from tests.support.waiting import wait_until

TUTORIALS = REPOSITORY / "docs" / "tutorials"
ADDRESS = "http://127.0.0.1:8000"
FAKE_PORT = "8001"
STARTED_BY_HAND = ("python3", "pip", ".")


def page_of(name: str) -> str:
    return (TUTORIALS / f"{name}.md").read_text()


def steps(name: str) -> Iterator[tuple[list[str], str]]:
    """Return the commands of a tutorial, each with what the page shows below it."""
    text = page_of(name)
    for block, shown in re.findall(r"```sh\n(.*?)```\n(?:\n```\n(.*?)```)?", text, re.DOTALL):
        *others, last = block.splitlines()
        yield from ((shlex.split(line), "") for line in others)
        yield shlex.split(last), shown


def timeless(text: str) -> str:
    """Replace what is different every time: times, days, ids and digests."""
    text = re.sub(r"\d{4}-\d\d-\d\d( \d\d:\d\d:\d\d( \w+ \([^)]*\)| UTC))?", "TIME", text)
    return re.sub(r"\b([0-9a-f]{64}|[0-9a-f]{16})\b", "ID", text)


@pytest.mark.usefixtures("printed_protocols")
def test_scoring_a_first_file(laptop: Laptop) -> None:
    done = 0
    for (program, *words), shown in steps("score"):
        if program not in STARTED_BY_HAND:
            rejected = "demo/broken.json" in words
            outcome = laptop.run(*words, status=1 if rejected else 0)
            assert shown in outcome.out
            done += 1
    assert done == 6
    page = (TUTORIALS / "score.md").read_text()
    told = laptop.run("validate", "demo/broken.json", "--split", "val_unseen", status=1).err
    (lines,) = re.findall(r"Here are two of the 23:\n\n```\n(.*?)```", page, re.DOTALL)
    assert "23 problems" in told
    assert all(f"{line}\n" in told for line in lines.splitlines())


def test_submitting_to_a_server(laptop: Laptop, monkeypatch: pytest.MonkeyPatch) -> None:
    (serve, _), *others = steps("submit")
    assert serve == ["reverie-eval", "serve"]
    with laptop.serving() as server:
        printed = ""
        for (_, *words), shown in others:
            monkeypatch.setattr(sys, "stdin", StringIO(printed))  # `login` reads the invitation
            printed = laptop.run(*(word.replace(ADDRESS, server.url) for word in words)).out
            assert timeless(shown) in timeless(printed.replace(server.url, ADDRESS))


def save_files(page: str, folder: Path, port: str = "") -> None:
    """Write the files that a tutorial says to save, with a port that is free."""
    text = (TUTORIALS / f"{page}.md").read_text()
    for name, content in re.findall(
        r"ave [^`]* as `([\w.]+)`[^`]*```\w+\n(.*?)```", text, re.DOTALL
    ):
        (folder / name).write_text(content.replace(FAKE_PORT, port) if port else content)


def take_steps(page: str, laptop: Laptop, port: str = "") -> str:
    """Type what a tutorial says; return what was printed beside what the page shows."""
    said = ""
    for (program, *words), shown in steps(page):
        if program == "reverie-eval":
            outcome = laptop.run(*(word.replace(FAKE_PORT, port or FAKE_PORT) for word in words))
            assert shown in outcome.out
            said += outcome.err
        elif program == "tail":
            assert laptop.shell(f"{program} {' '.join(words)}").out.startswith('{"episode":')
        else:
            assert program in STARTED_BY_HAND
    return said


def test_a_first_agent(laptop: Laptop, capsys: pytest.CaptureFixture[str]) -> None:
    save_files("agent", laptop.folder)
    assert len((laptop.folder / "matching.py").read_text().splitlines()) <= 30
    said = take_steps("agent", laptop)
    (note,) = re.findall(r"what that was made from:\n\n```\n(.*?)\n```", page_of("agent"))
    assert note in said
    runpy.run_path(str(laptop.folder / "look.py"))
    (shown,) = (shown for words, shown in steps("agent") if words == ["python3", "look.py"])
    assert capsys.readouterr().out == shown


def test_a_language_model(laptop: Laptop) -> None:
    port = str(free_port())
    save_files("chat", laptop.folder, port)
    with Popen([sys.executable, laptop.folder / "fake_model.py"]) as model:
        try:
            wait_until(lambda: is_listening(int(port)))
            said = take_steps("chat", laptop, port)
        finally:
            model.kill()
    lines = re.findall(r"^(?:the agent read |[\d,]+ tokens).*$", page_of("chat"), re.MULTILINE)
    assert len(lines) == 3
    assert all(f"{line}\n" in said for line in lines)
    assert "nothing was left to run" in said


def is_listening(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port)).close()
    except OSError:
        return False
    return True
