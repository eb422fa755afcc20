"""The tables of agents on names, from models and runs in the demo world."""

import json
import re
import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from benchmarks.paper_rows import (
    FAST,
    POINTERS,
    SPLITS,
    TABLES,
    Folders,
    Results,
    bundle_of,
    draw,
    name_shares,
    run,
    train,
    write_tables,
)
from reverie_eval import GroundTruth, evaluate
from reverie_eval.agents import DEMO_AGENT
from reverie_eval.agents.trained import _recipes as recipes
from reverie_eval.agents.trained.pointers import NameRnn
from reverie_eval.dataset import DatasetFiles
from reverie_eval.ground_truth import DEMO_BUNDLES

NAME_RNN = POINTERS[0]


@pytest.fixture(scope="module")
def folders(demo_world: Path, tmp_path_factory: pytest.TempPathFactory) -> Folders:
    """Name the folders of rows in the demo world, where FAST-Short was run."""
    bundles = tmp_path_factory.mktemp("bundles")
    for split in SPLITS:
        shutil.copy(DEMO_BUNDLES / f"{split}.npz", bundles)
    out = tmp_path_factory.mktemp("out")
    annotations = DatasetFiles.find(demo_world, split="train").annotations["train"]
    made = Folders(demo_world, annotations, bundles, out)
    for split in SPLITS:
        made.run(FAST, split, 0).mkdir(parents=True)
        shutil.copy(DEMO_AGENT / f"{split}.json", made.run(FAST, split, 0) / "submission.json")
    return made


def test_rows_are_trained_and_run_and_written(
    folders: Folders, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recipes, "RECIPES", {"name-rnn": recipes.Recipe(NameRnn, epochs=1, size=8)})
    train(NAME_RNN, folders, 0)
    for split in SPLITS:
        run(NAME_RNN, folders, split, 0)
        train(NAME_RNN, folders, 0)  # nothing is left to do
        run(NAME_RNN, folders, split, 0)
    made = ["models/name-rnn.0", "runs/val_seen.name-rnn.0", "runs/val_unseen.name-rnn.0"]
    assert [line.split()[1] for line in folders.seconds.read_text().splitlines()] == made

    page, results = tmp_path / "page.md", Results(folders, [0, 1])
    page.write_text("".join(f"<!-- table:{each} -->\nold\n<!-- end -->\n" for each in TABLES))
    write_tables(page, results)
    once = page.read_text()
    write_tables(page, results)
    assert page.read_text() == once
    assert "old" not in once
    for split in SPLITS:
        pointed = evaluate(folders.run(NAME_RNN, split, 0) / "submission.json", split=split)
        walked = evaluate(DEMO_AGENT / f"{split}.json", split=split)
        assert f"| {100 * pointed['rgs']:.2f} (" in once
        assert f"| {100 * walked['spl']:.2f} | {100 * walked['rgs']:.2f} (" in once
    assert re.search(r"\nThe rows: 2 models in \S+ minutes, 1 measured; 4 runs in .*, 2 meas", once)
    assert "R2R-TF (val_seen), " in once
    draw(tmp_path / "picture.svg", results)
    assert "stops at one (SR)" in (tmp_path / "picture.svg").read_text()


def test_other_inputs_are_those_of_the_split(folders: Folders) -> None:
    truth, others, silent, shuffled = (
        GroundTruth.load(bundle_of(FAST._replace(bundles=name), folders, "val_unseen"))
        for name in ("", "others", "silent", "shuffled")
    )
    own, its = truth.episodes.instructions, others.episodes.instructions
    assert Counter(own) == Counter(its)
    assert all(mine != other for mine, other in zip(own, its, strict=True))
    assert {*silent.episodes.instructions} == {""}
    assert named(shuffled).keys() == named(truth).keys()
    assert Counter(named(shuffled).values()) == Counter(named(truth).values())
    assert named(shuffled) != named(truth)


def named(truth: GroundTruth) -> dict[tuple[int, int], str]:
    """Return the name of each object of each building; there is one, seen from anywhere."""
    solution = truth.require_solution()
    scans = truth.graph.viewpoint_scan[solution.candidate_viewpoint].tolist()
    objects = zip(scans, solution.candidate_object.tolist(), strict=True)
    pairs = {*zip(objects, solution.candidate_categories, strict=True)}
    assert len(dict(pairs)) == len(pairs)
    return dict(pairs)


def test_a_name_is_right_for_the_target_and_for_its_rivals(tmp_path: Path) -> None:
    truth = GroundTruth.load(DEMO_BUNDLES / "val_unseen.npz")
    solution = truth.require_solution()
    files = [tmp_path / "target.json", tmp_path / "rival.json"]
    targets = solution.target_object.tolist()
    rivals, n_rivals = [], []
    for target, goal in zip(targets, solution.goal.tolist(), strict=True):
        there = solution.candidate_viewpoint == goal
        name_of = dict(
            zip(
                solution.candidate_object[there].tolist(),
                np.array(solution.candidate_categories)[there].tolist(),
                strict=True,
            )
        )
        its = [each for each in name_of if name_of[each] == name_of[target] and each != target]
        rivals.append([*its, target][0])
        n_rivals.append(len(its))
    for file, chosen in zip(files, (targets, rivals), strict=True):
        file.write_text(json.dumps([{"predObjId": each} for each in chosen]))
    several = [1 + number for number in n_rivals if number]
    share, chance = len(several) / len(targets), np.mean(1 / np.array(several))
    assert several
    assert name_shares(truth, files[:1]) == pytest.approx([1, share, 1, chance])
    assert name_shares(truth, files[1:]) == pytest.approx([1, share, 0, chance])
    assert name_shares(truth, files) == pytest.approx([1, share, 0.5, chance])
