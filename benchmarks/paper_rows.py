"""The rows of REVERIE's paper on names instead of pictures: trained, run, and printed as a table.

``scripts/paper_rows DATASET TRAIN BUNDLES OUT`` trains each agent and runs it on val_seen and
val_unseen, one after the other in one thread, and goes on where it was interrupted. DATASET is a
clone of the dataset's repository, TRAIN its training annotations (which may be elsewhere), BUNDLES
the folder of the compiled splits, OUT a folder for models and runs; ``--seeds 0 1 2`` are the
seeds. ``--print`` prints the table of what is there: means over the seeds, and 95 % intervals over
targets and, of several seeds, over these as well.

Nothing is chosen by val_seen or val_unseen: training stops by what it holds back of train.
"""

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from reverie_eval import GroundTruth, Runs, Scores, evaluate
from reverie_eval.ground_truth import Bundle, pack_texts

SPLITS = ("val_seen", "val_unseen")
POINTER = "mattnet"
METRICS = ("success", "oracle_success", "spl", "rgs", "rgspl")
OTHERS = "others"
"""The folder, beside the bundles, of those whose episodes have each other's instructions."""


class Row(NamedTuple):
    """A row of the table."""

    title: str
    model: str
    """The recipe."""
    walk: str = ""
    """How a navigator walks; empty for a pointer, which is led to the goal."""
    bundles: str = ""
    """A folder within that of the bundles."""


ROWS = (
    Row("name-RNN, at the goal", "name-rnn"),
    Row("MAttNet, at the goal", "mattnet"),
    Row("CM-Erase, at the goal", "cm-erase"),
    Row("R2R-TF", "r2r-tf", "greedy"),
    Row("R2R-SF", "r2r-sf", "greedy"),
    Row("RCM", "rcm", "greedy"),
    Row("SelfMonitor", "self-monitor", "greedy"),
    Row("FAST-Short", "self-monitor", "fast"),
    Row("FAST-Short, another episode's instruction", "self-monitor", "fast", OTHERS),
    Row("FAST-Lan-Only", "fast-lan-only", "fast"),
    Row("Interactive Navigator-Pointer", "interactive", "fast"),
)


def main() -> None:
    """Train and run what is missing, or print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    for name in ("dataset", "train", "bundles", "out"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--print", action="store_true", help="print the table of what is there")
    given = parser.parse_args()
    if given.print:
        print("\n".join(table(given.bundles, given.out, given.seeds)))
        return
    for split in SPLITS:
        exchange_instructions(given.bundles, split)
    for seed in given.seeds:
        pointer = given.out / "models" / f"{POINTER}.{seed}"
        train(POINTER, given, seed)
        for row in ROWS:
            train(row.model, given, seed, *(["--pointer", str(pointer)] if row.walk else []))
            for split in SPLITS:
                run(row, given, split, seed)


def exchange_instructions(bundles: Path, split: str) -> None:
    """Give each episode the instruction of another one, half a split later."""
    file = bundles / OTHERS / f"{split}.npz"
    if file.exists():
        return
    bundle = Bundle.load(bundles / f"{split}.npz")
    texts = GroundTruth.from_bundle(bundle).episodes.instructions
    half = len(texts) // 2
    packed = pack_texts([*texts[half:], *texts[:half]])
    file.parent.mkdir(exist_ok=True)
    replace(bundle, texts={**bundle.texts, "instruction": packed}).save(file)


def train(model: str, given: argparse.Namespace, seed: int, *options: str) -> None:
    """Train a model, unless it is there."""
    folder = given.out / "models" / f"{model}.{seed}"
    data = ["--data", str(given.dataset), "--annotations", str(given.train)]
    command("train", model, *data, "--seed", str(seed), "-o", str(folder), *options)


def run(row: Row, given: argparse.Namespace, split: str, seed: int) -> None:
    """Run a model, unless the run has ended."""
    folder = run_folder(given.out, row, split, seed)
    if (folder / "submission.json").exists():
        return
    walk = ["--option", f"walk={row.walk}"] if row.walk else []
    truth = ["--split", split, "--ground-truth", str(given.bundles / row.bundles / f"{split}.npz")]
    model = given.out / "models" / f"{row.model}.{seed}"
    command("run", str(model), *truth, *walk, "-o", str(folder))


def run_folder(out: Path, row: Row, split: str, seed: int) -> Path:
    """Return the folder of a run."""
    parts = (split, row.model, str(seed), row.walk, row.bundles)
    return out / "runs" / ".".join(filter(None, parts))


def command(*words: str) -> None:
    """Run a command of reverie-eval in one thread; end with its message if it fails."""
    print(f"reverie-eval {' '.join(words)}", flush=True)
    one_thread = {**os.environ, "OMP_NUM_THREADS": "1"}
    program = [sys.executable, "-m", "reverie_eval_cli", *words]
    if subprocess.run(program, env=one_thread, check=False).returncode:
        sys.exit(1)


def table(bundles: Path, out: Path, seeds: Sequence[int]) -> Iterator[str]:
    """Yield the table of the rows that were run, a Markdown table for each split."""
    for split in SPLITS:
        truth = GroundTruth.load(bundles / f"{split}.npz")
        yield f"\n{split}\n"
        yield "| row | seeds | TL m | SR % | OSR % | SPL % | RGS % | RGSPL % |"
        yield "|---|---:|---:|---:|---:|---:|---:|---:|"
        shares: list[str] = []
        for row in ROWS:
            files = {
                str(seed): run_folder(out, row, split, seed) / "submission.json" for seed in seeds
            }
            runs = {
                seed: evaluate(file, split=split, ground_truth=truth)
                for seed, file in files.items()
                if file.exists()
            }
            if runs:
                yield f"| {row.title} | {len(runs)} | {' | '.join(values(runs))} |"
            if runs and not row.walk:
                shares.append(name_shares(row.title, truth, [files[seed] for seed in runs]))
        yield from ("", *shares)


def values(runs: Mapping[str, Scores]) -> Iterator[str]:
    """Yield the mean of each metric, and the interval of those that are shares."""
    only = next(iter(runs.values()))
    scored = Runs.of(runs) if len(runs) > 1 else only.with_intervals()
    assert scored.intervals is not None  # noqa: S101  # they were asked for
    yield f"{scored['path_length']:.2f}"
    for key in METRICS:
        low, high = scored.intervals[key].low, scored.intervals[key].high
        yield f"{100 * scored[key]:.2f} ({100 * low:.1f} to {100 * high:.1f})"


def name_shares(title: str, truth: GroundTruth, files: Sequence[Path]) -> str:
    """Say how often a pointer chose an object of the right name, and then the right one."""
    solution = truth.require_solution()
    names = np.array(solution.candidate_categories)
    target, _ = solution.find(solution.target_object, solution.goal)
    there = [names[solution.candidate_viewpoint == at] for at in solution.goal]
    n_equal = np.array(
        [np.count_nonzero(its == name) for its, name in zip(there, names[target], strict=True)]
    )
    has_rivals = n_equal > 1
    predicted = (
        np.array([each["predObjId"] for each in json.loads(file.read_bytes())]) for file in files
    )
    chosen = np.stack([solution.find(its, solution.goal)[0] for its in predicted])
    is_named = names[chosen] == names[target]
    is_right = (chosen == target)[is_named & has_rivals]
    return (
        f"{title} (chance {np.mean([1 / len(its) for its in there]):.2%}): right name "
        f"{is_named.mean():.2%}; {has_rivals.mean():.2%} of the targets have rivals of their name, "
        f"of which, if the name is right, it chose the right one in {is_right.mean():.2%} "
        f"(chance {np.mean(1 / n_equal[has_rivals]):.2%})"
    )


if __name__ == "__main__":
    main()
