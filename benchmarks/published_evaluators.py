"""How long published evaluators take for a file, beside us; their own code, on the published files.

``python benchmarks/published_evaluators.py REVERIE VLN-DUET`` takes clones of YuankaiQi/REVERIE and
cshizhe/VLN-DUET. Packages that their modules import and their evaluation does not use (a simulator,
deep learning) are replaced by empty ones. Times are those of the processor: from a fresh process to
the scores of one file, and for each further file. The best of several, in turns.
"""

import gzip
import json
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import redirect_stdout
from io import StringIO
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import MagicMock

sys.path.insert(0, str(Path(__file__).parents[1]))

from fixtures.published import published_folder, unpack_dataset

SPLIT = "val_unseen"
SUBMISSION = f"{SPLIT}.mixed1"
ROUNDS = 5
UNUSED = ("MatterSim", "torch", "torch.cuda", "nltk", "nltk.corpus", "h5py", "jsonlines")

SHOWN = ("success", "spl")

Scorer = Callable[[], Sequence[float]]


def main() -> int:
    """Print the times of each evaluator."""
    if len(sys.argv) != len(("", "REVERIE", "VLN-DUET")):
        print(__doc__)
        return 2
    folder = published_folder()
    if folder is None:
        print("the published REVERIE files are not here (REVERIE_DATA names their folder)")
        return 2
    clones = [Path(each).resolve() for each in sys.argv[1:]]
    with TemporaryDirectory() as temporary:
        work = Path(temporary)
        dataset = unpack_dataset(folder, work)
        submission = work / "submit.json"
        with gzip.open(folder / "reference" / "submissions" / f"{SUBMISSION}.json.gz") as packed:
            submission.write_bytes(packed.read())
        bundle = work / "bundle.npz"
        in_own_process(compile_bundle, dataset, bundle)
        evaluators = {
            "eval_release.py of the dataset": (official, clones[0], dataset, submission),
            "DUET's evaluator": (duet, clones[1], dataset, submission),
            "reverie-eval": (ours, bundle, submission),
        }
        print(f"{'':32}{'one file, s':>12}{'each further, ms':>18}{'SR %':>8}{'SPL %':>8}")
        best: dict[str, tuple[float, float]] = {}
        scores: dict[str, Sequence[float]] = {}
        for _ in range(ROUNDS):
            for name, arguments in evaluators.items():
                first, further, scores[name] = in_own_process(timed, *arguments)
                before = best.get(name, (first, further))
                best[name] = (min(first, before[0]), min(further, before[1]))
    for name, (first, further) in best.items():
        shown = "".join(f"{score:8.2f}" for score in scores[name])
        print(f"{name:32}{first:12.2f}{1000 * further:18.1f}{shown}")
    return 0


def in_own_process(function: Callable[..., Any], *arguments: object) -> Any:
    """Call a function where no other evaluator's modules are imported; return what it returns."""
    with ProcessPoolExecutor(1, mp_context=get_context("fork")) as executor:
        return executor.submit(function, *arguments).result()


def timed(prepare: Callable[..., Scorer], *arguments: Path) -> tuple[float, float, Sequence[float]]:
    """Return the seconds from the start to scores, and for another file; SR and SPL."""
    with redirect_stdout(StringIO()):
        start = time.process_time()
        score = prepare(*arguments)
        scores = score()
        first = time.process_time() - start
        start = time.process_time()
        score()
    return first, time.process_time() - start, scores


def compile_bundle(dataset: Path, bundle: Path) -> None:
    """Write the bundle of the split."""
    from reverie_eval.dataset import DatasetFiles, compile_split

    compile_split(DatasetFiles.find(dataset, split=SPLIT), SPLIT).save(bundle)


def ours(bundle: Path, submission: Path) -> Scorer:
    """Load a bundle."""
    import reverie_eval as rv

    evaluator = rv.Evaluator(split=SPLIT, ground_truth=bundle)

    def score() -> Sequence[float]:
        scores = evaluator(submission)
        return [100 * scores[metric.key] for metric in scores.headline if metric.key in SHOWN]

    return score


def official(clone: Path, dataset: Path, submission: Path) -> Scorer:
    """Load what the dataset's script loads."""
    leave_out_unused()
    sys.path.insert(0, str(clone / "tasks" / "REVERIE"))
    import eval_release
    import utilsFast

    # Both find the data beside themselves.
    for module in (eval_release, utilsFast):
        module.__file__ = str(dataset / "tasks" / "REVERIE" / "script.py")
    eval_release.file_path = str(dataset / "tasks" / "REVERIE")
    evaluation = eval_release.Evaluation(SPLIT, "instructions")

    def score() -> Sequence[float]:
        summary = evaluation.score(str(submission), "whole")
        return [100 * summary["success_rate"], 100 * summary["spl"]]

    return score


def duet(clone: Path, dataset: Path, submission: Path) -> Scorer:
    """Load what DUET's evaluator loads, and its form of the submission."""
    leave_out_unused()
    sys.path.insert(0, str(clone / "map_nav_src"))
    from reverie.env import ReverieObjectNavBatch

    data = dataset / "tasks" / "REVERIE" / "data"
    tasks = json.loads((data / f"REVERIE_{SPLIT}.json").read_text())
    environment = ReverieObjectNavBatch.__new__(ReverieObjectNavBatch)
    environment.scans = {task["scan"] for task in tasks}
    environment.connectivity_dir = str(dataset / "connectivity")
    environment.obj2vps = goals(data / "BBox")
    environment.gt_trajs = {
        f"{task['id']}_{row}": (task["scan"], task["path"], task["objId"])
        for task in tasks
        for row in range(len(task["instructions"]))
    }
    environment._load_nav_graphs()  # noqa: SLF001  # as its constructor does

    def score() -> Sequence[float]:
        records = json.loads(submission.read_bytes())
        for record in records:
            record["trajectory"] = [[viewpoint] for viewpoint, *_ in record["trajectory"]]
            record["pred_objid"] = record["predObjId"]
        means, _ = environment.eval_metrics(records)
        return [means["sr"], means["spl"]]

    return score


def goals(boxes: Path) -> dict[str, list[str]]:
    """Return the viewpoints from which each object is visible, by DUET's key."""
    found: dict[str, list[str]] = {}
    for file in sorted(boxes.iterdir()):
        scan = file.name.split("_")[0]
        for viewpoint, objects in json.loads(file.read_text()).items():
            for object_id, seen in objects.items():
                if seen["visible_pos"]:
                    found.setdefault(f"{scan}_{object_id}", []).append(viewpoint)
    return found


def leave_out_unused() -> None:
    """Put empty packages in the place of those that evaluations do not use."""
    for name in UNUSED:
        sys.modules.setdefault(name, MagicMock())


if __name__ == "__main__":
    sys.exit(main())
