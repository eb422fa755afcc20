"""Leaderboards that show one result per team: the one that it publishes last."""

from pathlib import Path

import pytest

from reverie_eval.server.operations.checks import check_folder
from tests.support.acting import review
from tests.support.serving import (
    OPEN,
    OTHER,
    OWNER,
    PRIVATE,
    OpenServer,
    Serving,
    adjusted,
    settings_of,
)
from tests.support.visiting import said, signed_in


@pytest.fixture
def strict(folder: Path, open_server: OpenServer) -> Serving:
    """Return a server whose open split shows one result per team."""
    return open_server(adjusted(settings_of(folder), OPEN, one_per_team=True))


def change(server: Serving, submission: str, who: str = OWNER, **changes: bool) -> None:
    assert server.ask(who, "PATCH", f"/submissions/{submission}", json=changes).status_code == 200


def publish(server: Serving, who: str = OWNER, split: str = OPEN) -> str:
    reply = server.upload(who, server.distinct(split), split)
    submission: str = reply.json()["submission"]["id"]
    change(server, submission, who, published=True)
    return submission


def shown(server: Serving, split: str = OPEN) -> set[str]:
    board = server.ask(None, "GET", f"/splits/{split}/leaderboard").json()
    return {row["submission_id"] for row in [*board["rows"], *board["apart"]]}


def test_the_one_that_is_published_last_stands(strict: Serving) -> None:
    first, others, second = publish(strict), publish(strict, OTHER), publish(strict)
    assert shown(strict) == {others, second}
    told = strict.ask(OWNER, "GET", f"/submissions/{first}").json()
    assert told["status"] == "unpublished"
    assert told["report"]["scores"]
    page = said(signed_in(strict, OWNER).get(f"/submissions/{first}"))
    assert "the leaderboard shows one result per team, the one that you publish last" in page
    assert "unpublished, by Ada" in page
    change(strict, first, published=True)
    assert shown(strict) == {others, first}
    assert strict.ask(None, "GET", f"/splits/{OPEN}").json()["one_per_team"] is True


def test_a_restored_one_stands_in_place_of_the_other(strict: Serving) -> None:
    first = publish(strict)
    change(strict, first, withdrawn=True)
    second = publish(strict)
    assert shown(strict) == {second}
    change(strict, first, withdrawn=False)
    assert shown(strict) == {first}


def test_a_disqualified_one_stays_visible(strict: Serving) -> None:
    first = publish(strict)
    with strict.acting() as transaction:
        review(transaction, first, "disqualified")
    second = publish(strict)
    assert shown(strict) == {first, second}


def test_other_splits_and_changes_leave_all(strict: Serving) -> None:
    both = {publish(strict, split=PRIVATE), publish(strict, split=PRIVATE)}
    assert shown(strict, PRIVATE) == both
    first, second = publish(strict), strict.upload(OWNER, strict.distinct()).json()["submission"]
    path = f"/submissions/{second['id']}"
    strict.ask(OWNER, "PATCH", path, json={"method": {"name": "Renamed"}})
    change(strict, second["id"], withdrawn=True)
    change(strict, second["id"], withdrawn=False)
    assert shown(strict) == {first}


def test_results_from_before_the_rule_are_noted(server: Serving, folder: Path) -> None:
    publish(server), publish(server)
    file = folder / "reverie-eval.toml"
    rule = f"[splits.{OPEN}]\n"
    file.write_text(file.read_text().replace(rule, f"{rule}one_per_team = true\n"))
    notes = [each.what for each in check_folder(folder) if each.check == "results"]
    assert any(f"1 team with several published results on {OPEN}" in note for note in notes)
