"""A participant, twenty minutes before a deadline: from an invitation to a number in a paper."""

import json
import re
from pathlib import Path

import pytest

from reverie_eval.receipts import payload_of
from reverie_eval.schemas.service import Envelope
from tests.support.flat_world import Outcome
from tests.support.participants import Proxy, RealServer, installed
from tests.support.serving import PRIVATE, submission_for
from tests.support.signing import receipt_in, with_payload
from tests.support.terminals import ESCAPES, on_terminal

TIME = r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d"
BOTH_TIMES = rf"{TIME} CST \({TIME} UTC\)"
FAR_EAST = {"TZ": "CST-8"}


def broken(content: bytes) -> bytes:
    """Return a submission with three things wrong."""
    records = json.loads(content)
    records[1]["trajectory"] = []
    records[2]["predObjId"] = 3.5
    return json.dumps(records[:-1]).encode()


def result_of(outcome: Outcome) -> list[str]:
    """Return what is shown of a submission, but for how it came about."""
    assert outcome.status == 0, outcome.err
    repeat = "this file was already scored; no submission was used"
    return [line for line in outcome.out.splitlines() if line != repeat]


@pytest.mark.usefixtures("at_home")
def test_from_an_invitation_to_a_receipt(real_server: RealServer) -> None:
    name = real_server.newcomer()
    server = ["--server", real_server.url]

    # The organiser's invitation, typed unseen.
    invitation = real_server.mint(name, "invite")
    screen = on_terminal(300, "login", *server, answers={"token or invitation: ": invitation})
    assert f"signed in to {real_server.url} as {name} of Team of {name} (participant)" in screen
    assert invitation not in screen

    # A broken file: every problem at once, and nothing is spent.
    submission = Path("submit.json")
    submission.write_bytes(broken(submission_for(PRIVATE)))
    outcome = installed("submit", "submit.json", "--split", "test")
    first, *problems, last = outcome.err.splitlines()
    assert (outcome.status, outcome.out) == (1, "")
    assert first == "submit.json: submission rejected, 3 problems"
    assert [line.partition(": ")[0] for line in problems] == [
        "file",
        "[1].trajectory",
        "[2].predObjId",
    ]
    assert last == "nothing was scored, and no submission used"

    # A good one, on a terminal on the other side of the world.
    submission.write_bytes(submission_for(PRIVATE))
    command = ["submit", "submit.json", "--split", "test", "--method", "Ours"]
    screen = ESCAPES.sub("", on_terminal(100, *command, variables=FAR_EAST))
    assert "sending to http://127.0.0.1:" in screen  # the progress bar
    table, _, said = screen.partition("split:test|protocol:official-v1|data:")
    headings = ["TL m", "SR %", "OSR %", "SPL %", "RGS %", "RGSPL %"]
    assert re.findall(r"[A-Z]+ [m%]", table) == headings
    assert len(re.findall(r"\d+\.\d\d", table)) >= len(headings)
    assert re.search(rf": Ours, received {BOTH_TIMES}\nnot published: ", said)
    assert "receipt: submit.json.receipt.json\n" in said
    assert re.search(
        rf"submissions left on test: 1\n  1 of 2 per 24 hours; one more at {BOTH_TIMES}", said
    )

    # In a pipe, the same without the terminal's codes and without a bar.
    again = installed(*command)
    assert (again.status, again.err) == (0, "")
    assert "\x1b" not in again.out
    assert "this file was already scored; no submission was used" in again.out

    # The network fails when the next one has been scored. The command sends it again.
    Path("better.json").write_bytes(submission_for(PRIVATE, seed=1))
    command = ["submit", "better.json", "--split", "test", "--receipt", "receipt.json"]
    with Proxy(real_server.url, "reply") as proxy:
        token = {"REVERIE_EVAL_TOKEN": real_server.mint(name)}
        outcome = installed(*command, "--server", proxy.url, variables=token)
        assert len(proxy.uploads) == 2
    assert "the connection was dropped" in outcome.err
    assert "retrying in 0.5 s" in outcome.err
    shown = "\n".join(result_of(outcome)).replace(proxy.url, real_server.url)
    assert shown == "\n".join(result_of(installed(*command)))
    assert "submissions left on test: 0; next possible at " in shown

    # Nothing is left: a line that says when there will be something; what was scored is still told.
    Path("best.json").write_bytes(submission_for(PRIVATE, seed=2))
    outcome = installed("submit", "best.json", "--split", "test")
    assert (outcome.status, outcome.out) == (2, "")
    assert re.fullmatch(
        rf"reverie-eval: no submissions left; next possible at {TIME} .*\. "
        "Nothing was scored\n",
        outcome.err,
    )


@pytest.mark.usefixtures("at_home")
def test_a_number_in_a_paper_can_be_proven(
    real_server: RealServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = real_server.newcomer()
    monkeypatch.setenv("REVERIE_EVAL_SERVER", real_server.url)
    monkeypatch.setenv("REVERIE_EVAL_TOKEN", real_server.mint(name))
    Path("submit.json").write_bytes(submission_for(PRIVATE))
    command = ["submit", "submit.json", "--split", "test", "--receipt", "receipt.json"]
    assert installed(*command).status == 0

    # The number can be proven, and no other can.
    proven = installed("verify", "receipt.json", "--submission", "submit.json")
    assert proven.status == 0
    assert f"proven: the server received a file from Team of {name} at " in proven.out
    envelope = Envelope.model_validate_json(Path("receipt.json").read_text())
    receipt = receipt_in(envelope)
    scores = {**receipt.scores, "spl": receipt.scores["spl"] + 0.01}
    _, better = payload_of(receipt.model_copy(update={"scores": scores}))
    Path("forged.json").write_text(with_payload(envelope, better).model_dump_json())
    forged = installed("verify", "forged.json")
    assert (forged.status, forged.out) == (1, "")
    assert "the signature does not match: it was changed after it was signed" in forged.err

    # Nobody sees the result before it is published.
    assert f"Team of {name} " not in installed("leaderboard").out
    assert installed(*command, "--method", "Better", "--publish").status == 0
    (row,) = [x for x in installed("leaderboard").out.splitlines() if f"Team of {name} " in x]
    assert "Better" in row
