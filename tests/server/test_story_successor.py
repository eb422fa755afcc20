"""A successor, who takes a server over from a backup that was made while it served."""

from pathlib import Path

from tests.support.processes import TOKEN, Laptop
from tests.support.serving import GOOD, PRIVATE, submission_for

BOARDS = [
    f"/splits/{split}/leaderboard{kind}"
    for split in ("test", "val_unseen")
    for kind in ("", ".csv", "?metric=success")
]


def test_a_successor_takes_over(tmp_path: Path) -> None:
    (tmp_path / "before").mkdir()
    (tmp_path / "after").mkdir()
    before, after = Laptop(tmp_path / "before"), Laptop(tmp_path / "after")
    made = before.run("server", "init", "lab")
    before.run("server", "team", "add", "lab", "Walkers")
    before.run("server", "person", "add", "lab", "Ada", "--team", "Walkers")
    token = before.run("server", "token", "add", "lab", "Ada").out.strip()
    signed_in = {"REVERIE_EVAL_TOKEN": token}
    (before.folder / "open.json").write_bytes(GOOD)
    (before.folder / "first.json").write_bytes(submission_for(PRIVATE, seed=1))
    (before.folder / "second.json").write_bytes(submission_for(PRIVATE, seed=2))
    with before.serving("lab") as server:
        for file, split in (("open", "val_unseen"), ("first", "test"), ("second", "test")):
            words = ["submit", f"{file}.json", "--split", split, "--method", file, "--publish"]
            before.run(*words, "--server", server.url, variables=signed_in)
        boards = {path: server.get(path).content for path in BOARDS}
        quota = server.get("/splits/test", token).json()["quota"]["windows"]
        before.run("server", "backup", "lab", "-o", "lab.tar.gz")
    (before.folder / "lab").rename(before.folder / "gone")

    after.run("server", "restore", before.folder / "lab.tar.gz", "lab")
    assert "fault" not in after.run("server", "doctor", "lab").out
    with after.serving("lab") as server:
        assert {path: server.get(path).content for path in BOARDS} == boards
        receipt = before.folder / "first.json.receipt.json"
        genuine = after.run("verify", receipt, "--server", server.url)
        assert "genuine" in genuine.out
        assert server.get("/splits/test", token).json()["quota"]["windows"] == quota
        assert server.upload(token, "test", submission_for(PRIVATE, seed=3)).status_code == 429
        assert server.upload(token, "test", submission_for(PRIVATE, seed=1)).json()["is_repeat"]
        organiser = TOKEN.findall(made.out)[0]
        assert len(server.get("/submissions", organiser).json()) == 3
        (first,) = [
            found["id"]
            for found in server.get("/submissions", token).json()
            if found["method"]["name"] == "first"
        ]
        kept = server.get(f"/submissions/{first}/file", token).content
        assert kept == submission_for(PRIVATE, seed=1)
