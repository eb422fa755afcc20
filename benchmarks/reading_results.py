"""How fast intervals, an evaluator in a training loop, and the report are.

``python benchmarks/reading_results.py`` prints each measurement with its limit, on the published
val_unseen. Times are medians; a ratio is that of the least times of the processors, measured in
turn. Needs the published files (see ``fixtures/published.py``).
"""

import gzip
import json
import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, get_args

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import reverie_eval as rv
from benchmarks.bars import judge
from benchmarks.scoring import HEADLINE, REVERIE_EVAL, SUBMISSION, in_turns, run
from fixtures.published import published_folder, unpack_dataset
from reverie_eval.scoring import Clustering

SPLIT = "val_unseen"
OTHER = f"{SPLIT}.mixed2"
RESAMPLES = 10_000


def main() -> int:
    """Print every measurement; return 1 if one is over its limit."""
    folder = published_folder()
    if folder is None:
        print("the published REVERIE files are not here (REVERIE_DATA names their folder)")
        return 2
    with TemporaryDirectory() as temporary:
        work = Path(temporary)
        bundle = work / f"{SPLIT}.npz"
        dataset = unpack_dataset(folder, work)
        run(REVERIE_EVAL, "compile", dataset, "--split", SPLIT, "-o", bundle)
        submission, other = (unpacked(folder, name, work) for name in (SUBMISSION, OTHER))
        figures = [
            *interval_figures(submission, bundle),
            *evaluator_figures(submission, bundle),
            *report_figures("report with maps", [submission], bundle),
            *report_figures("report on two", [submission, other], bundle),
        ]
    return judge(figures)


def unpacked(folder: Path, name: str, work: Path) -> Path:
    """Unpack a reference submission."""
    submission = work / f"{name}.json"
    with gzip.open(folder / "reference" / "submissions" / f"{name}.json.gz") as packed:
        submission.write_bytes(packed.read())
    return submission


def interval_figures(submission: Path, bundle: Path) -> Sequence[tuple[str, float, float]]:
    """Time the intervals of all metrics, without the per-episode values that they need."""
    scores = rv.evaluate(submission, split=SPLIT, ground_truth=bundle)
    name = f"{RESAMPLES:,} resamples of {len(dict(scores))} metrics, by"
    return [
        (
            f"{name} {by}, s",
            median_seconds(partial(scores.with_intervals, by, resamples=RESAMPLES)),
            0.5,
        )
        for by in get_args(Clustering)
    ]


def evaluator_figures(submission: Path, bundle: Path) -> Sequence[tuple[str, float, float]]:
    """Time an evaluator against scoring the file's bytes, for every kind of predictions."""
    content = submission.read_bytes()
    evaluator = rv.Evaluator(split=SPLIT, ground_truth=bundle)
    truth = evaluator.ground_truth

    def plainly() -> Mapping[str, float]:
        return score_table(rv.evaluate(content, split=SPLIT, ground_truth=truth))

    records = json.loads(content)
    given = {
        "bytes": content,
        "Python records": records,
        "records with numpy's float32": with_numpy(records),
    }

    def against_plainly(predictions: Any) -> float:
        ours, plain = in_turns(lambda: score_table(evaluator(predictions)), plainly, rounds=51)
        return ours / plain

    return [
        (f"evaluator on {name} / plain scoring", against_plainly(predictions), 2.0)
        for name, predictions in given.items()
    ]


def with_numpy(records: Sequence[dict[str, Any]]) -> Sequence[dict[str, Any]]:
    """Return records with numpy numbers, as from an agent whose angles are in an array."""
    return [
        {
            **record,
            "trajectory": [
                (viewpoint, np.float32(heading), np.float32(elevation))
                for viewpoint, heading, elevation in record["trajectory"]
            ],
            "predObjId": np.int64(record["predObjId"]),
        }
        for record in records
    ]


def score_table(scores: rv.Scores) -> Mapping[str, float]:
    """Compute the scores of a score table; they are computed on first access."""
    return {key: scores[key] for key in HEADLINE}


def report_figures(
    name: str, submissions: Sequence[Path], bundle: Path
) -> Sequence[tuple[str, float, float]]:
    """Time the command that writes a report, including start-up, and measure the report's size."""
    page = bundle.with_name("report.html")
    options: list[str | Path] = ["--split", SPLIT, "--ground-truth", bundle, "-o", page]
    words = *submissions, *options
    duration = median_seconds(partial(run, REVERIE_EVAL, "report", *words), rounds=3)
    return [
        (f"{name}, s", duration, 10.0),
        (f"{name}, kB", page.stat().st_size / 1000, 1000.0),
    ]


def median_seconds(action: Callable[[], object], rounds: int = 11) -> float:
    """Time an action, after a warm-up round."""
    times = []
    for _ in range(rounds + 1):
        start = time.perf_counter()
        action()
        times.append(time.perf_counter() - start)
    return statistics.median(times[1:])


if __name__ == "__main__":
    sys.exit(main())
