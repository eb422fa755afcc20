"""The tutorials lead where they say: every command runs, and prints what is shown below it."""

import re
import shlex
import sys
from collections.abc import Iterator
from io import StringIO

import pytest

from tests.conftest import REPOSITORY
from tests.support.processes import Laptop

TUTORIALS = REPOSITORY / "docs" / "tutorials"
ADDRESS = "http://127.0.0.1:8000"
STARTED_BY_HAND = ("python3", "pip", ".")


def steps(name: str) -> Iterator[tuple[list[str], str]]:
    """Return the commands of a tutorial, each with what the page shows below it."""
    text = (TUTORIALS / f"{name}.md").read_text()
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
