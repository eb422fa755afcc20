"""Measure how fast and how small reading and scoring are, on the published files: scripts/bench.

Times are those of the processors, so that other work on the machine disturbs little, and medians.
Nearly all are ratios to a well-known operation, measured in turns. Larger files are val_unseen many
times over, with ids of their own. Exit status: 1 if a figure misses its bar.
Needs the published files (see fixtures/published.py).
"""

import argparse
import gzip
import json
import os
import platform
import re
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from resource import RUSAGE_CHILDREN, RUSAGE_SELF, getrusage
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import orjson

sys.path.insert(0, str(Path(__file__).parents[1]))

import reverie_eval as rv
from fixtures.published import published_folder, unpack_dataset
from reverie_eval.scoring import evaluate_many
from reverie_eval.submissions import MAX_MEBIBYTES_VARIABLE, align, read_predictions
from reverie_eval.tasks import find_task

SPLIT = "val_unseen"
SUBMISSION = f"{SPLIT}.mixed1"
SPLITS = ("val_seen", "val_unseen", "test")
COPIES = (10, 285)
"""35,210 and 1,003,485 episodes."""
FILES = 1_000
HEADLINE = tuple(find_task("reverie").headline)
FIDELITY = ("dtw", "ndtw", "sdtw", "cls")
REVERIE_EVAL = str(Path(sys.executable).with_name("reverie-eval"))
PACKAGES = ("reverie-eval", "numpy", "msgspec", "pydantic", "orjson")

NUMPY_ALONE = """
import os
os.environ["OPENBLAS_THREAD_TIMEOUT"] = "4"
import numpy
"""
"""As the command does it; otherwise threads of numpy's library wait for work in a busy loop."""

PEAK_MEMORY = """
import re, sys
from pathlib import Path
import reverie_eval as rv
def kibibytes(figure):
    return int(re.search(figure + r":\\s+(\\d+)", Path("/proc/self/status").read_text())[1])
evaluate = rv.evaluate  # which imports what it needs
floor = kibibytes("VmRSS")
evaluate(sys.argv[1], split="val_unseen", ground_truth=sys.argv[2])
print(1024 * (kibibytes("VmHWM") - floor))
"""
"""Read from Linux: the memory of a process after its imports, and its peak."""


PARSE_AGAIN = """
import sys
from pathlib import Path
import orjson
content = Path(sys.argv[1]).read_bytes()
for _ in range(int(sys.argv[2])):
    orjson.loads(content)
"""
"""Parse a file so many times, in a process that shares nothing with others."""


class Figure(NamedTuple):
    """What was measured."""

    name: str
    value: float
    most: float | None = None
    least: float | None = None

    @property
    def bar(self) -> str:
        """The bar in words, and whether the figure meets it."""
        if self.most is not None:
            return f"at most {self.most:5.2f}   {'ok' if self.value <= self.most else 'MISSED'}"
        if self.least is not None:
            return f"at least {self.least:4.2f}   {'ok' if self.value >= self.least else 'MISSED'}"
        return ""


def main() -> int:
    """Print every figure; return 1 if one misses its bar."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--output", type=Path, metavar="FILE", help="also write them as JSON")
    parser.add_argument("--compare", type=Path, metavar="OLD", help="print these beside them")
    arguments = parser.parse_args()
    folder = published_folder()
    if folder is None:
        print("the published REVERIE files are not here (REVERIE_DATA names their folder)")
        return 2
    earlier = json.loads(arguments.compare.read_text())["figures"] if arguments.compare else {}
    figures = []
    # A file of a million episodes is larger than any that is sent to us.
    os.environ[MAX_MEBIBYTES_VARIABLE] = "1000"
    with TemporaryDirectory() as temporary:
        for figure in measure(folder, Path(temporary)):
            before = f"{earlier[figure.name]:9.2f} ->" if figure.name in earlier else ""
            print(f"{figure.name:58}{before}{figure.value:9.2f}   {figure.bar}", flush=True)
            figures.append(figure)
    if arguments.output:
        arguments.output.write_text(json.dumps(report(figures), indent=2) + "\n")
    return int(any(figure.bar.endswith("MISSED") for figure in figures))


def report(figures: Sequence[Figure]) -> dict[str, object]:
    """Return the figures with what they depend on."""
    git = ["git", "describe", "--always", "--dirty"]
    return {
        "commit": subprocess.run(git, check=False, capture_output=True, text=True).stdout.strip(),
        "machine": {"system": platform.platform(), "processors": os.cpu_count()},
        "versions": {
            "python": platform.python_version(),
            **{package: version(package) for package in PACKAGES},
        },
        "figures": {figure.name: figure.value for figure in figures},
    }


def measure(folder: Path, work: Path) -> Iterator[Figure]:
    """Yield every figure as soon as it is there."""
    compiling = cpu_seconds(lambda: compile_all(unpack_dataset(folder, work), work))
    bundle, submission = work / f"{SPLIT}.npz", work / f"{SUBMISSION}.json"
    with gzip.open(folder / "reference" / "submissions" / f"{SUBMISSION}.json.gz") as packed:
        submission.write_bytes(packed.read())
    content, truth = submission.read_bytes(), rv.GroundTruth.load(bundle)

    ours, parser = in_turns(partial(score, content, truth), partial(orjson.loads, content), 100)
    yield Figure(episodes("bytes to scores / orjson.loads", truth), ours / parser, most=0.9)
    first = ours / len(truth.episodes.instr_ids)
    yield Figure("microseconds for each of them", 1e6 * first)
    read = partial(read_predictions, content, truth.task, truth.graph)
    reading, aligning = in_turns(read, partial(align, read(), truth), 50)
    yield Figure("of that: reading / orjson.loads", reading / parser)
    yield Figure("of that: alignment / orjson.loads", aligning / parser)
    yield Figure("of that: hints and metrics / orjson.loads", (ours - reading - aligning) / parser)
    for copies in COPIES:
        if copies * len(content) * 8 > available_bytes():
            print(f"left out for lack of memory: {copies} times {SPLIT}")
            continue
        large, many = repeated(content, copies), repeated_truth(truth, copies)
        score(large, many)  # which makes the tables of the ground truth for all later calls
        ours, parser = in_turns(
            partial(score, large, many), partial(orjson.loads, large), max(2, 100 // copies)
        )
        yield Figure(episodes("bytes to scores / orjson.loads", many), ours / parser, most=0.35)
        growth = ours / len(many.episodes.instr_ids) / first
        yield Figure(episodes("cost of an episode / that of 3,521", many), growth, most=1.3)

    with_path, table = in_turns(
        partial(score, content, truth, (*HEADLINE, *FIDELITY)), partial(score, content, truth), 30
    )
    yield Figure("with path fidelity / score table", with_path / table, most=10.0)
    for name, write in FORMS.items():
        other = json.dumps(write(json.loads(content))).encode()
        form, official = in_turns(partial(score, other, truth), partial(score, content, truth), 30)
        yield Figure(f"{name} / official form", form / official, most=1.5)

    command = partial(run, REVERIE_EVAL, submission, "--split", SPLIT, "--ground-truth", bundle)
    ours, imports = in_turns(command, partial(run, sys.executable, "-c", "import numpy"), 20)
    yield Figure("command / import numpy", ours / imports, most=1.7)
    ours, imports = in_turns(command, partial(run, sys.executable, "-c", NUMPY_ALONE), 20)
    yield Figure("command / import numpy, without busy threads", ours / imports)
    peaks = [int(run(sys.executable, "-c", PEAK_MEMORY, submission, bundle)) for _ in range(5)]
    # The first process may compile modules, which leaves memory free that is then used again.
    peak = statistics.median(peaks)
    yield Figure("peak memory / size of the file", peak / len(content), most=3.0)
    loading = min(cpu_seconds(lambda: rv.GroundTruth.load(bundle)) for _ in range(20))
    yield Figure("load a bundle, ms", 1000 * loading, most=20.0)
    yield Figure("compile three splits, s", compiling, most=15.0)
    yield from many_files(submission, truth, parser=parser_seconds(content))
    # Not above: every further process would import the server, too.
    from benchmarks.server import compare_fields

    uploads = compare_fields(
        work, bundle, content, json.dumps(FORMS["a field more"](json.loads(content))).encode()
    )
    yield Figure("uploads a second: one field more / none", uploads, least=0.9)


def many_files(submission: Path, truth: rv.GroundTruth, parser: float) -> Iterator[Figure]:
    """Yield how fast many files are scored, in this process and in two."""
    files = [submission.with_name(f"{number}.json") for number in range(FILES)]
    for file in files:
        file.symlink_to(submission)

    def make_table(jobs: int) -> list[list[float]]:
        scored = evaluate_many(files, split=SPLIT, ground_truth=truth, jobs=jobs)
        # Processes compute the metrics of the table, and this one computes them when it is asked.
        return [[scores[metric.key] for metric in scored.metrics] for scores in scored.values()]

    def score_all(jobs: int) -> tuple[float, float]:
        start = time.perf_counter()
        used = cpu_seconds(lambda: make_table(jobs))
        return used, time.perf_counter() - start

    rounds = [(score_all(1), score_all(2)) for _ in range(2)]
    (one, one_wall), (two, two_wall) = (
        [min(each) for each in zip(*results, strict=True)] for results in zip(*rounds, strict=True)
    )
    parsers = [parse(submission, 1) / parse(submission, 2) for _ in range(3)]
    yield Figure("1,000 files: files a second and processor", FILES / two, least=90.0)
    yield Figure("a parser alone reads", 1 / parser)
    yield Figure("1,000 files: work of two processes / of one", two / one)
    yield Figure("1,000 files: speed of two processes / of one", one_wall / two_wall, least=1.8)
    yield Figure("speed of two parsers / of one", statistics.median(parsers))


def parse(submission: Path, jobs: int) -> float:
    """Return for how long so many processes parse a file a thousand times in all."""
    start = time.perf_counter()
    command = [sys.executable, "-c", PARSE_AGAIN, str(submission), str(FILES // jobs)]
    processes = [subprocess.Popen(command) for _ in range(jobs)]
    for process in processes:
        if process.wait():
            raise subprocess.CalledProcessError(process.returncode, command)
    return time.perf_counter() - start


def as_duet(records: list[dict[str, Any]]) -> object:
    """Write records as DUET does: nested hops, and the object as text."""
    hops = [[[viewpoint] for viewpoint, *_ in record["trajectory"]] for record in records]
    return [
        {**record, "trajectory": each, "predObjId": str(record["predObjId"])}
        for record, each in zip(records, hops, strict=True)
    ]


FORMS: Mapping[str, Callable[[list[dict[str, Any]]], object]] = {
    "a field more": lambda records: [{**record, "note": "a: b"} for record in records],
    "DUET's form": as_duet,
    "HAMT's form": lambda records: [{**it, "predObjId": str(it["predObjId"])} for it in records],
    "NaviLLM's form": lambda records: [
        {**it, "pred_objid": str(it["predObjId"]), "pred_obj_direction": None} for it in records
    ],
    "bare viewpoints": lambda records: [
        {**it, "trajectory": [pose[0] for pose in it["trajectory"]]} for it in records
    ],
    "keyed records": lambda records: {it["instr_id"]: it for it in records},
    "boxes": lambda records: [
        {**it, "predObjId": -1, "predBox": [10, 20, 30, 40], "predView": 12} for it in records
    ],
    "boxes without views": lambda records: [
        {**it, "predObjId": -1, "predBox": [10, 20, 30, 40]} for it in records
    ],
}
"""Valid forms besides the official one."""


def compile_all(dataset: Path, into: Path) -> None:
    """Compile every split with the command line."""
    for split in SPLITS:
        run(REVERIE_EVAL, "compile", dataset, "--split", split, "-o", into)


def score(content: bytes, truth: rv.GroundTruth, keys: Sequence[str] = HEADLINE) -> Sequence[float]:
    """Score a submission and compute these metrics; they are computed on first access."""
    scores = rv.evaluate(content, split=SPLIT, ground_truth=truth)
    return [scores[key] for key in keys]


def repeated(content: bytes, copies: int) -> bytes:
    """Return a file of many times as many records, each copy with ids of its own."""
    records = content.strip().removeprefix(b"[").removesuffix(b"]")
    ids = re.compile(rb'("instr_id": "[^"]+)"')
    copy = (ids.sub(rb'\1-%d"' % number, records) for number in range(copies))
    return b"[" + b",".join(copy) + b"]"


def repeated_truth(truth: rv.GroundTruth, copies: int) -> rv.GroundTruth:
    """Return the ground truth of such a file."""
    whole, solution = truth.episodes, truth.require_solution()
    ids = tuple(f"{each}-{number}" for number in range(copies) for each in whole.instr_ids)
    episodes = replace(
        whole, instr_ids=ids, item=np.tile(whole.item, copies), start=np.tile(whole.start, copies)
    )
    solution = replace(
        solution,
        target_object=np.tile(solution.target_object, copies),
        goal=np.tile(solution.goal, copies),
    )
    return replace(truth, episodes=episodes, solution=solution)


def episodes(name: str, truth: rv.GroundTruth) -> str:
    """Name a figure after the number of episodes that it is measured on."""
    return f"{name}, {len(truth.episodes.instr_ids):,} episodes"


def parser_seconds(content: bytes) -> float:
    """Return the time that a parser takes for a file."""
    return min(cpu_seconds(lambda: orjson.loads(content)) for _ in range(50))


def in_turns(
    first: Callable[[], object], second: Callable[[], object], rounds: int
) -> tuple[float, float]:
    """Return the median times of two actions, in seconds of the processors."""
    pairs = [(cpu_seconds(first), cpu_seconds(second)) for _ in range(rounds)]
    return statistics.median(one for one, _ in pairs), statistics.median(two for _, two in pairs)


def cpu_seconds(action: Callable[[], object]) -> float:
    """Return the processors' time for one call, in this process and in those that it starts."""
    start = used_seconds()
    action()
    return used_seconds() - start


def used_seconds() -> float:
    """Return the processors' time that was used so far; of processes that have ended, too."""
    usages = [getrusage(who) for who in (RUSAGE_SELF, RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def available_bytes() -> int:
    """Return the memory that is free."""
    found = re.search(r"MemAvailable:\s+(\d+)", Path("/proc/meminfo").read_text())
    return 1024 * int(found[1]) if found else 0


def run(command: str, *arguments: str | Path) -> str:
    """Run a command and return what it prints; modules are compiled once, as after installation."""
    words = [shutil.which(command) or command, *map(str, arguments)]
    variables = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    return subprocess.run(words, check=True, capture_output=True, text=True, env=variables).stdout


if __name__ == "__main__":
    sys.exit(main())
