"""How fast and how small scoring is, on the published REVERIE files.

``python benchmarks/scoring.py`` prints each measurement with its limit. Times that depend on the
machine are ratios to well-known operations, measured alternately in the same run; all values are
medians. Needs the published files (see ``fixtures/published.py``).
"""

import gzip
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import orjson

sys.path.insert(0, str(Path(__file__).parents[1]))

import reverie_eval as rv
from benchmarks.bars import judge
from fixtures.published import published_folder, unpack_dataset

SUBMISSION = "val_unseen.mixed1"
HEADLINE = tuple(key for key, metric in rv.CATALOGUE.items() if metric.headline)
SPLITS = ("val_seen", "val_unseen", "test")
REVERIE_EVAL = str(Path(sys.executable).with_name("reverie-eval"))

PEAK_MEMORY = """
import re, sys
from pathlib import Path
import reverie_eval as rv
def kibibytes(figure):
    return int(re.search(figure + r":\\s+(\\d+)", Path("/proc/self/status").read_text())[1])
floor = kibibytes("VmRSS")
rv.evaluate(sys.argv[1], split="val_unseen", ground_truth=sys.argv[2])
print(1024 * (kibibytes("VmHWM") - floor))
"""
"""Read from Linux: the memory of a process after its imports, and its peak."""


def main() -> int:
    """Print every measurement; return 1 if one is over its limit."""
    folder = published_folder()
    if folder is None:
        print("the published REVERIE files are not here (REVERIE_DATA names their folder)")
        return 2
    with TemporaryDirectory() as temporary:
        work = Path(temporary)
        compile_seconds = compile_all(unpack_dataset(folder, work), work)
        submission = work / f"{SUBMISSION}.json"
        with gzip.open(folder / "reference" / "submissions" / f"{SUBMISSION}.json.gz") as packed:
            submission.write_bytes(packed.read())
        bundle = work / "val_unseen.npz"
        figures = [
            ("bytes to score table / orjson.loads", in_process_ratio(submission, bundle), 3.0),
            ("with path fidelity / score table", fidelity_ratio(submission, bundle), 10.0),
            ("command / import numpy, pydantic", command_ratio(submission, bundle), 1.4),
            ("bundle load, ms", 1000 * load_seconds(bundle), 20.0),
            ("peak memory / file size", peak_memory_ratio(submission, bundle), 8.0),
            ("compile three splits, s", compile_seconds, 15.0),
        ]
    return judge(figures)


def compile_all(dataset: Path, into: Path) -> float:
    """Compile every split with the command line; return the seconds it took."""
    start = time.perf_counter()
    for split in SPLITS:
        run(REVERIE_EVAL, "compile", dataset, "--split", split, "-o", into)
    return time.perf_counter() - start


def in_process_ratio(submission: Path, bundle: Path) -> float:
    """Time scoring from bytes against parsing the same bytes and dropping the result."""
    content = submission.read_bytes()
    truth = rv.GroundTruth.load(bundle)
    return ratio_of_medians(
        lambda: score(content, truth, HEADLINE), lambda: orjson.loads(content), rounds=101
    )


def fidelity_ratio(submission: Path, bundle: Path) -> float:
    """Time scoring with path fidelity against the score table alone."""
    content = submission.read_bytes()
    truth = rv.GroundTruth.load(bundle)
    return ratio_of_medians(
        lambda: score(content, truth, (*HEADLINE, "dtw", "ndtw", "sdtw", "cls")),
        lambda: score(content, truth, HEADLINE),
        rounds=51,
    )


def score(content: bytes, truth: rv.GroundTruth, keys: Sequence[str]) -> list[float]:
    """Score a submission and compute these metrics; they are computed on first access."""
    scores = rv.evaluate(content, split="val_unseen", ground_truth=truth)
    return [scores[key] for key in keys]


def command_ratio(submission: Path, bundle: Path) -> float:
    """Time the whole command against starting Python with two imports."""
    arguments = (submission, "--split", "val_unseen", "--ground-truth", bundle)
    return ratio_of_medians(
        lambda: run(REVERIE_EVAL, *arguments),
        lambda: run(sys.executable, "-c", "import numpy, pydantic"),
        rounds=21,
    )


def load_seconds(bundle: Path) -> float:
    """Time loading a bundle."""
    return statistics.median(seconds(lambda: rv.GroundTruth.load(bundle)) for _ in range(21))


def peak_memory_ratio(submission: Path, bundle: Path) -> float:
    """Return the peak memory of scoring above the imports', bundle included, over the file size."""
    peaks = [int(run(sys.executable, "-c", PEAK_MEMORY, submission, bundle)) for _ in range(5)]
    return float(statistics.median(peaks) / submission.stat().st_size)


def ratio_of_medians(
    first: Callable[[], object], second: Callable[[], object], rounds: int
) -> float:
    """Time two actions alternately, after a warm-up round."""
    pairs = [(seconds(first), seconds(second)) for _ in range(rounds + 1)][1:]
    return statistics.median(a for a, _ in pairs) / statistics.median(b for _, b in pairs)


def seconds(action: Callable[[], object]) -> float:
    """Time one call."""
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


def run(command: str, *arguments: str | Path) -> str:
    """Run a command and return what it prints."""
    words = [shutil.which(command) or command, *map(str, arguments)]
    return subprocess.run(words, check=True, capture_output=True, text=True).stdout


if __name__ == "__main__":
    sys.exit(main())
