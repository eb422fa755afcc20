"""The public pages as files: whole without a server, equal to the server's, and without secrets."""

import json
import os
import re
import shutil
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from html import unescape
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import httpx
import pytest
from anyio.from_thread import BlockingPortal

from reverie_eval import PROTOCOLS, GroundTruth, ReverieEvalError, evaluate
from reverie_eval.ground_truth import Bundle
from reverie_eval.server.app import create_app
from reverie_eval.server.opening import open_server
from reverie_eval.server.operations.backup import write_backup
from reverie_eval.server.platforms.site import export_site
from reverie_eval.server.settings import SETTINGS_FILE
from reverie_eval.server.store.dump import dump
from reverie_eval.server.store.tables import Submission
from reverie_eval.version import __version__
from tests.support.acting import NOON, review
from tests.support.crawling import links_of
from tests.support.entries import entered
from tests.support.flat_world import Run
from tests.support.serving import (
    MATE,
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    Clock,
    InProcess,
    Serving,
    populate,
    settings_of,
    submission_for,
)
from tests.support.signing import payload_in
from tests.support.traceable_answers import Secrets, planted

ADDRESS = "https://lab.example.org/reverie"
SETTINGS = f"""
title = "REVERIE at <our> lab"
public_address = "{ADDRESS}"

[splits.val_unseen]
bundle = "ELSEWHERE/val_unseen.npz"
visibility = "open"

[splits.test]
bundle = "bundles/test.npz"
release_scores = "phase-end"
phases = [{{ name = "first", closes = 2100-01-01T00:00:00Z }}]
"""
PEOPLE = {OWNER: "Walkers", MATE: "Walkers", OTHER: "Hidden Team", ORGANISER: "Organisers"}
PAPER = "https://example.org/paper"
DESCRIPTION = "api/v1/openapi.json"
"""A file whose examples are people and numbers that look private; all servers have the same."""
HELD = {"success": 0.7391, "rgspl": 0.6173, "path_length": 17.29}
DATE = NOON + timedelta(days=30)
"""When every copy is made."""


@dataclass(frozen=True)
class Lab:
    """A server, a copy of its pages, and a backup."""

    server: Serving
    folder: Path
    elsewhere: Path
    """Has a bundle, outside of the folder."""
    archive: Path
    site: Path
    files: dict[str, bytes]
    """The content of every file of the site, by name."""


def contents(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture(scope="module")
def lab(
    made_folder: Path, portal: BlockingPortal, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Lab]:
    """Make a server with something of everything that is public or private, and copy its pages."""
    place = tmp_path_factory.mktemp("lab")
    folder = Path(shutil.copytree(made_folder, place / "server"))
    elsewhere = place / "elsewhere"
    elsewhere.mkdir()
    (folder / "bundles" / "val_unseen.npz").rename(elsewhere / "val_unseen.npz")
    file = folder / SETTINGS_FILE
    file.write_text(SETTINGS.replace("ELSEWHERE", str(elsewhere)))
    bundle = folder / "bundles" / "test.npz"
    planted(Bundle.load(bundle)).save(bundle)
    clock = Clock()
    state = open_server(settings_of(folder), clock)
    with state.transactions.begin("test") as transaction:
        tokens = populate(transaction, PEOPLE)
    transport = InProcess(create_app(state, "http://server"), portal)
    with httpx.Client(transport=transport, base_url="http://server") as client:
        server = Serving(state, clock, client, tokens)
        fill(server)
        write_backup(folder, place / "lab.tar.gz")
        export_at(DATE, folder, place / "site")
        clock.now = DATE
        site = place / "site"
        yield Lab(server, folder, elsewhere, place / "lab.tar.gz", site, contents(site))
    state.database.close()


def export_at(moment: datetime, source: Path, output: Path) -> None:
    """Write a copy as if it were another time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("reverie_eval.server.operations.backup.utc_now", lambda: moment)
        export_site(source, output)


def fill(server: Serving) -> None:
    """Publish and hide results, review, correct and refuse."""
    method = {"name": "Open <walker>", "paper": PAPER, "description": "It walks & stops."}
    scores = {"success": 0.5, "oracle_success": 0.75, "rgs": 0.5, "rgspl": 0.25}
    first = entered(server, scores, method=method)
    server.ask(OWNER, "PATCH", f"/submissions/{first}", json={"shows_episodes": True})
    scores = {"success": 0.75, "rgs": 0.75, "rgspl": 0.125}
    anonymous = "2100-01-01T00:00:00Z"
    entered(server, scores, OTHER, method={"name": "Nameless"}, anonymous_until=anonymous)
    entered(server, HELD, split=PRIVATE, method={"name": "Held back"})
    entered(server, method={"name": "Gone again"}, who=MATE)
    gone = server.ask(MATE, "GET", "/submissions").json()[0]["id"]
    server.ask(MATE, "PATCH", f"/submissions/{gone}", json={"withdrawn": True})
    server.upload(OWNER, server.distinct(), key="a secret key", name="Unpublished idea")
    with server.acting(ORGANISER) as transaction:
        review(transaction, first, "verified", "we ran its code")
        lifted = review(transaction, first, "flagged", "a wrong suspicion")
    server.ask(ORGANISER, "DELETE", f"/organiser/reviews/{lifted.id}")
    grant = {"team": "Hidden Team", "split": PRIVATE, "extra": 1, "reason": "a private reason"}
    grant["expires_at"] = "2030-01-01T00:00:00Z"
    assert server.ask(ORGANISER, "POST", "/organiser/grants", json=grant).status_code == 201
    server.ask(ORGANISER, "PUT", "/organiser/notice", json={"banner": "An earlier banner."})
    server.ask(ORGANISER, "PUT", "/organiser/notice", json={"banner": "We moved."})
    taken = {"split": OPEN, "title": "Challenge of the year"}
    assert server.ask(ORGANISER, "POST", "/organiser/snapshots", json=taken).status_code == 201
    server.clock.turn(hours=1)


# What is in it.


def test_every_link_leads_to_a_file_or_another_site(lab: Lab) -> None:
    files, pages, some_id = lab.files, 0, first_submission(lab)
    for name, content in files.items():
        if not name.endswith(".html"):
            continue
        pages += 1
        page = content.decode()
        assert "<form" not in page
        assert "copy.invalid" not in page
        for _, link in links_of(page):
            parts = urlsplit(link.replace("/ID.", f"/{some_id}."))
            if parts.scheme:
                assert parts.scheme in {"https", "data"}  # photographs are in their pages
                continue
            place = os.path.normpath(Path(name).parent / unquote(parts.path))
            target = place if parts.path else name
            assert target in files, (name, link)
            if parts.fragment:
                assert f'id="{parts.fragment}"'.encode() in files[target], (name, link)
    assert pages > 20


def first_submission(lab: Lab) -> str:
    rows = lab.server.ask(None, "GET", f"/splits/{OPEN}/leaderboard").json()["rows"]
    return str(rows[0]["submission_id"])


def test_every_public_page_is_in_it(lab: Lab) -> None:
    names = lab.files.keys()
    assert {"index.html", f"splits/{OPEN}.html", f"splits/{PRIVATE}.html"} <= names
    guide = ("submitting", "metrics", "protocols", "rules", "api", "privacy")
    assert {f"guide/{page}.html" for page in guide} <= names
    for query in ("metric=success", "metric=path_length", "metric=success,columns=all"):
        assert f"splits/{OPEN},{query}.html" in names
    assert {"api/v1/keys.json", "api/v1/openapi.json", "feed.atom"} <= names
    assert f"splits/{OPEN}/snapshots/1.html" in names
    assert len([name for name in names if re.match(r"submissions/\w+\.html", name)]) == 3
    assert not [name for name in names if re.match(r"sign-in|submit|team\.|play|desk", name)]


def test_analyses_and_their_near_misses_are_in_it(lab: Lab) -> None:
    pages = {name: content.decode() for name, content in lab.files.items() if "html" in name}
    assert "1 method whose episodes" in pages[f"episodes/{OPEN}.html"]
    walks = [name for name in pages if re.match(rf"episodes/{OPEN},scan=", name)]
    assert walks
    assert all("Where walks end" in pages[name] for name in walks)
    analyses = [page for name, page in pages.items() if name.endswith("/analysis.html")]
    assert sorted("Near misses" in page for page in analyses) == [False, True]
    shown = next(page for page in analyses if "Near misses" in page)
    near = re.findall(rf'"\.\./\.\./(episodes/{OPEN}/\w+,submission=\w+\.html)"', shown)
    assert len(near) > 3
    assert all("Step by step" in pages[name] for name in near)


@pytest.mark.parametrize("name", ["index.html", f"splits/{OPEN}.html", "guide/metrics.html"])
def test_every_page_says_of_what_and_when_it_is_a_copy(name: str, lab: Lab) -> None:
    page = lab.files[name].decode()
    assert f'This is a copy of <a href="{ADDRESS}">{ADDRESS}</a> from' in page
    assert f"{DATE:%Y-%m-%d %H:%M} UTC" in page
    assert "We moved." in page


def test_sorting_is_links(lab: Lab) -> None:
    by_success = lab.files[f"splits/{OPEN},metric=success.html"].decode()
    assert by_success.index("Nameless") < by_success.index("Open &lt;walker&gt;")
    back = re.search(r'href="([^"]*)" title="[^"]*">RGSPL', by_success)
    assert back
    assert back[1] == f"{OPEN}.html"
    by_default = lab.files[f"splits/{OPEN}.html"].decode()
    assert by_default.index("Open &lt;walker&gt;") < by_default.index("Nameless")


@pytest.mark.parametrize("split", [OPEN, PRIVATE])
def test_files_for_programs_are_those_of_the_server(split: str, lab: Lab) -> None:
    query = "metric=success"
    board = f"api/v1/splits/{split}/leaderboard"
    expected = {f"{board}.csv": f"/{board}.csv", f"{board}.json": f"/{board}"}
    if split == OPEN:
        expected |= {
            f"{board},{query}.csv": f"/{board}.csv?{query}",
            f"{board},{query}.json": f"/{board}?{query}",
            DESCRIPTION: f"/{DESCRIPTION}",
            "api/v1/keys.json": "/api/v1/keys",
            f"splits/{split}/latex,{query}.txt": f"/splits/{split}/latex?{query}",
            f"splits/{split}/bibtex,{query}.txt": f"/splits/{split}/bibtex?{query}",
        }
    for name, path in expected.items():
        assert lab.files[name] == lab.server.client.get(path).content


def test_a_snapshot_of_the_copy_can_be_verified_without_a_server(lab: Lab, run: Run) -> None:
    files = (f"api/v1/splits/{OPEN}/snapshots/1.json", "--key", "api/v1/keys.json")
    words = (str(lab.site / each) if each.endswith(".json") else each for each in files)
    outcome = run("verify", *words)
    assert (outcome.status, outcome.err) == (0, "")
    assert f"proven: the server's leaderboard of {OPEN} as of " in outcome.out


def test_charts_have_their_data_in_the_page(lab: Lab) -> None:
    page = lab.files[f"splits/{OPEN}.html"].decode()
    (found,) = re.findall(r"data-chart='([^']*)'", page)
    data = json.loads(unescape(found))
    assert data == lab.server.client.get(f"/splits/{OPEN}/chart").json()
    assert sorted(data["points"]["y"]) == [50.0, 75.0]


# What is not.

PUBLIC = {
    "submission": ("id", "split", "method", "report", "published_at"),
    "review": ("verdict", "reason", "submission_id"),
    "notice": ("banner",),
    "snapshot": ("title", "envelope"),
}
"""Columns that everybody may see, of rows that are shown."""
WORDS = {"role", "kind", "action", "row", "outcome", "split", "verdict"}
"""Columns whose values are words of ours."""
VERDICTS = ("verified", "flagged")
SHORTEST = 6
"""Characters of a text that is looked for; digests, names and reasons are longer, and shorter
texts are everywhere."""


def texts(value: Any) -> Iterator[str]:
    """Return every text in a value."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for each in value.values():
            yield from texts(each)
        if "payload" in value:
            yield from texts(payload_in(value))
    elif isinstance(value, list):
        for each in value:
            yield from texts(each)


def private_texts(server: Serving) -> set[str]:
    """Return all texts in the database that a visitor may not see."""
    signer = server.state.signer
    public = {"Walkers", ORGANISER, server.state.settings.title, signer.key_id, signer.public_pem}
    everything: set[str] = set()
    for table, row in dump(server.state.database):
        is_shown = (
            (table == "submission" and row["published_at"] and not row["withdrawn_at"])
            or (table == "review" and not row["lifted_at"])
            or (table == "notice" and row["banner"] == "We moved.")
            or table == "snapshot"
        )
        for column, value in row.items():
            found = set(texts(value))
            everything |= found if column not in WORDS else set()
            public |= found if is_shown and column in PUBLIC.get(table, ()) else set()
    signatures = {text for text in everything if text.startswith("split:")}
    names_of_ours = {
        *server.state.boards,
        *PROTOCOLS,
        *VERDICTS,
        "participant",
        "organiser",
        "server",
    }
    times = {text for text in everything if re.match(r"\d{4}-\d\d-\d\dT", text)}
    longer = {text for text in everything if len(text) >= SHORTEST}
    return longer - public - signatures - times - names_of_ours


def found_in(files: dict[str, bytes], private: Iterable[str]) -> set[tuple[str, str]]:
    return {
        (text, name)
        for text in private
        for name, content in files.items()
        if text.encode() in content
    }


def test_no_private_value_of_the_database_is_in_any_file(lab: Lab) -> None:
    private = private_texts(lab.server)
    expected = {"Hidden Team", "Gone again", "Unpublished idea", "a secret key", "a private reason"}
    assert expected | {"a wrong suspicion", "An earlier banner."} <= private
    assert len(private) > 50
    files = {name: content for name, content in lab.files.items() if name != DESCRIPTION}
    assert {text for text, _ in found_in(files, private)} == set()
    people = re.compile(rb"\b(Ada|Ben|Carl|Hidden|rv_\w{4,})\b")
    assert {name for name, content in files.items() if people.search(content)} == set()
    tokens = [*lab.server.tokens.values()]
    assert found_in(files, [*tokens, *(token[:10] for token in tokens)]) == set()


def test_no_score_that_is_held_back_is_in_any_file(lab: Lab) -> None:
    board = json.loads(lab.files[f"api/v1/splits/{PRIVATE}/leaderboard.json"])
    assert [row["scores"] for row in board["rows"]] == [{}]
    shown = {"73.91", "0.7391", "61.73", "0.6173", "17.29"}
    assert found_in(lab.files, shown) == set()


def test_no_answer_of_a_private_split_is_in_any_file(lab: Lab) -> None:
    truth = GroundTruth.load(lab.folder / "bundles" / "test.npz")
    sent = [submission_for(PRIVATE, "random", seed) for seed in range(3)]
    scores = [evaluate(each, split=PRIVATE, ground_truth=truth) for each in sent]
    secrets = Secrets.of(truth, [], scores)
    for name, content in lab.files.items():
        text = content.decode()
        assert [kind for kind, p in secrets.patterns.items() if p.search(text)] == [], name


# Again, and from elsewhere.


def test_a_backup_alone_gives_the_same_files(lab: Lab, tmp_path: Path) -> None:
    apart = lab.elsewhere.rename(lab.elsewhere.with_name("not there"))
    try:
        made_at = export_site(lab.archive, tmp_path / "of backup").copied_at
    finally:
        apart.rename(lab.elsewhere)
    assert timedelta(0) <= datetime.now(UTC) - made_at < timedelta(hours=1)
    earlier = Path(shutil.copytree(lab.site, tmp_path / "of folder"))
    (earlier / "stale.html").write_text("old")
    export_at(made_at, lab.folder, earlier)
    assert contents(earlier) == contents(tmp_path / "of backup")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["of backup", "of folder"]


def test_a_damaged_file_leaves_out_its_analysis_alone(lab: Lab, tmp_path: Path) -> None:
    folder, submission_id = tmp_path / "server", first_submission(lab)
    shutil.copytree(lab.folder, folder)
    with lab.server.state.database.reading() as session:
        digest = session.get_one(Submission, submission_id).sha256
    (file,) = folder.rglob(f"{digest}*")
    file.write_bytes(b"")
    export_at(DATE, folder, tmp_path / "site")
    missing = lab.files.keys() - contents(tmp_path / "site").keys()
    assert f"submissions/{submission_id}/analysis.html" in missing
    assert not [name for name in missing if not re.match(r"submissions/|episodes/", name)]


@pytest.mark.parametrize("kind", ["a folder with something else", "a file"])
def test_nothing_else_is_replaced(kind: str, lab: Lab, tmp_path: Path) -> None:
    target = tmp_path / "mine"
    kept = target / "kept.txt" if kind != "a file" else target
    kept.parent.mkdir(exist_ok=True)
    kept.write_text("kept")
    with pytest.raises(ReverieEvalError, match=r"mine is not an earlier copy"):
        export_site(lab.folder, target)
    assert kept.read_text() == "kept"


def test_a_copy_says_of_which_server_it_is_and_when_it_was_made(lab: Lab) -> None:
    assert json.loads(lab.files["copy.json"]) == {
        "server": "REVERIE at <our> lab",
        "address": ADDRESS,
        "copied_at": DATE.isoformat(),
        "software": f"reverie-eval {__version__}",
    }
