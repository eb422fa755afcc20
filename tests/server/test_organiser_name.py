"""Who the organiser is in public: a name of the settings, never that of a login or an account."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.server.test_statements import PAGES, READS, visitors_of
from tests.support.demo_site import BOLD, ENDLESS, Site
from tests.support.entries import entered
from tests.support.flat_world import Run
from tests.support.serving import (
    GROUNDING,
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PEOPLE,
    PRIVATE,
    OpenServer,
    Serving,
    submission_for,
)
from tests.support.signing import payload_in, payloads_in
from tests.support.visiting import Visitor, said, signed_in

LOGIN, NAME = "zoperator", "REVERIE team, Example Lab"
SECRET = (LOGIN, "(command line)", ORGANISER)
"""What nobody may learn from the server but organisers."""


@pytest.fixture
def at_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have a login, whose name commands find."""
    monkeypatch.setenv("LOGNAME", LOGIN)


@pytest.fixture
def judged(several: Serving, run: Run, at_a_terminal: None, tmp_path: Path) -> tuple[Serving, Site]:
    """Return a server on which a login and an account did all that organisers do in public."""
    server, folder = several, str(several.state.settings.folder)
    ids = {
        (OPEN, "Walker"): entered(server),
        (OPEN, BOLD): entered(server, who=OTHER),
        (OPEN, ENDLESS): entered(server, who=OTHER),
        (PRIVATE, "Shortest paths"): entered(server, split=PRIVATE),
    }
    mine, theirs = ids[OPEN, "Walker"], ids[OPEN, BOLD]
    sent = tmp_path / "sent.json"
    sent.write_bytes(submission_for(OPEN, "stop"))
    table = tmp_path / "table.csv"
    table.write_text("method,team,rgspl\nFAST,Qi,25\n")
    moment = f"{server.clock():%Y-%m-%dT%H:%M:%SZ}"
    from_ada = ("--split", OPEN, "--team", "Azure", "--person", OWNER, "--method", "Ours")
    for words in (
        ("review", "add", folder, mine, "verified", "--reason", "we ran it"),
        ("review", "add", folder, theirs, "disqualified", "--reason", "it broke the rules"),
        ("news", "add", folder, "We moved."),
        ("news", "banner", folder, "Hello"),
        ("phase", "pause", folder, "val_seen"),
        ("import", folder, str(table), "--split", OPEN, "--source", "a paper"),
        ("team", "rename", folder, PEOPLE[OWNER], "Azure"),
        ("person", "edit", folder, OWNER, "--email", "ada@example.org"),
        ("submit", folder, str(sent), *from_ada, "--received", moment, "--publish"),
        ("snapshot", folder, OPEN, "--title", "The first month"),
    ):
        outcome = run("server", *words)
        assert outcome.status == 0, outcome.err
    flagged = {"submission_id": ids[OPEN, ENDLESS], "verdict": "flagged", "reason": "a doubt"}
    for path, new in (("reviews", flagged), ("news", {"text": "Soon over."})):
        assert server.ask(ORGANISER, "POST", f"/organiser/{path}", json=new).is_success
    assert LOGIN in server.ask(ORGANISER, "GET", "/organiser/audit").text
    return server, Site("", Path(), server.tokens, ids)


def in_public(server: Serving, site: Site) -> Iterator[tuple[str, httpx.Response]]:
    """Yield all that visitors and participants can read."""
    visitors: dict[str | None, Visitor] = {None: Visitor(server)}
    visitors |= {who: signed_in(server, who) for who in (OWNER, OTHER)}
    for example in PAGES:
        for who in {*visitors_of(example), None, OWNER} & visitors.keys():
            path = example.path(site)
            yield f"{who}: {path}", visitors[who].get(path)
    parts = {"split": OPEN, "board": GROUNDING, "number": 1}
    for read in READS:
        for name in (OPEN, "Walker"), (OPEN, BOLD):
            path = read.format(**parts, person_id=1, submission_id=site.ids[name])
            for who in (None, OWNER, OTHER):
                yield f"{who}: {path}", server.ask(who, "GET", path)
    yield "what Ada is sent", server.ask(ORGANISER, "GET", "/organiser/people/1")


def test_nobody_learns_who_is_at_the_terminal_or_which_organiser_acted(
    judged: tuple[Serving, Site], run: Run, tmp_path: Path
) -> None:
    server, site = judged
    read = {place: reply.text for place, reply in in_public(server, site) if reply.is_success}
    assert len(read) > 100
    folder = str(server.state.settings.folder)
    for what in ("tables", "site"):
        assert run("server", "export", what, folder, "-o", str(tmp_path / what)).status == 0
        files = (path for path in (tmp_path / what).rglob("*") if path.is_file())
        read |= {str(path): path.read_bytes().decode(errors="ignore") for path in files}
    read = {place: "\n".join([text, *payloads_in(text)]) for place, text in read.items()}
    found = {(place, word) for place, text in read.items() for word in SECRET if word in text}
    assert found == set()


def test_an_organiser_s_name_is_changed_afterwards_but_not_in_what_was_signed(
    judged: tuple[Serving, Site], open_server: OpenServer
) -> None:
    earlier, site = judged
    snapshot = f"/splits/{OPEN}/snapshots/1"
    signed = earlier.ask(None, "GET", snapshot)
    changed = earlier.state.settings.model_copy(update={"organiser": NAME, "contact": "a@lab.org"})
    server = open_server(changed, earlier.tokens)
    assert reviewers(payload_in(signed.json())["leaderboard"]) == {"the organiser"}
    assert server.ask(None, "GET", snapshot).content == signed.content
    assert reviewers(server.ask(None, "GET", f"/splits/{OPEN}/leaderboard").json()) == {NAME}
    assert server.ask(None, "GET", "/server").json()["organiser"] == NAME
    api = server.ask(None, "GET", "/openapi.json").json()
    assert api["info"]["contact"] == {"name": NAME, "email": "a@lab.org"}
    mine = f"/submissions/{site.ids[OPEN, 'Walker']}"
    visitor, owner = Visitor(server), signed_in(server, OWNER)
    for page in (visitor.get("/"), visitor.get(f"/splits/{OPEN}"), visitor.get(mine)):
        assert NAME in said(page)
    assert f"verified, by {NAME}: we ran it" in said(owner.get(mine))
    assert f"<name>{NAME}</name>" in visitor.get("/feed.atom").text


def reviewers(leaderboard: Any) -> set[str]:
    """Return who a leaderboard says made its reviews."""
    rows = [*leaderboard["rows"], *leaderboard["apart"]]
    return {review["reviewer"] for row in rows for review in row["reviews"]}


def test_a_snapshot_says_beforehand_that_it_keeps_the_name(server: Serving, run: Run) -> None:
    page = said(signed_in(server, ORGANISER).get("/desk/snapshots"))
    assert "signed “the organiser”, the organiser's current name: changing it later" in page
    told = " ".join(run("server", "snapshot", "--help").out.split())
    assert "reviews in it keep the organiser's name" in told
