"""The rows of REVERIE's paper on names instead of pictures: trained, run, and written as tables.

``scripts/paper_rows DATASET TRAIN BUNDLES OUT`` trains each agent and runs it on val_seen and
val_unseen, one after the other in one thread, and goes on where it was interrupted. DATASET is a
clone of the dataset's repository, TRAIN its training annotations (which may be elsewhere), BUNDLES
the folder of the compiled splits, OUT a folder for models and runs. ``--seeds`` are the seeds;
seeds do not share anything, so two processes with a seed each are twice as fast. ``--page FILE``
writes the tables of what is there into a page, between its comments ``<!-- table:NAME -->`` and
``<!-- end -->``: means over the seeds, with 95 % intervals over targets and, of several seeds, over
these as well. It also draws the page's picture.

Nothing is chosen by val_seen or val_unseen: training stops by what it holds back of train.
"""

import argparse
import json
import os
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

sys.path.insert(0, str(Path(__file__).parents[1]))

from reverie_eval import GroundTruth, Runs, Scores, compare, evaluate, published_results
from reverie_eval.ground_truth import Bundle, pack_texts
from reverie_eval.reporting.drawing import BLUE, GREY, VERMILION
from reverie_eval.reporting.figures import STYLE
from reverie_eval.text import count_text
from reverie_eval_cli.main import main as reverie_eval

SPLITS = ("val_seen", "val_unseen")
POINTER = "mattnet"
METRICS = ("path_length", "success", "oracle_success", "spl", "rgs", "rgspl")
MAIN = frozenset({"success", "rgs", "rgspl"})
"""Metrics whose intervals are shown."""
HEADINGS = "TL m | SR | OSR | SPL | RGS | RGSPL |"
NAMES = "directions, names, boxes"


class Row(NamedTuple):
    """A row of a table."""

    title: str
    recipe: str
    walk: str = ""
    """How a navigator walks; empty for a pointer, which is led to the goal."""
    reads: str = NAMES
    """The input of the agent on names, apart from the instruction."""
    paper_reads: str = "pictures"
    """The input of the paper's agent, apart from the instruction."""
    without: tuple[str, ...] = ()
    """Inputs that it was trained without."""
    bundles: str = ""
    """How the episodes that it walked were changed, a key of :data:`CHANGES`; empty for none."""

    @property
    def model(self) -> str:
        """The name of the model, before its seed."""
        return "-".join((self.recipe, *self.without))


POINTERS = (
    Row("name-RNN", "name-rnn", reads="names"),
    Row("MAttNet", "mattnet", reads="names, boxes"),
    Row("CM-Erase", "cm-erase", reads="names, boxes"),
)
LAN_ONLY = "directions; at the stop, "
SELF_MONITOR = Row("SelfMonitor", "self-monitor", "greedy")
FAST = SELF_MONITOR._replace(title="FAST-Short", walk="fast")
NAVIGATORS = (
    Row("R2R-TF", "r2r-tf", "greedy"),
    Row("R2R-SF", "r2r-sf", "greedy"),
    Row("RCM", "rcm", "greedy"),
    SELF_MONITOR,
    FAST,
    Row("FAST-Lan-Only", "fast-lan-only", "fast", f"{LAN_ONLY}names, boxes", f"{LAN_ONLY}pictures"),
    Row("Interactive Navigator-Pointer", "interactive", "fast"),
)
MISLED = (
    FAST._replace(title="with another episode's instruction", bundles="others"),
    FAST._replace(title="without instruction", bundles="silent"),
    FAST._replace(title="with the names of other objects of the building", bundles="shuffled"),
)
LIKELIEST = FAST._replace(title="with log-probabilities in its queue", walk="likeliest")
ABLATIONS = (
    FAST,
    *MISLED,
    LIKELIEST,
    FAST._replace(title="trained without names", without=("names", "matches")),
    FAST._replace(title="trained without matches of names", without=("matches",)),
    FAST._replace(title="trained without geometry", without=("geometry",)),
    FAST._replace(title="trained without memory", without=("memory",)),
)
ORDERS = (
    ("R2R-TF", "R2R-SF", "success"),
    ("R2R-SF", "RCM", "success"),
    ("SelfMonitor", "FAST-Short", "success"),
    ("FAST-Lan-Only", "FAST-Short", "success"),
    ("FAST-Short", "Interactive Navigator-Pointer", "success"),
    ("name-RNN", "MAttNet", "rgs"),
    ("CM-Erase", "MAttNet", "rgs"),
)
"""Pairs of the paper's rows, the second ahead of the first there on val_unseen, and the metric."""
PUBLISHED_AS = {"name-RNN": "Baseline"}
DRAWN = {
    "oracle_success": "passes a goal (OSR)",
    "success": "stops at one (SR)",
    "rgspl": "and answers (RGSPL)",
}
"""Metrics of the picture, and what they mean."""
WALKED = (SELF_MONITOR, FAST, LIKELIEST)
DRAWN_ROWS = {
    "one network walks greedily, as FAST-Short, and by log-probabilities": ("o-", BLUE, WALKED),
    "FAST-Short with another instruction, with none, and with other names": (
        "X",
        VERMILION,
        MISLED,
    ),
    "other rows on names": ("s", GREY, [row for row in NAVIGATORS if row not in WALKED]),
}
"""Rows of the picture, with their look."""
PICTURE = "../pictures/without-vision.svg"
"""The picture of a page, from the page's folder."""


class Folders(NamedTuple):
    """Where everything is."""

    dataset: Path
    train: Path
    bundles: Path
    out: Path

    def model(self, row: Row, seed: int) -> Path:
        """Return the folder of a model."""
        return self.out / "models" / f"{row.model}.{seed}"

    def run(self, row: Row, split: str, seed: int) -> Path:
        """Return the folder of a run."""
        parts = (split, row.model, str(seed), row.walk, row.bundles)
        return self.out / "runs" / ".".join(filter(None, parts))

    @property
    def seconds(self) -> Path:
        """The log of processor seconds: of each command, and what it made."""
        return self.out / "seconds.txt"


def main() -> None:
    """Train and run what is missing, or write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    for name in Folders._fields:
        parser.add_argument(name, type=Path)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--ablations", action="store_true", help="train and run these as well")
    parser.add_argument("--page", type=Path, help="write the tables of what is there into it")
    given = parser.parse_args()
    folders = Folders(*(getattr(given, name) for name in Folders._fields))
    if given.page:
        results = Results(folders, given.seeds)
        write_tables(given.page, results)
        draw(given.page.parent / PICTURE, results)
        return
    for seed in given.seeds:
        for row in (*POINTERS, *NAVIGATORS, *(ABLATIONS if given.ablations else ())):
            train(row, folders, seed)
            for split in SPLITS:
                run(row, folders, split, seed)


# What is done to episodes before an agent walks them. The submission is scored on the true ones.


def exchange_instructions(bundle: Bundle) -> Mapping[str, Any]:
    """Give each episode the instruction of another one, half a split later."""
    texts = GroundTruth.from_bundle(bundle).episodes.instructions
    half = len(texts) // 2
    return {"instruction": pack_texts([*texts[half:], *texts[:half]])}


def silence_instructions(bundle: Bundle) -> Mapping[str, Any]:
    """Take the instructions away."""
    return {"instruction": pack_texts([""] * len(bundle.arrays["instr_id"]))}


def shuffle_names(bundle: Bundle) -> Mapping[str, Any]:
    """Give each object the name of another one in its building, the same from everywhere."""
    truth = GroundTruth.from_bundle(bundle)
    solution = truth.require_solution()
    scans = truth.graph.viewpoint_scan[solution.candidate_viewpoint].tolist()
    objects = list(zip(scans, solution.candidate_object.tolist(), strict=True))
    name_of = dict(zip(objects, solution.candidate_categories, strict=True))
    shuffled: dict[tuple[int, int], str] = {}
    for scan in sorted({*scans}):
        its = sorted(each for each in name_of if each[0] == scan)
        names = [name_of[each] for each in its]
        Random(scan).shuffle(names)  # noqa: S311
        shuffled |= dict(zip(its, names, strict=True))
    return {"candidate_category": pack_texts([shuffled[each] for each in objects])}


CHANGES: Mapping[str, Callable[[Bundle], Mapping[str, Any]]] = {
    "others": exchange_instructions,
    "silent": silence_instructions,
    "shuffled": shuffle_names,
}


def bundle_of(row: Row, folders: Folders, split: str) -> Path:
    """Return the bundle whose episodes a row walks, and make it if it is not there."""
    file = folders.bundles / row.bundles / f"{split}.npz"
    if not file.exists():
        bundle = Bundle.load(folders.bundles / f"{split}.npz")
        file.parent.mkdir(exist_ok=True)
        replace(bundle, texts={**bundle.texts, **CHANGES[row.bundles](bundle)}).save(file)
    return file


# Commands.


def train(row: Row, folders: Folders, seed: int) -> None:
    """Train a model, unless it is there."""
    if (folders.model(row, seed) / "model.safetensors").exists():
        return
    words = ["train", row.recipe, "--data", str(folders.dataset)]
    words += ["--annotations", str(folders.train), "--seed", str(seed)]
    for name in row.without:
        words += ["--option", f"{name}=false"]
    if row.walk:
        pointer = Row(POINTER, POINTER)
        train(pointer, folders, seed)
        words += ["--pointer", str(folders.model(pointer, seed))]
    command(folders, folders.model(row, seed), *words)


def run(row: Row, folders: Folders, split: str, seed: int) -> None:
    """Run a model, unless the run has ended."""
    folder = folders.run(row, split, seed)
    if (folder / "submission.json").exists():
        return
    walk = ["--option", f"walk={row.walk}"] if row.walk else []
    truth = ["--split", split, "--ground-truth", str(bundle_of(row, folders, split))]
    command(folders, folder, "run", str(folders.model(row, seed)), *truth, *walk)


def command(folders: Folders, made: Path, *words: str) -> None:
    """Make a folder by a command of reverie-eval, and log its processor seconds.

    Ends with the command's message if it fails.
    """
    folders.out.mkdir(parents=True, exist_ok=True)
    print(f"reverie-eval {' '.join(words)} -o {made}", flush=True)
    before = sum(os.times()[:4])
    status = reverie_eval([*words, "-o", str(made)])
    seconds = sum(os.times()[:4]) - before
    with folders.seconds.open("a", encoding="utf-8") as log:
        log.write(f"{seconds:.1f} {made.relative_to(folders.out).as_posix()}\n")
    if status:
        sys.exit(1)


# Tables.


class Results:
    """The scores of what was run."""

    def __init__(self, folders: Folders, seeds: Sequence[int]) -> None:
        self._folders, self.seeds = folders, seeds
        self.truths = {
            split: GroundTruth.load(folders.bundles / f"{split}.npz") for split in SPLITS
        }
        self._scored: dict[tuple[Row, str], Mapping[str, Scores]] = {}

    def made(self, rows: Sequence[Row]) -> Mapping[str, set[tuple[Path, ...]]]:
        """Return the folders of models and runs of some rows, those of all seeds together."""
        model, run = self._folders.model, self._folders.run
        return {
            "model": {tuple(model(row, seed) for seed in self.seeds) for row in rows},
            "run": {
                tuple(run(row, split, seed) for seed in self.seeds)
                for row, split in product(rows, SPLITS)
            },
        }

    def minutes(self) -> Mapping[Path, float]:
        """Return how long the processor took to make each folder."""
        minutes: dict[Path, float] = defaultdict(float)  # what was interrupted has several lines
        for each in self._folders.seconds.read_text("utf-8").splitlines():
            seconds, folder = each.split()
            minutes[self._folders.out / folder] += float(seconds) / 60
        return minutes

    def files(self, row: Row, split: str) -> Mapping[str, Path]:
        """Return the submissions of a row, by seed."""
        files = {
            str(seed): self._folders.run(row, split, seed) / "submission.json"
            for seed in self.seeds
        }
        return {seed: file for seed, file in files.items() if file.exists()}

    def runs(self, row: Row, split: str) -> Mapping[str, Scores]:
        """Return the scores of a row's runs, by seed."""
        if (row, split) not in self._scored:
            truth = self.truths[split]
            self._scored[row, split] = {
                seed: evaluate(file, split=split, ground_truth=truth)
                for seed, file in self.files(row, split).items()
            }
        return self._scored[row, split]

    def scored(self, row: Row, split: str) -> Scores | Runs | None:
        """Return the scores of a row with their intervals; None if it was not run."""
        runs = self.runs(row, split)
        if len(runs) > 1:
            return Runs.of(runs)
        return next((each.with_intervals() for each in runs.values()), None)

    def cells(self, row: Row, split: str, metrics: Sequence[str] = METRICS) -> Iterator[str]:
        """Yield the number of seeds and the metrics of a row, or nothing if it was not run."""
        scored = self.scored(row, split)
        if scored is None:
            return
        assert scored.intervals is not None  # noqa: S101  # they were asked for
        yield str(len(self.runs(row, split)))
        for key in metrics:
            value = scored[key]
            if key == "path_length":
                yield f"{value:.2f}"
            elif key in MAIN:
                ends = scored.intervals[key]
                yield f"{100 * value:.2f} ({100 * ends.low:.1f} to {100 * ends.high:.1f})"
            else:
                yield f"{100 * value:.2f}"


def published(title: str, split: str) -> Mapping[str, float]:
    """Return what the paper reports of a method."""
    key = "reverie", PUBLISHED_AS.get(title, title), split
    return next(
        each.scores for each in published_results() if (each.task, each.method, each.split) == key
    )


def table_rows(results: Results, split: str) -> Iterator[str]:
    """Yield the rows of navigators, each after the paper's."""
    yield f"| row | input | seeds | {HEADINGS}"
    yield "|---|---|---:|---:|---:|---:|---:|---:|---:|"
    for row in NAVIGATORS:
        paper = published(row.title, split)
        values = (
            "" if key not in paper else f"{paper[key] * (key == 'path_length' or 100):.2f}"
            for key in METRICS
        )
        yield line(f"{row.title}, paper", row.paper_reads, "", *values)
        if cells := list(results.cells(row, split)):
            yield line(row.title, row.reads, *cells)


def table_ablations(results: Results, split: str) -> Iterator[str]:
    """Yield FAST-Short, and what it does without some of its inputs."""
    yield f"| FAST-Short | seeds | {HEADINGS}"
    yield "|---|---:|---:|---:|---:|---:|---:|---:|"
    for row in ABLATIONS:
        if cells := list(results.cells(row, split)):
            yield line("as it is" if row == FAST else row.title, *cells)


def table_pointers(results: Results) -> Iterator[str]:
    """Yield how often pointers find the target at the goal, beside the paper's and chance."""
    yield "| pointer | input | seeds | val_seen | val_unseen |"
    yield "|---|---|---:|---:|---:|"
    chances = [
        f"{100 * np.mean([1 / len(its) for its in names_at_goals(truth)[1]]):.2f}"
        for truth in results.truths.values()
    ]
    yield line("chance", "", "", *chances)
    for row in POINTERS:
        title = "CNN-RNN" if row.title in PUBLISHED_AS else row.title
        values = (f"{100 * published(row.title, split)['rgs']:.2f}" for split in SPLITS)
        yield line(f"{title}, paper", "pictures", "", *values)
        cells = [list(results.cells(row, split, ["rgs"])) for split in SPLITS]
        if all(cells):
            yield line(row.title, row.reads, cells[0][0], *(each[1] for each in cells))


def table_grounding(results: Results) -> Iterator[str]:
    """Yield how often a pointer chooses an object of the right name, and then the right one."""
    yield (
        "| pointer | split | seeds | right name | has rivals of its name "
        "| the right one of these | chance |"
    )
    yield "|---|---|---:|---:|---:|---:|---:|"
    for row in POINTERS:
        for split, truth in results.truths.items():
            files = results.files(row, split)
            if files:
                shares = name_shares(truth, [*files.values()])
                values = (f"{100 * each:.2f}" for each in shares)
                yield line(row.title, split, str(len(files)), *values)


def names_at_goals(truth: GroundTruth) -> tuple[np.ndarray, Sequence[np.ndarray]]:
    """Return the target's name of each episode, and the names of all objects at its goal."""
    solution = truth.require_solution()
    names = np.array(solution.candidate_categories)
    target, _ = solution.find(solution.target_object, solution.goal)
    return names[target], [names[solution.candidate_viewpoint == at] for at in solution.goal]


def name_shares(truth: GroundTruth, files: Sequence[Path]) -> Sequence[float]:
    """Return the shares of the grounding table, means over some submissions.

    How often an object of the right name is chosen; how many targets have rivals of their name; of
    these, if the name is right, how often the right one is chosen, and would be by chance.
    """
    solution = truth.require_solution()
    names = np.array(solution.candidate_categories)
    right, there = names_at_goals(truth)
    target, _ = solution.find(solution.target_object, solution.goal)
    n_equal = np.array(
        [np.count_nonzero(its == name) for its, name in zip(there, right, strict=True)]
    )
    has_rivals = n_equal > 1
    predicted = (
        np.array([each["predObjId"] for each in json.loads(file.read_bytes())]) for file in files
    )
    chosen = np.stack([solution.find(its, solution.goal)[0] for its in predicted])
    is_named = names[chosen] == right
    is_right = (chosen == target)[is_named & has_rivals]
    chance = (1 / n_equal[has_rivals]).mean()
    return [float(each) for each in (is_named.mean(), has_rivals.mean(), is_right.mean(), chance)]


def table_orders(results: Results) -> Iterator[str]:
    """Yield by how much rows that the paper has ahead of others are ahead of them."""
    yield "| | metric | seeds | val_seen | in the paper | val_unseen | in the paper |"
    yield "|---|---|---:|---:|---:|---:|---:|"
    by_title = {row.title: row for row in (*POINTERS, *NAVIGATORS)}
    for behind, ahead, metric in ORDERS:
        pair = by_title[behind], by_title[ahead]
        cells: list[str] = []
        for split in SPLITS:
            first, second = (results.scored(row, split) for row in pair)
            if first is None or second is None:
                break
            comparison = compare(first, second, names=["first", "second"])
            change = comparison["second"][metric].mean
            ends = comparison.intervals["second"][metric]
            in_paper = published(ahead, split)[metric] - published(behind, split)[metric]
            cells += [
                f"{100 * change:+.2f} ({100 * ends.low:+.1f} to {100 * ends.high:+.1f})",
                f"{100 * in_paper:+.2f}",
            ]
        else:
            counts = {len(results.runs(row, split)) for row in pair for split in SPLITS}
            seeds = " or ".join(map(str, sorted(counts)))
            label = "SR" if metric == "success" else "RGS"
            yield line(f"{ahead} over {behind}", label, seeds, *cells)


def what_is_missing(results: Results) -> Iterator[str]:
    """Say which rows were not run."""
    rows = (*POINTERS, *NAVIGATORS, *ABLATIONS)
    missing = [
        f"{row.title} ({split})"
        for split in SPLITS
        for row in rows
        if not results.files(row, split)
    ]
    yield f"Not run yet: {', '.join(missing)}." if missing else "All rows were run."


def what_it_took(results: Results) -> Iterator[str]:
    """Say how long the processor took. A seed that was not measured counts as the others' mean."""
    minutes, counted, whole = results.minutes(), set[tuple[Path, ...]](), 0.0
    for title, rows in ("The rows", (*POINTERS, *NAVIGATORS)), ("FAST-Short, changed", ABLATIONS):
        parts = []
        for kind, its in results.made(rows).items():
            took = [[minutes[each] for each in seeds if each in minutes] for seeds in its - counted]
            measured = [each for each in took if each]
            total = len(results.seeds) * sum(map(np.mean, measured))
            count = count_text(len(results.seeds) * len(measured), kind)
            parts.append(f"{count} in {total:.1f} minutes, {sum(map(len, measured))} measured")
            whole += total
            counted |= its
        yield f"{title}: {'; '.join(parts)}."
    yield f"Together {whole:.1f} minutes of one processor, or {whole / 2:.1f} of two."


TABLES: Mapping[str, Callable[[Results], Iterator[str]]] = {
    "unseen": lambda results: table_rows(results, "val_unseen"),
    "seen": lambda results: table_rows(results, "val_seen"),
    "pointers": table_pointers,
    "grounding": table_grounding,
    "orders": table_orders,
    "ablations-unseen": lambda results: table_ablations(results, "val_unseen"),
    "ablations-seen": lambda results: table_ablations(results, "val_seen"),
    "missing": what_is_missing,
    "minutes": what_it_took,
}


def line(*cells: str) -> str:
    """Return a line of a table."""
    return f"| {' | '.join(cells)} |"


def write_tables(page: Path, results: Results) -> None:
    """Write the tables into a page, in place of those that are there."""
    text = page.read_text("utf-8")
    for name, table in TABLES.items():
        begin, end = f"<!-- table:{name} -->\n", "<!-- end -->"
        before, place, rest = text.partition(begin)
        _, is_closed, after = rest.partition(end)
        if not is_closed:
            sys.exit(f"{page} has no place for the table {name!r}: {begin.strip()} ... {end}")
        lines = "\n".join(table(results))
        text = f"{before}{place}\n{lines}\n\n{end}{after}"
    page.write_text(text, "utf-8")


# The picture.


def draw(file: Path, results: Results) -> None:
    """Draw metrics of rows on val_unseen over the metres that they walk."""
    with mpl.rc_context({**STYLE, "svg.fonttype": "none"}):
        figure = Figure(figsize=(9.5, 3.8), layout="constrained")
        for axes, (key, title) in zip(figure.subplots(1, 3), DRAWN.items(), strict=True):
            for label, (marker, colour, rows) in DRAWN_ROWS.items():
                its = [scored for row in rows if (scored := results.scored(row, "val_unseen"))]
                metres = [each["path_length"] for each in its]
                percent = [100 * each[key] for each in its]
                axes.plot(metres, percent, marker, color=colour, label=label)
            axes.set(xscale="log", xlabel="metres walked", xlim=(9, 150), ylim=(0, 50))
            axes.set_title(f"{title}, %", loc="left", fontsize="medium")
            axes.set_xticks(ticks := (10, 20, 50, 100), map(str, ticks))
            axes.minorticks_off()
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower left", frameon=False)
        figure.savefig(file, metadata={"Date": None})


if __name__ == "__main__":
    main()
