"""An organiser, from an empty folder to the first scored submission."""

import re
from pathlib import Path

from tests.support.processes import TOKEN, Laptop
from tests.support.serving import PRIVATE, submission_for
from tests.support.signing import receipt_in

OURS = """
title = "REVERIE at our lab"

[splits.test]
bundle = "bundles/our-test.npz"
visibility = "private"
quota = { day = 1, month = 2, year = 3 }
phases = [{ name = "always" }]
"""


def test_an_organiser_begins(tmp_path: Path, demo_world: Path) -> None:
    desk = Laptop(tmp_path, is_real=True)
    made = desk.run("server", "init", "lab")
    organiser = TOKEN.search(made.out)
    assert organiser is not None

    private = demo_world / "private" / "REVERIE_test.json"
    bundle = Path("lab/bundles/our-test.npz")
    desk.run("compile", demo_world, "--split", "test", "--annotations", private, "-o", bundle)
    (tmp_path / "lab" / "reverie-eval.toml").write_text(OURS)
    (tmp_path / bundle).chmod(0o644)
    refused = desk.run("server", "doctor", "--quick", "lab", status=1)
    assert f"chmod 600 {tmp_path / bundle}" in refused.out
    assert desk.run("serve", "lab", status=1).err.count("chmod 600") == 1
    (tmp_path / bundle).chmod(0o600)
    assert "fault" not in desk.run("server", "doctor", "--quick", "lab").out

    desk.run("server", "team", "add", "lab", "Walkers")
    desk.run("server", "person", "add", "lab", "Ada", "--team", "Walkers")
    token = desk.run("server", "token", "add", "lab", "Ada").out.strip()
    signed_in = {"REVERIE_EVAL_TOKEN": token}

    with desk.serving("lab") as server:
        (tmp_path / "submit.json").write_bytes(submission_for(PRIVATE))
        words = ["submit", "submit.json", "--split", "test", "--method", "First steps"]
        scored = desk.run(*words, "--server", server.url, variables=signed_in)
        assert re.search(r"\d+\.\d\d", scored.out)
        assert f"receipt: {tmp_path / 'submit.json'}" in scored.out or "receipt: " in scored.out
        (theirs,) = server.get("/submissions", organiser[0]).json()
        assert theirs["team"] == "Walkers"
        assert receipt_in(theirs["receipt"]).server == "REVERIE at our lab"
        (tmp_path / "again.json").write_bytes(submission_for(PRIVATE, seed=1))
        words[1] = "again.json"
        spent = desk.run(*words, "--server", server.url, status=2, variables=signed_in)
        assert "no submissions left" in spent.err
        desk.run("server", "grant", "lab", "Walkers", "test", "1", "--reason", "a broken night")
        desk.run(*words, "--server", server.url, variables=signed_in)

    recorded = desk.run("server", "audit", "lab").out.splitlines()
    actions = ["team added", "person added", "access token created"]
    expected = [*actions, *actions, "rules recorded", "submitted", "granted", "submitted"]
    done = [next((a for a in {*expected} if a in line), line) for line in recorded[1:]]
    assert done == expected
    assert "a broken night" in recorded[-2]
    assert "fault" not in desk.run("server", "doctor", "lab").out
