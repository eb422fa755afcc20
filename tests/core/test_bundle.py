"""The bundle file, its contents, and how the ground truth of a split is found."""

import io
import json
import os
import pickle
import stat
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from zipfile import ZIP_BZIP2, ZIP_LZMA, ZipFile

import numpy as np
import pytest

from fixtures.bundles import write_demo_bundles
from fixtures.demo_world.episodes import Answer, episodes_of, submitted
from reverie_eval import GroundTruth, GroundTruthError, evaluate, validate
from reverie_eval.ground_truth import DEMO_BUNDLES, GROUND_TRUTH_VARIABLE, Bundle, find_ground_truth
from reverie_eval.ground_truth._bundle import (
    OPTIONAL_SOLUTION_ARRAYS,
    PUBLIC_ARRAYS,
    PUBLIC_TEXTS,
    SOLUTION_ARRAYS,
    TARGET_ARRAYS,
    UNSCORED_ARRAYS,
    pack_texts,
)
from tests.conftest import SAMPLES
from tests.support.flat_world import Run
from tests.support.worlds import SPLIT

VAL_UNSEEN = DEMO_BUNDLES / "val_unseen.npz"
PRIVATE = SOLUTION_ARRAYS.keys() | TARGET_ARRAYS.keys() | OPTIONAL_SOLUTION_ARRAYS.keys()
"""The names of everything that a public bundle leaves out."""


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    """Load the bundle of the demo world's val_unseen split."""
    return Bundle.load(VAL_UNSEEN)


@pytest.fixture(scope="module")
def regenerated(demo_world: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Compile the demo world again."""
    folder = tmp_path_factory.mktemp("regenerated")
    write_demo_bundles(demo_world, folder)
    return folder


def content_of(bundle: Bundle) -> tuple[object, ...]:
    """Return the contents of a bundle in a form that can be compared."""
    arrays = {name: (array.dtype.str, array.tolist()) for name, array in bundle.arrays.items()}
    others = {split: ids.tolist() for split, ids in bundle.other_splits.items()}
    texts = {name: text.tobytes() for name, text in bundle.texts.items()}
    return bundle.header, arrays, others, texts


def with_other_answers(bundle: Bundle) -> Bundle:
    """Return a bundle of the same episodes with different answer arrays."""
    answers = {name: bundle.arrays[name][::-1].copy() + 1 for name in PRIVATE}
    arrays = {**bundle.arrays, **answers}
    sources = {**bundle.header.sources, "annotations": "other", "boxes": "others"}
    texts = {**bundle.texts, "target_category": pack_texts(["answers"])}
    return Bundle.build(SPLIT, "demo", sources, arrays, bundle.other_splits, texts=texts)


# Saving and loading.


@pytest.mark.parametrize("public", [False, True], ids=["full", "public"])
def test_saving_and_loading_a_bundle_changes_nothing(
    bundle: Bundle, tmp_path: Path, *, public: bool
) -> None:
    saved = bundle.public() if public else bundle
    saved.save(tmp_path / "saved.npz")
    assert content_of(Bundle.load(tmp_path / "saved.npz")) == content_of(saved)


def test_saving_twice_gives_the_same_bytes(bundle: Bundle, tmp_path: Path) -> None:
    bundle.save(tmp_path / "once.npz")
    bundle.save(tmp_path / "twice.npz")
    assert (tmp_path / "once.npz").read_bytes() == (tmp_path / "twice.npz").read_bytes()


def test_a_bundle_contains_no_date(bundle: Bundle, tmp_path: Path) -> None:
    """Equal contents give equal bytes on any day."""
    bundle.save(tmp_path / "bundle.npz")
    with ZipFile(tmp_path / "bundle.npz") as archive:
        assert {member.date_time for member in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}


def test_saving_replaces_a_bundle_and_leaves_nothing_else(bundle: Bundle, tmp_path: Path) -> None:
    bundle.save(tmp_path / "bundle.npz")
    bundle.public().save(tmp_path / "bundle.npz")
    assert Bundle.load(tmp_path / "bundle.npz").is_public
    assert [path.name for path in tmp_path.iterdir()] == ["bundle.npz"]


def test_a_failed_write_leaves_nothing(
    bundle: Bundle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full_disk(*_: object, **__: object) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr(np.lib.format, "write_array", full_disk)
    with pytest.raises(OSError, match="no space left"):
        bundle.save(tmp_path / "bundle.npz")
    assert not list(tmp_path.iterdir())


def test_arrays_are_read_only(bundle: Bundle) -> None:
    arrays = [*bundle.arrays.values(), *bundle.public().arrays.values()]
    assert not [array for array in arrays if array.flags.writeable]


def test_the_fingerprint_depends_on_every_array(bundle: Bundle) -> None:
    fingerprints = {bundle.header.fingerprint}
    for name, array in bundle.arrays.items():
        changed = array.copy()
        changed.flat[-1] = "?" if array.dtype.kind == "U" else not array.flat[-1]
        other = Bundle.build(SPLIT, "demo", {}, {**bundle.arrays, name: changed}, {})
        fingerprints.add(other.header.fingerprint)
    assert len(fingerprints) == 1 + len(bundle.arrays.keys() - UNSCORED_ARRAYS.keys())


# Files that are no bundle.


def _npz(**arrays: object) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)  # type: ignore[arg-type]
    return file.getvalue()


def _npy(array: np.ndarray[Any, Any]) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def _with_header(**fields: object) -> bytes:
    return _npz(header=np.frombuffer(json.dumps(fields).encode(), np.uint8))


def _with_another_array(name: str) -> bytes:
    """Return the bundle with a changed array and the old header."""
    with np.load(VAL_UNSEEN) as archive:
        members = dict(archive)
    members[name] = members[name][::-1]
    return _npz(**members)


def _with_a_wrong_bit() -> bytes:
    content = bytearray(VAL_UNSEEN.read_bytes())
    content[len(content) // 2] ^= 1
    return bytes(content)


def _packed_by(method: int) -> bytes:
    """Return a bundle whose first array claims to be packed by another method."""
    content = bytearray(VAL_UNSEEN.read_bytes())
    with ZipFile(VAL_UNSEEN) as archive:
        content[archive.start_dir + 10] = method
    return bytes(content)


NO_BUNDLE = "is not a ground-truth bundle, or is damaged; `reverie-eval compile` creates one"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        pytest.param(lambda: b"", NO_BUNDLE, id="empty file"),
        pytest.param(lambda: b"[]", NO_BUNDLE, id="JSON"),
        pytest.param(lambda: pickle.dumps([1, 2]), NO_BUNDLE, id="pickle"),
        pytest.param(lambda: _npy(np.arange(3)), NO_BUNDLE, id=".npy"),
        pytest.param(lambda: _npz(a=np.arange(3)), NO_BUNDLE, id="other .npz"),
        pytest.param(lambda: _with_header(split="test"), NO_BUNDLE, id="header without version"),
        pytest.param(lambda: _with_header(format_version=1), NO_BUNDLE, id="header without fields"),
        pytest.param(
            lambda: _with_header(format_version=2),
            "has bundle format 2, this version of reverie-eval reads format 1; compile it again",
            id="newer format",
        ),
        pytest.param(
            lambda: _with_another_array("task_target"), "is damaged", id="another solution"
        ),
        pytest.param(lambda: _with_another_array("edge"), "is damaged", id="other edges"),
        pytest.param(_with_a_wrong_bit, "bundle", id="wrong bit"),
        pytest.param(lambda: _packed_by(ZIP_BZIP2), NO_BUNDLE, id="bzip2"),
        pytest.param(lambda: _packed_by(ZIP_LZMA), NO_BUNDLE, id="LZMA"),
        pytest.param(lambda: _packed_by(93), NO_BUNDLE, id="Zstandard"),
        pytest.param(lambda: VAL_UNSEEN.read_bytes()[:-1000], "bundle", id="truncated"),
    ],
)
def test_a_file_that_is_not_a_valid_bundle(
    content: Callable[[], bytes], message: str, tmp_path: Path
) -> None:
    path = tmp_path / "bundle.npz"
    path.write_bytes(content())
    with pytest.raises(GroundTruthError) as error:
        GroundTruth.load(path)
    assert str(path) in str(error.value)
    assert message in str(error.value)


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"none\.npz"):
        GroundTruth.load(tmp_path / "none.npz")


class _Trap:
    """An object that creates a file when it is unpickled."""

    def __init__(self, sprung: Path) -> None:
        self._sprung = sprung

    def __reduce__(self) -> tuple[Callable[[Path], None], tuple[Path]]:
        return Path.touch, (self._sprung,)


@pytest.mark.parametrize(
    "content",
    [
        pytest.param(pickle.dumps, id="pickle"),
        pytest.param(lambda trap: _npz(header=np.array([trap])), id="header"),
        pytest.param(lambda trap: _npz(a=np.array([trap])), id="array"),
    ],
)
def test_a_pickle_is_never_loaded(content: Callable[[_Trap], bytes], tmp_path: Path) -> None:
    path, sprung = tmp_path / "bundle.npz", tmp_path / "sprung"
    path.write_bytes(content(_Trap(sprung)))
    with pytest.raises(GroundTruthError):
        GroundTruth.load(path)
    assert not sprung.exists()


# Public bundles.


def test_a_public_bundle_has_no_answers(bundle: Bundle) -> None:
    public = PUBLIC_ARRAYS.keys() | UNSCORED_ARRAYS.keys()
    assert bundle.arrays.keys() == public | PRIVATE
    assert bundle.public().arrays.keys() == public
    assert not bundle.is_public
    assert bundle.public().is_public


def test_a_public_bundle_has_exactly_these_arrays() -> None:
    """An array added to this list becomes public."""
    assert set(PUBLIC_ARRAYS) == {
        "instr_id",
        "episode_task",
        "task_start",
        "scan_id",
        "viewpoint_id",
        "viewpoint_scan",
        "viewpoint_position",
        "distance",
        "edge",
    }
    assert not PRIVATE & PUBLIC_ARRAYS.keys()
    assert set(UNSCORED_ARRAYS) == {"viewpoint_rotation", "task_heading"}
    assert set(PUBLIC_TEXTS) == {"instruction", "language"}


def test_a_public_bundle_has_instructions_but_no_categories(bundle: Bundle) -> None:
    assert set(bundle.texts) == {"instruction", "target_category", "candidate_category"}
    assert set(bundle.public().texts) == {"instruction"}


# Texts.


def test_texts_equal_those_of_the_annotations(demo_world: Path, regenerated: Path) -> None:
    file = demo_world / "tasks" / "REVERIE" / "data" / "REVERIE_val_unseen.json"
    items = json.loads(file.read_text())
    truth = GroundTruth.load(regenerated / "val_unseen.npz")
    assert truth.episodes.instructions == tuple(
        text for item in items for text in item["instructions"]
    )
    assert len(truth.require_solution().target_categories) == len(items)
    assert "bed" in truth.require_solution().target_categories


def test_categories_of_candidates_equal_those_of_the_box_files(
    demo_world: Path, regenerated: Path
) -> None:
    truth = GroundTruth.load(regenerated / "val_unseen.npz")
    solution, graph = truth.require_solution(), truth.graph
    columns = solution.candidate_viewpoint, solution.candidate_object
    found = zip(*(each.tolist() for each in columns), solution.candidate_categories, strict=True)
    for viewpoint, object_id, category in found:
        name = graph.viewpoint_ids[viewpoint]
        file = f"{graph.scan_of(viewpoint)}_{name}.json"
        boxes = json.loads((demo_world / "tasks/REVERIE/data/BBox" / file).read_text())
        assert boxes[name][str(object_id)]["name"] == category


def test_a_bundle_has_the_directions_of_cameras(demo_world: Path, regenerated: Path) -> None:
    """As published, also in a public bundle, and without an effect on the fingerprint."""
    bundle = Bundle.load(regenerated / "test.public.npz")
    graph = GroundTruth.from_bundle(bundle).graph
    scan = graph.scan_ids[0]
    file = demo_world / "connectivity" / f"{scan}_connectivity.json"
    for viewpoint in json.loads(file.read_text()):
        if viewpoint["included"]:
            expected = np.array(viewpoint["pose"]).reshape(4, 4)[:3, :3]
            found = graph.viewpoint_rotation[graph.index[viewpoint["image_id"]]]
            assert found == pytest.approx(expected, abs=1e-6)
    without = {name: bundle.arrays[name] for name in PUBLIC_ARRAYS}
    again = Bundle.build("test", "demo", bundle.header.sources, without, bundle.other_splits)
    assert again.header.fingerprint == bundle.header.fingerprint


def test_the_fingerprint_does_not_depend_on_texts(bundle: Bundle) -> None:
    arrays, others = bundle.arrays, bundle.other_splits
    without = Bundle.build(SPLIT, "demo", bundle.header.sources, arrays, others)
    assert without.header.fingerprint == bundle.header.fingerprint


@pytest.mark.parametrize(
    "packed", [b"", b"[", b'["one"]', b"[1]", b"\xff"], ids=["nothing", "cut", "few", "no", "bytes"]
)
def test_damaged_texts_raise_an_error_when_read(bundle: Bundle, packed: bytes) -> None:
    damaged = np.frombuffer(packed, np.uint8)
    texts = {**bundle.texts, "instruction": damaged, "target_category": damaged}
    truth = GroundTruth.from_bundle(replace(bundle, texts=texts))
    with pytest.raises(GroundTruthError, match="instructions of this ground truth are damaged"):
        _ = truth.episodes.instructions
    with pytest.raises(GroundTruthError, match="categories of this ground truth are damaged"):
        _ = truth.require_solution().target_categories


@pytest.mark.parametrize("name", ["instruction", "target_category", "candidate_category"])
def test_a_bundle_without_some_of_its_texts_is_not_complete(
    bundle: Bundle, name: str, tmp_path: Path
) -> None:
    texts = {each: text for each, text in bundle.texts.items() if each != name}
    replace(bundle, texts=texts).save(tmp_path / "bundle.npz")
    with pytest.raises(GroundTruthError, match=r"is damaged: .*; compile it again$"):
        Bundle.load(tmp_path / "bundle.npz")


def test_the_bytes_of_a_public_bundle_do_not_depend_on_answers(
    bundle: Bundle, tmp_path: Path
) -> None:
    bundle.public().save(tmp_path / "one.npz")
    with_other_answers(bundle).public().save(tmp_path / "other.npz")
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "other.npz").read_bytes()


def test_private_and_published_files_give_the_same_public_bundle(regenerated: Path) -> None:
    private, public = (
        Bundle.load(regenerated / name) for name in ("private/test.npz", "test.public.npz")
    )
    assert not private.is_public
    assert private.public().header.fingerprint == public.header.fingerprint


def test_a_public_bundle_validates_but_does_not_score(bundle: Bundle) -> None:
    truth = GroundTruth.from_bundle(bundle.public(), origin="val_unseen.public.npz")
    submission = [submitted(here, Answer(here.item.path, 3)) for here in episodes_of(SPLIT)]
    assert not validate(submission, split=SPLIT, ground_truth=truth).notes
    with pytest.raises(
        GroundTruthError, match=r"val_unseen\.public\.npz is a public bundle.*solution"
    ):
        evaluate(submission, split=SPLIT, ground_truth=truth)


# The bundles that ship with the package.

SPLITS = ["train.npz", "val_seen.npz", "val_unseen.npz", "test.public.npz", "private/test.npz"]
DEMO = [
    *SPLITS,
    *(f"{task}/{name}" for task in ("r2r", "ndh", "soon") for name in SPLITS),
    *(f"{task}/{name}" for task in ("r4r", "rxr") for name in SPLITS if "test" not in name),
]


def test_these_bundles_ship_with_the_package() -> None:
    assert sorted(DEMO) == sorted(
        path.relative_to(DEMO_BUNDLES).as_posix() for path in DEMO_BUNDLES.rglob("*.npz")
    )


@pytest.mark.parametrize("name", DEMO)
def test_the_embedded_bundle_is_what_the_demo_world_compiles_to(
    name: str, regenerated: Path
) -> None:
    """If this fails, run `python -m fixtures.bundles`."""
    embedded, expected = Bundle.load(DEMO_BUNDLES / name), Bundle.load(regenerated / name)
    assert embedded.header == expected.header
    assert content_of(embedded)[2] == content_of(expected)[2]


# Where the ground truth of a split is found.


@pytest.fixture
def bundles(bundle: Bundle, tmp_path: Path) -> Path:
    """Fill a folder with bundles of a dataset that is not the demo."""
    folder = tmp_path / "bundles"
    folder.mkdir()
    for split in ("val_seen", "val_unseen"):
        renamed = replace(bundle, header=replace(bundle.header, split=split, dataset="custom"))
        renamed.save(folder / f"{split}.npz")
        renamed.public().save(folder / f"{split}.public.npz")
    (folder / "val_seen.npz").unlink()
    return folder


def test_a_loaded_ground_truth_is_used_as_it_is(demo: GroundTruth) -> None:
    assert find_ground_truth(demo, SPLIT) is demo


@pytest.mark.parametrize("of_type", [str, Path])
def test_a_bundle_file(of_type: Callable[[Path], str | Path], bundles: Path) -> None:
    path = bundles / "val_unseen.public.npz"
    truth = find_ground_truth(of_type(path), SPLIT)
    assert truth.origin == str(path)
    assert truth.solution is None


@pytest.mark.parametrize(
    ("split", "name"),
    [
        pytest.param("val_unseen", "val_unseen.npz", id="full goes before public"),
        pytest.param("val_seen", "val_seen.public.npz", id="public alone"),
    ],
)
def test_a_folder_of_bundles(split: str, name: str, bundles: Path) -> None:
    assert find_ground_truth(bundles, split).origin == str(bundles / name)


def test_the_environment_variable_gives_a_path(
    bundles: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(GROUND_TRUTH_VARIABLE, str(bundles))
    assert find_ground_truth(None, SPLIT).origin == str(bundles / "val_unseen.npz")


def test_an_argument_overrides_the_environment_variable(
    bundles: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(GROUND_TRUTH_VARIABLE, "/nowhere")
    assert find_ground_truth(bundles, SPLIT).origin == str(bundles / "val_unseen.npz")


@pytest.mark.parametrize("split", ["train", "val_seen", "val_unseen", "test"])
def test_the_demo_world_is_the_default(split: str) -> None:
    truth = find_ground_truth(None, split)
    assert truth.is_demo
    assert truth.split == split
    assert "demo world" in truth.provenance


def test_the_demo_world_does_not_tell_where_it_is_installed(run: Run) -> None:
    status, _, err = run(str(SAMPLES / "good.json"), "--split", "test")
    assert status == 2
    assert "the demo world's test.public.npz is a public bundle" in err
    assert str(DEMO_BUNDLES) not in err


@pytest.mark.parametrize(
    ("prepare", "mode"),
    [
        pytest.param(lambda bundle: bundle, 0o600, id="with the solution"),
        pytest.param(Bundle.public, 0o644, id="public"),
    ],
)
def test_new_bundles_with_answers_are_for_their_owner(
    prepare: Callable[[Bundle], Bundle], mode: int, tmp_path: Path
) -> None:
    umask = os.umask(0o022)
    try:
        prepare(Bundle.load(DEMO_BUNDLES / "val_seen.npz")).save(tmp_path / "new.npz")
    finally:
        os.umask(umask)
    assert stat.S_IMODE((tmp_path / "new.npz").stat().st_mode) == mode


def test_the_demo_world_keeps_its_test_answers_in_a_separate_bundle() -> None:
    assert find_ground_truth(None, "test").solution is None


Place = Callable[[Path], Path]


@pytest.mark.parametrize(
    ("place", "split", "message"),
    [
        pytest.param(
            lambda bundles: bundles / "none",
            SPLIT,
            "there is no ground truth at {place}; `reverie-eval compile` creates it",
            id="nothing there",
        ),
        pytest.param(
            lambda bundles: bundles / "val_unseen.npz",
            "test",
            "{place} is the ground truth of val_unseen, not of test",
            id="file of another split",
        ),
        pytest.param(
            lambda bundles: bundles,
            "test",
            "{place} has no split 'test'; choose one of: val_seen, val_unseen",
            id="folder of other splits",
        ),
        pytest.param(
            lambda bundles: bundles.parent,
            SPLIT,
            "there are no bundles in {place}; if it is the dataset itself, run `reverie-eval "
            "compile {place} --split val_unseen -o val_unseen.npz` first",
            id="folder without bundles",
        ),
        pytest.param(
            lambda bundles: _of_other_tasks(bundles.parent),
            SPLIT,
            "{place} has no bundles of REVERIE, only of other tasks: r2r, rxr; choose one of these "
            "tasks, or another folder",
            id="folder with bundles of other tasks",
        ),
        pytest.param(
            lambda _: DEMO_BUNDLES,
            "val",
            "the demo world has no split 'val'; choose one of: test, train, val_seen, val_unseen",
            id="unknown split of the demo world",
        ),
    ],
)
def test_a_ground_truth_that_cannot_be_found(
    place: Place, split: str, message: str, bundles: Path
) -> None:
    with pytest.raises(GroundTruthError) as error:
        find_ground_truth(place(bundles), split)
    assert str(error.value) == message.format(place=place(bundles))


def _of_other_tasks(parent: Path) -> Path:
    folder = parent / "sisters"
    for task in ("rxr", "r2r"):
        (folder / task).mkdir(parents=True, exist_ok=True)
        (folder / task / f"{SPLIT}.npz").touch()
    return folder


def test_a_loaded_ground_truth_of_another_split(demo: GroundTruth) -> None:
    with pytest.raises(GroundTruthError, match="is the ground truth of val_unseen, not of test"):
        find_ground_truth(demo, "test")
