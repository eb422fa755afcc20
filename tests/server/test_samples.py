"""Declared samples: a list of episodes has a leaderboard of its own, apart from the split's."""

import json
from pathlib import Path

import pytest

from reverie_eval import GroundTruth, evaluate
from reverie_eval.errors import GroundTruthError
from reverie_eval.ground_truth import DEMO_BUNDLES, Bundle, read_episode_ids
from reverie_eval.server.opening import open_server
from reverie_eval.server.operations.doctor import examine
from reverie_eval.server.platforms.site import export_site
from reverie_eval.server.scoring.boards import load_board
from reverie_eval.server.settings import SETTINGS_FILE, SettingsError, Split
from tests.support.serving import GOOD, OPEN, OWNER, PRIVATE, OpenServer, Serving, settings_of

NAME = f"{OPEN}-twenty"
WHOLE = DEMO_BUNDLES / f"{OPEN}.npz"
IDS = Bundle.load(WHOLE).arrays["instr_id"][::4].tolist()[:20]
RECORDS = [record for record in json.loads(GOOD) if record["instr_id"] in IDS]


def declare(folder: Path, name: str = NAME, bundle: Path = WHOLE, ids: list[str] = IDS) -> None:
    """Add a sample to the settings of a server."""
    Bundle.load(bundle).of_sample(ids).save(folder / "bundles" / f"{name}.npz")
    section = f'[splits.{name}]\nbundle = "bundles/{name}.npz"\nvisibility = "open"\n'
    with (folder / SETTINGS_FILE).open("a") as file:
        file.write(f"\n{section}")


@pytest.fixture
def sampled(folder: Path, open_server: OpenServer) -> Serving:
    """Return a server with a sample of the open split."""
    declare(folder)
    return open_server(settings_of(folder))


def board(server: Serving, split: str) -> list[str]:
    rows = server.ask(None, "GET", f"/splits/{split}/leaderboard").json()["rows"]
    return [row["signature"].rpartition("|version")[0] for row in rows]


def test_a_sample_has_its_own_leaderboard(sampled: Serving, folder: Path, tmp_path: Path) -> None:
    for split, content in ((NAME, json.dumps(RECORDS).encode()), (OPEN, GOOD)):
        reply = sampled.upload(OWNER, content, split)
        assert reply.status_code == 201, reply.text
        submission = reply.json()["submission"]
        path = f"/submissions/{submission['id']}"
        sampled.ask(OWNER, "PATCH", path, json={"published": True})
        if split == NAME:
            # The digits and the signature of `--episodes-from` with the whole split's bundle.
            here = evaluate(GOOD, split=OPEN, subset=IDS)
            assert submission["report"]["scores"] == dict(here)
            assert submission["report"]["signature"] == here.signature
    digest = sampled.state.board(NAME).truth.subset_digest
    assert [f"|subset:{digest}|" in row for row in board(sampled, NAME)] == [True]
    assert ["|subset:" in row for row in board(sampled, OPEN)] == [False]
    report = sampled.ask(None, "GET", f"/splits/{NAME}").json()
    told = ("name", "subset", "episodes", "split_episodes", "fingerprint")
    assert [report[key] for key in told] == [
        NAME, digest, 20, 84, sampled.state.board(OPEN).truth.fingerprint,
    ]  # fmt: skip
    listed = sampled.client.get(f"/api/v1/splits/{NAME}/episodes.txt").text
    (tmp_path / "ids.txt").write_text(listed)
    assert set(read_episode_ids(tmp_path / "ids.txt")) == set(IDS)
    page = sampled.client.get(f"/splits/{NAME}").text
    assert "Val unseen leaderboard, sample twenty" in page
    assert "A sample of 20 of the split's 84 episodes" in page
    assert f"digest <code>{digest}</code>" in page
    assert digest in sampled.client.get(f"/splits/{NAME}/latex").text
    assert digest in sampled.client.get(f"/api/v1/splits/{NAME}/leaderboard.csv").text
    assert [each.what for each in examine(folder) if each.kind == "fault"] == []
    export_site(folder, tmp_path / "site")
    assert (tmp_path / f"site/api/v1/splits/{NAME}/episodes.txt").read_text() == listed


@pytest.mark.parametrize(
    ("content", "code", "told"),
    [
        pytest.param(
            GOOD,
            "beyond-sample",
            "64 records of episodes that are not in the sample twenty; send those of its 20 "
            "episodes alone",
            id="the whole split",
        ),
        pytest.param(
            json.dumps(RECORDS[1:]).encode(),
            "missing-episode",
            RECORDS[0]["instr_id"],
            id="one less",
        ),
    ],
)
def test_other_episodes_are_refused(content: bytes, code: str, told: str, sampled: Serving) -> None:
    for check in ("submissions", "validate"):
        path = f"/splits/{NAME}/{check}?name=Walker"
        reply = sampled.ask(OWNER, "POST", path, content=content)
        (problem,) = reply.json()["problems"]
        assert (reply.status_code, problem["code"]) == (422, code)
        assert told in problem["message"]


@pytest.mark.parametrize(
    ("name", "told"),
    [
        (
            OPEN,
            "this is the ground truth of a sample of val_unseen; call it val_unseen- and a name",
        ),
        ("test-twenty", "such as val_unseen-"),
        (f"{OPEN}-Twenty", "of lower-case letters, digits, - and _"),
    ],
)
def test_a_sample_is_named_after_its_split(name: str, told: str, tmp_path: Path) -> None:
    path = tmp_path / "sample.npz"
    Bundle.load(WHOLE).of_sample(IDS).save(path)
    with pytest.raises(GroundTruthError) as error:
        load_board(name, Split(visibility="open", bundle=path), path)
    assert told in str(error.value)


def test_an_open_sample_of_a_private_split_is_refused(folder: Path) -> None:
    private = folder / "bundles" / f"{PRIVATE}.npz"
    ids = Bundle.load(private).arrays["instr_id"][:5].tolist()
    declare(folder, f"{PRIVATE}-five", private, ids)
    with pytest.raises(SettingsError, match="has the solution of the open split test-five"):
        open_server(settings_of(folder))


def test_a_bundle_declares_a_sample(tmp_path: Path) -> None:
    path, bundle = tmp_path / "sample.npz", Bundle.load(WHOLE)
    bundle.of_sample(IDS).save(path)
    truth = GroundTruth.load(path)
    assert (len(truth.episodes.instr_ids), truth.fingerprint) == (20, bundle.header.fingerprint)
    assert Bundle.load(path).public().header.episodes == tuple(IDS)
    bundle.of_sample(["1_2_3"]).save(path)
    with pytest.raises(GroundTruthError, match="damaged"):
        GroundTruth.load(path)
