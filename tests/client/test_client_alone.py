"""What `pip install 'reverie-eval[client]'` installs is enough to submit."""

from pathlib import Path

from tests.conftest import SAMPLES
from tests.support.participants import RealServer
from tests.support.parts import run_alone

SUBMIT = ("submit", str(SAMPLES / "good.json"), "--split", "val_unseen", "--receipt", "r.json")


def test_a_participant_needs_nothing_of_the_server(
    real_server: RealServer, at_home: Path, tmp_path: Path
) -> None:
    (tmp_path / "token").write_text(real_server.mint(real_server.newcomer()))
    commands = [
        ("login", "--server", real_server.url),
        (*SUBMIT, "--method", "Ours", "--publish"),
        ("leaderboard", "--split", "val_unseen"),
        ("verify", "r.json"),
        (*SUBMIT, "--paper", "no link"),
    ]
    with (tmp_path / "token").open() as token:
        *outcomes, wrong = run_alone(commands, tmp_path, ["client"], stdin=token)
    assert [status for status, _, err in outcomes] == [0] * 4, outcomes
    assert wrong == (2, "", "reverie-eval: --paper: must be a link that begins with https://\n")
    assert at_home.exists()
