"""Several leaderboards of a split: one upload is ranked on each by its own rules."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy.orm import Session

from reverie_eval.ground_truth import Bundle
from reverie_eval.receipts import verify
from reverie_eval.schemas.service import Envelope, Phase
from reverie_eval.server.audit.rows import mismatches
from reverie_eval.server.audit.transactions import utc_now
from reverie_eval.server.corrections.corrections import count_outdated
from reverie_eval.server.opening import acting
from reverie_eval.server.operations.checks import check_folder
from reverie_eval.server.operations.doctor import examine
from reverie_eval.server.platforms.export import export
from reverie_eval.server.scoring.boards import Board, load_boards
from reverie_eval.server.settings import SETTINGS_FILE, SettingsError, load_settings
from reverie_eval.server.store.tables import Submission
from tests.conftest import SAMPLES
from tests.support.correcting import rescored
from tests.support.flat_world import Run
from tests.support.serving import (
    GOOD,
    GROUNDING,
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    STRICT,
    OpenServer,
    Serving,
    add_boards,
    populate,
    running,
    settings_of,
    submission_for,
)
from tests.support.signing import receipt_in
from tests.support.visiting import signed_in
from tests.support.worlds import with_arrays

MEDIOCRE = (SAMPLES / "mediocre.json").read_bytes()


def sent(server: Serving, content: bytes = GOOD, who: str = OWNER, **more: str) -> dict[str, Any]:
    """Submit a file, and return the submission."""
    reply = server.upload(who, content, **more)
    assert reply.status_code == 201, reply.text
    submission: dict[str, Any] = reply.json()["submission"]
    return submission


def publish(server: Serving, submission: dict[str, Any], who: str = OWNER, **change: Any) -> None:
    path = f"/submissions/{submission['id']}"
    reply = server.ask(who, "PATCH", path, json=change or {"published": True})
    assert reply.status_code == 200, reply.text


def shown(server: Serving, submission: dict[str, Any], who: str = OWNER) -> dict[str, Any]:
    found: dict[str, Any] = server.ask(who, "GET", f"/submissions/{submission['id']}").json()
    return found


def board(server: Serving, name: str = "", split: str = OPEN) -> dict[str, Any]:
    place = f"/boards/{name}" if name else ""
    reply = server.ask(None, "GET", f"/splits/{split}{place}/leaderboard")
    assert reply.status_code == 200, reply.text
    found: dict[str, Any] = reply.json()
    return found


def test_one_upload_is_scored_by_the_rules_of_each(several: Serving) -> None:
    """By hand, as README has them: RGS is 40.48 or 28.57; in all, 34 of 84 answers are right."""
    before = several.ask(OWNER, "GET", f"/splits/{OPEN}").json()["quota"]["remaining"]
    submission = sent(several, MEDIOCRE)
    after = several.ask(OWNER, "GET", f"/splits/{OPEN}").json()["quota"]["remaining"]
    assert (before - after, len(several.ask(OWNER, "GET", "/submissions").json())) == (1, 1)
    others = submission["boards"]
    assert list(others) == [GROUNDING, STRICT]
    assert submission["report"]["scores"]["rgs"] == 34 / 84
    assert others[STRICT]["report"]["scores"]["rgs"] == 24 / 84
    assert others[GROUNDING]["report"]["scores"] == {"rgs": 34 / 84}
    assert [each["report"]["protocol"] for each in others.values()] == ["official-v1", "paper"]
    assert "|track:grounding|" in others[GROUNDING]["report"]["signature"]


def test_every_receipt_proves_its_own_result(several: Serving) -> None:
    submission = sent(several)
    own = receipt_in(submission["receipt"])
    for name, result in submission["boards"].items():
        path = f"/submissions/{submission['id']}/boards/{name}/receipt"
        envelope = Envelope.model_validate(several.ask(OWNER, "GET", path).json())
        verify(envelope, several.state.signer.public_pem)
        receipt = receipt_in(envelope)
        assert (receipt.signature, receipt.scores) == (
            result["report"]["signature"],
            result["report"]["scores"],
        )
        different = {"signature": own.signature, "scores": own.scores}
        assert receipt.model_copy(update=different) == own
    missing = several.ask(OWNER, "GET", f"/submissions/{submission['id']}/boards/none/receipt")
    assert (missing.status_code, "it has results on: grounding" in missing.text) == (404, True)


def test_publishing_and_withdrawing_apply_to_all(several: Serving) -> None:
    first, second = sent(several, MEDIOCRE), sent(several, who=OTHER)
    assert board(several, STRICT)["rows"] == []
    publish(several, first)
    publish(several, second, OTHER, published=True, anonymous_until="2026-12-01T00:00:00Z")
    for name, metric in (("", "rgspl"), (GROUNDING, "rgs"), (STRICT, "rgspl")):
        found = board(several, name)
        assert (found["board"], found["metric"]) == (name, metric)
        assert [(row["rank"], row["team"]) for row in found["rows"]] == [(1, ""), (2, "Blue")]
        assert {row["signature"] for row in found["rows"]} == {found["signature"]}
    intervals = board(several, STRICT)["rows"][0]["intervals"]
    low, high = intervals["rgs"]
    assert low < board(several, STRICT)["rows"][0]["scores"]["rgs"] < high
    publish(several, second, OTHER, withdrawn=True)
    assert [len(board(several, name)["rows"]) for name in ("", GROUNDING, STRICT)] == [1, 1, 1]


def test_a_file_without_answers_is_ranked_where_it_can_be(several: Serving) -> None:
    records = [{**record} for record in json.loads(GOOD)]
    for record in records:
        del record["predObjId"]
    submission = sent(several, json.dumps(records).encode(), navigation_only="true")
    result = submission["boards"][GROUNDING]
    assert result["report"]["scores"] == {}
    (note,) = result["report"]["notes"]
    assert note.startswith("this file cannot be ranked here: no record has an answer")
    publish(several, submission)
    assert [len(board(several, name)["rows"]) for name in ("", GROUNDING, STRICT)] == [1, 0, 1]
    for visitor in (signed_in(several, OWNER), several.client):
        page = visitor.get(f"/submissions/{submission['id']}").text
        assert "grounding: this file cannot be ranked here: no record has an answer" in page
    assert [
        each.what for each in examine(several.state.settings.folder) if each.kind == "fault"
    ] == []


def test_pages_of_another_leaderboard(several: Serving) -> None:
    publish(several, sent(several))
    own = several.client.get(f"/splits/{OPEN}").text
    assert f'href="/splits/{OPEN}/boards/{GROUNDING}"' in own
    place = f"/splits/{OPEN}/boards/{GROUNDING}"
    for part in ("", "?columns=all&metric=rgs", "/chart?x=rgs", "/latex", "/bibtex", "/feed.atom"):
        reply = several.client.get(f"{place}{part}")
        assert (reply.status_code, "65.48" in reply.text) == (200, part != "/bibtex"), part
    page = several.client.get(place).text
    assert f"{OPEN}, {GROUNDING} leaderboard" in page
    assert f'href="/api/v1/splits/{OPEN}/boards/{GROUNDING}/leaderboard.csv"' in page
    assert "track:grounding" in several.client.get(f"{place}/latex").text
    for path in (f"/splits/{OPEN}/boards/none", f"/api/v1/splits/{OPEN}/boards/none/leaderboard"):
        reply = several.client.get(path)
        assert (reply.status_code, "its other leaderboards: grounding, strict" in reply.text) == (
            404,
            True,
        )
    wrong = several.client.get(f"{place}?metric=none")
    assert (wrong.status_code, f'href="{place}"' in wrong.text) == (400, True)


def test_private_results_are_rounded_and_held_back_on_all(
    folder: Path, open_server: OpenServer
) -> None:
    add_boards(folder, PRIVATE)
    settings = settings_of(folder)
    phase = Phase(name="2026", closes="2026-06-01")
    held = settings.splits[PRIVATE].model_copy(
        update={"phases": (phase,), "release_scores": "phase-end"}
    )
    splits = {**settings.splits, PRIVATE: held}
    server = open_server(settings.model_copy(update={"splits": splits}))
    submission = sent(server, submission_for(PRIVATE), split=PRIVATE)
    publish(server, submission)
    for each in (submission, shown(server, submission)):
        for result in (each, *each["boards"].values()):
            assert result["report"]["scores"] == receipt_in(result["receipt"]).scores == {}
            verify(Envelope.model_validate(result["receipt"]), server.state.signer.public_pem)
    assert board(server, STRICT, PRIVATE)["rows"][0]["scores"] == {}
    server.clock.turn(days=200)
    others = shown(server, submission)["boards"]
    for name, result in others.items():
        scores = result["report"]["scores"]
        assert scores, name
        assert scores == {
            key: round(value, 2 if key == "path_length" else 4) for key, value in scores.items()
        }
        assert board(server, name, PRIVATE)["rows"][0]["scores"] == scores


# Leaderboards that are added, changed and removed.


def grown(server: Serving, folder: Path, open_server: OpenServer) -> Serving:
    """Let two teams submit, and return the server with other leaderboards after that."""
    publish(server, sent(server, MEDIOCRE))
    publish(server, sent(server, who=OTHER), OTHER)
    add_boards(folder, OPEN)
    return open_server(settings_of(folder, server.state.settings.database), server.tokens)


@pytest.fixture
def added(server: Serving, folder: Path, open_server: OpenServer) -> Serving:
    """Return a server that got other leaderboards after two teams had submitted."""
    return grown(server, folder, open_server)


def test_an_added_leaderboard_is_filled_by_scoring_again(added: Serving, folder: Path) -> None:
    notes = [each.what for each in check_folder(folder) if each.kind == "note"]
    assert [
        f"no result on {name} under the current ground truth" in each
        for name, each in zip((GROUNDING, STRICT), notes, strict=True)
    ] == [True, True]
    before = board(added)
    corrections = signed_in(added, ORGANISER).get("/desk/corrections")
    assert "4 results to be scored again" in corrections.text
    assert rescored(added, reason="More leaderboards.") == (4, {})
    assert board(added) == before
    fresh = sent(added, GOOD + b" ", who=OTHER)
    for name in (GROUNDING, STRICT):
        found = board(added, name)
        assert [row["rank"] for row in found["rows"]] == [1, 2]
        assert found["corrections"] == []
        scores = fresh["boards"][name]["report"]["scores"]
        assert found["rows"][0]["scores"] == scores
        assert "rgs" in found["rows"][0]["intervals"]
    with added.state.database.reading() as session:
        assert list(mismatches(session)) == []
    assert [each.what for each in examine(folder) if each.kind == "fault"] == []


def outdated_on(session: Session, own: Board) -> list[int]:
    return [count_outdated(session, each) for each in own.all]


def test_both_kinds_of_database_find_what_is_missing(
    server_on: Serving, folder: Path, open_server: OpenServer
) -> None:
    added = grown(server_on, folder, open_server)
    own = added.state.board(OPEN)
    with added.state.database.reading() as session:
        assert outdated_on(session, own) == [0, 2, 2]
    rescored(added)
    with added.state.database.reading() as session:
        assert outdated_on(session, own) == [0, 0, 0]
    assert [row["rank"] for row in board(added, STRICT)["rows"]] == [1, 2]


def test_a_change_of_rules_keeps_both_results(
    added: Serving, folder: Path, open_server: OpenServer
) -> None:
    rescored(added)
    text = (folder / SETTINGS_FILE).read_text().replace('protocol = "paper"', 'protocol = "duet"')
    (folder / SETTINGS_FILE).write_text(text)
    later = open_server(settings_of(folder), added.tokens)
    assert [row["standing"] for row in board(later, STRICT)["apart"]] == ["other-rules"] * 2
    assert rescored(later, reason="More leaderboards.") == (2, {})
    found = board(later, STRICT)
    assert [row["rank"] for row in found["rows"]] == [1, 2]
    assert [each["board"] for each in found["corrections"]] == [STRICT]
    assert board(later)["corrections"] == []
    for submission in later.ask(ORGANISER, "GET", "/submissions").json():
        assert submission["earlier"] == []
        (earlier,) = submission["boards"][STRICT]["earlier"]
        assert earlier["report"]["protocol"] == "paper"
        verify(Envelope.model_validate(earlier["receipt"]), later.state.signer.public_pem)
        page = signed_in(later, ORGANISER).get(f"/submissions/{submission['id']}").text
        assert "Scored again because: More leaderboards." in page


def test_a_file_that_fits_no_longer_keeps_all_results(
    several: Serving, folder: Path, open_server: OpenServer
) -> None:
    submission = sent(several)
    place = folder / "bundles" / f"{OPEN}.npz"
    bundle = Bundle.load(place)
    names = bundle.arrays["instr_id"].copy()
    names[0] = "1_9_9"
    with_arrays(bundle, instr_id=names).save(place)
    later = open_server(settings_of(folder), several.tokens)
    scored, rejected = rescored(later)
    assert (scored, [*rejected]) == (0, [submission["id"]])
    assert shown(later, submission)["boards"] == submission["boards"]


def test_the_command_fills_and_prints_each_leaderboard(
    added: Serving, folder: Path, run: Run
) -> None:
    preview = run("server", "rescore", str(folder), OPEN, "--dry-run")
    done = run("server", "rescore", str(folder), OPEN, "--reason", "More leaderboards.")
    assert (done.status, done.out) == (0, preview.out), done.err
    _, grounding, strict = done.out.split("\n\n")
    assert grounding.startswith(GROUNDING)
    assert "65.48" in grounding
    assert strict.startswith(STRICT)
    assert "- -> 1" in strict
    assert [row["rank"] for row in board(added, STRICT)["rows"]] == [1, 2]


def test_a_removed_leaderboard_leaves_results_to_their_teams(
    several: Serving, folder: Path, open_server: OpenServer
) -> None:
    submission = sent(several)
    publish(several, submission)
    text = (folder / SETTINGS_FILE).read_text()
    (folder / SETTINGS_FILE).write_text(text[: text.index("[splits.val_unseen.boards")])
    later = open_server(settings_of(folder), several.tokens)
    assert shown(later, submission)["boards"] == shown(several, submission)["boards"]
    page = later.client.get(f"/submissions/{submission['id']}").text
    assert "/boards/" not in page


# What has to know of all results.


def test_a_revoked_key_signs_none_of_them(several: Serving, folder: Path, run: Run) -> None:
    sent(several)
    assert run("server", "key", "rotate", str(folder), "--reason", "a leak").status == 0
    since = several.clock.now.replace(day=1).isoformat().replace("+00:00", "Z")
    key = several.state.signer.key_id
    words = ["server", "key", "revoke", str(folder), key, "--since", since, "--reason", "a leak"]
    done = run(*words)
    assert done.status == 0, done.err
    faults = [each.what for each in examine(folder) if each.kind == "fault"]
    assert faults == []


def test_the_doctor_and_the_check_look_at_all_of_them(several: Serving, folder: Path) -> None:
    submission = sent(several, submission_for(PRIVATE), split=PRIVATE)
    with several.state.database.writing() as session:
        row = session.get_one(Submission, submission["id"])
        result = row.results[STRICT]
        report = result.report.model_copy(update={"scores": {"rgs": 1 / 3}})
        row.store_result(STRICT, result.model_copy(update={"report": report}))
    faults = {each.check: each.what for each in examine(folder) if each.kind == "fault"}
    assert "exact values of 1 result were stored" in faults["secrets"]
    assert "the receipt differs from its row" in faults["receipts"]


def test_exports_have_every_leaderboard(
    folder: Path, open_server: OpenServer, tmp_path: Path
) -> None:
    add_boards(folder, PRIVATE)
    server = open_server()
    publish(server, sent(server, submission_for(PRIVATE), split=PRIVATE))
    tables = export(folder, tmp_path / "t")
    rows = {table.name: table.rows for table in tables}
    names = ["", GROUNDING, STRICT]
    assert [each["board"] for each in rows["leaderboards"] if each["split"] == PRIVATE] == names
    assert [each["board"] for each in rows["results"]] == names


@pytest.mark.usefixtures("at_home")
def test_what_participants_type(folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    add_boards(folder, OPEN)
    with acting(load_settings(folder), "test", utc_now) as transaction:
        token = populate(transaction, {OWNER: "Blue"})[OWNER]
    Path("submit.json").write_bytes(MEDIOCRE)
    with running(folder) as (_, url):
        monkeypatch.setenv("REVERIE_EVAL_SERVER", url)
        monkeypatch.setenv("REVERIE_EVAL_TOKEN", token)
        words = ["submit", "submit.json", "--split", OPEN, "--publish"]
        done, again = run(*words), run(*words)
        assert (done.status, again.status) == (0, 0), done.err
        names = [f"submit.json{name}.receipt.json" for name in ("", ".grounding", ".strict")]
        for name in names:
            assert f"receipt: {name}" in done.out
            assert f"receipt: {name}" in again.out
        assert sorted(path.name for path in Path().glob("submit*")) == sorted(
            ["submit.json", *names]
        )
        verified = run("verify", names[2], "--submission", "submit.json")
        assert (verified.status, "28.57" in verified.out) == (0, True), verified.err
        assert "|protocol:paper|" in verified.out
        answers = run("leaderboard", "--split", OPEN, "--board", GROUNDING)
        assert "|protocol:official-v1|track:grounding|" in answers.out, answers.err
        ranking = run("leaderboard", "--split", OPEN, "--board", STRICT)
        assert (ranking.status, "28.57" in ranking.out) == (0, True), ranking.err
        wrong = run("leaderboard", "--split", OPEN, "--board", "none")
    assert wrong.status == 2
    assert "its other leaderboards: grounding, strict" in wrong.err
    own, _, rest = done.out.partition(f"\n\n{GROUNDING}\n")
    grounding, _, strict = rest.partition(f"\n\n{STRICT}\n")
    assert ("40.48" in own, "40.48" in grounding, "28.57" in strict) == (True, True, True)


# The settings.


@pytest.mark.parametrize(
    ("rules", "said"),
    [
        pytest.param(
            'boards = { again = { track = "full" } }',
            "boards.again has the protocol and the track of the split",
            id="the split's own rules",
        ),
        pytest.param(
            'boards = { one = { protocol = "hamt" }, two = { protocol = "duet" } }',
            "boards.two has the protocol and the track of boards.one",
            id="the rules of another, by an alias",
        ),
        pytest.param(
            'boards = { one = { protocol = "dutch" } }', "unknown protocol 'dutch'", id="protocol"
        ),
        pytest.param(
            'boards = { one = { track = "half" } }', "boards.one.track: got 'half'", id="track"
        ),
        pytest.param(
            "boards = { one = { rules = 1 } }", "boards.one.rules: is not a setting", id="key"
        ),
        pytest.param(
            'boards = { "A/B" = { track = "grounding" } }', "'A/B' must have up to 40", id="name"
        ),
        pytest.param(
            'boards = { one = { track = "grounding", protocol = "r2r-style" } }',
            "boards.one: r2r-style does not score grounding",
            id="no score",
        ),
    ],
)
def test_rules_that_cannot_be(folder: Path, rules: str, said: str) -> None:
    file = folder / SETTINGS_FILE
    text = file.read_text().replace("[splits.val_unseen]\n", f"[splits.val_unseen]\n{rules}\n")
    file.write_text(text)
    with pytest.raises(SettingsError, match=re.escape(said)):
        load_boards(load_settings(folder))


def test_the_check_says_what_a_private_split_gives_away(folder: Path) -> None:
    """By hand: SR, OSR and RGS; RGS in the grounding track; all three by the paper's rules."""
    add_boards(folder, PRIVATE)
    (note,) = [each.what for each in check_folder(folder) if each.kind == "note"]
    assert "2 other leaderboards: a submission reveals up to 7 counts" in note
    assert "a year's 40 submissions reveal up to 280 outcomes of" in note
    assert "instead of 120 (documentation: Security)" in note
