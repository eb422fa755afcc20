"""The ground truth of a split as scoring uses it, how it is found, and declared subsets of it."""

import hashlib
import json
import os
import shlex
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from reverie_eval.arrays import Array, FloatArray, IntArray, offsets_of
from reverie_eval.errors import (
    SHOWN_PROBLEMS,
    GroundTruthError,
    Problem,
    ProtocolError,
    ReverieEvalError,
    SubsetError,
)
from reverie_eval.ground_truth._bundle import Bundle, BundleHeader, bundle_name, unpack_texts
from reverie_eval.ground_truth._graph import NavigationGraph
from reverie_eval.ground_truth._ids import InstrIdTable
from reverie_eval.ground_truth._solution import Solution
from reverie_eval.tasks import (
    BUILT_IN,
    DEFAULT_TASK,
    ITEM_MARK,
    TO_REGION,
    Protocol,
    Task,
    find_task,
)
from reverie_eval.text import (
    category_text,
    count_text,
    did_you_mean,
    first_few,
    short_digest,
    tokenize,
)

GROUND_TRUTH_VARIABLE = "REVERIE_EVAL_GROUND_TRUTH"
"""The environment variable that names a bundle, or a folder of bundles."""

DEMO_DATASET = "demo"
"""Name of the synthetic dataset that ships with the package."""
DEMO_BUNDLES = Path(__file__).with_name("demo")
"""The bundles of that dataset."""
DEMO_SAMPLES = DEMO_BUNDLES / "submissions.zip"
"""Sample submissions for its val_unseen, which ``reverie-eval demo`` writes."""

NO_CATEGORY = "unnamed"
"""The category of a target that has none in the annotation."""


@dataclass(frozen=True, eq=False)
class Episodes:
    """The public part of the episodes, one row each."""

    instr_ids: tuple[str, ...]
    item: IntArray
    """The item of each episode; episodes of one item share path and target. Each start of SOON's
    items has a path of its own, and so an index of its own here."""
    start: IntArray
    """The viewpoint where each episode starts."""
    heading: FloatArray
    """The heading at which each episode starts, in radians."""
    # Unpacked when needed: scoring does not read them.
    packed_instructions: Array
    packed_languages: Array | None = None
    taken_from: "tuple[Episodes, IntArray] | None" = None
    """The episodes from which some were taken, and the rows of these."""

    def take(self, rows: IntArray) -> "Episodes":
        """Return some of the episodes."""
        instr_ids = tuple(self.instr_ids[row] for row in rows)
        public = self.item[rows], self.start[rows], self.heading[rows]
        # Texts are taken only when they are read: most subsets are only scored.
        return Episodes(instr_ids, *public, self.packed_instructions, taken_from=(self, rows))

    @cached_property
    def instructions(self) -> tuple[str, ...]:
        """The instruction of each episode."""
        if self.taken_from:
            whole, rows = self.taken_from
            return tuple(whole.instructions[row] for row in rows)
        return unpack_texts(self.packed_instructions, "instructions", len(self.instr_ids))

    @cached_property
    def languages(self) -> Sequence[str]:
        """The language of each instruction, such as ``en-US``; none in a task of one language."""
        if self.taken_from:
            whole, rows = self.taken_from
            return [whole.languages[row] for row in rows if whole.languages]
        packed = self.packed_languages
        return () if packed is None else unpack_texts(packed, "languages", len(self.instr_ids))

    @cached_property
    def index(self) -> Mapping[str, int]:
        """The row of each instr_id."""
        return {instr_id: row for row, instr_id in enumerate(self.instr_ids)}

    @cached_property
    def table(self) -> InstrIdTable:
        """The row of each instr_id by its letters."""
        return InstrIdTable(self.instr_ids)

    @cached_property
    def by_short_id(self) -> Mapping[str, str]:
        """The instr_id by its part after the last underscore."""
        return {instr_id.rpartition("_")[2]: instr_id for instr_id in self.instr_ids}

    @cached_property
    def by_item(self) -> Mapping[str, Sequence[str]]:
        """The instr_ids of each item, by what is before their mark."""
        found: dict[str, list[str]] = {}
        for instr_id in self.instr_ids:
            found.setdefault(instr_id.partition(ITEM_MARK)[0], []).append(instr_id)
        return found


@dataclass(frozen=True, eq=False, repr=False)
class GroundTruth:
    """The ground truth of a split; :meth:`load` reads what ``reverie-eval compile`` wrote."""

    header: BundleHeader
    graph: NavigationGraph
    episodes: Episodes
    solution: Solution | None
    """None for a public bundle, which can check a submission but not score it."""
    other_splits: Mapping[str, Array]
    """The instr_ids of the dataset's other splits, to recognise a submission for one of them."""
    origin: str
    """The file it was read from; shown with scores."""
    subset_of: "tuple[GroundTruth, IntArray] | None" = None
    """The ground truth of the whole split and the rows of the episodes, if this is that of some."""
    subset_digest: str = ""
    """The digest of the chosen episodes of a declared subset; empty for all that are scored."""

    @property
    def whole(self) -> "GroundTruth":
        """The ground truth of the whole split: this one, unless it is that of some episodes."""
        return self if self.subset_of is None else self.subset_of[0]

    @classmethod
    def load(cls, file: str | PathLike[str]) -> "GroundTruth":
        """Read a bundle and check that it is complete; its arrays are read-only.

        Raises
        ------
        GroundTruthError
            If the file is not a bundle, is damaged, or has another format version.
        FileNotFoundError
            If there is no such file.
        """
        return cls.from_bundle(Bundle.load(Path(file)), origin=str(file))

    @classmethod
    def from_bundle(cls, bundle: Bundle, origin: str = "memory") -> "GroundTruth":
        """Build the ground truth from a bundle's arrays: of its sample, if it declares one."""
        arrays = bundle.arrays
        item = arrays["episode_task"]
        truth = cls(
            header=bundle.header,
            graph=NavigationGraph.from_arrays(arrays),
            episodes=Episodes(
                instr_ids=tuple(arrays["instr_id"].tolist()),
                item=item,
                start=arrays["task_start"][item],
                heading=arrays["task_heading"][item],
                packed_instructions=bundle.texts["instruction"],
                packed_languages=bundle.texts.get("language"),
            ),
            solution=Solution.from_bundle(bundle),
            other_splits=bundle.other_splits,
            origin=origin,
        )
        return truth.subset(bundle.header.episodes) if bundle.header.episodes else truth

    def __repr__(self) -> str:
        kind = "public, " if self.solution is None else ""
        count = count_text(len(self.episodes.instr_ids), "episode")
        some = f", subset {self.subset_digest}" if self.subset_digest else ""
        return f"<GroundTruth of {self.split}, {kind}{count}{some}, from {self.origin}>"

    def subset(self, instr_ids: Iterable[str]) -> "GroundTruth":
        """Return the ground truth of some episodes, for quick or costly evaluations.

        Submissions may have predictions for other episodes of the split as well; these are checked
        and left out. Signatures distinguish such scores from those of the whole split.

        Raises
        ------
        SubsetError
            If there are none, or some are unknown or listed twice; lists every problem.
        """
        listed = [each for given in instr_ids for each in self._episodes_of(given)]
        rows = _subset_rows(listed, self.episodes.index, self.split)
        chosen = self._take(rows)
        return replace(chosen, subset_digest=subset_digest(chosen.episodes.instr_ids))

    def _episodes_of(self, given: str) -> Sequence[str]:
        """Return the episodes that an id means: of an item, all; a short id is that of one."""
        if given not in self.episodes.index:
            if self.task.has_short_ids:
                return [self.episodes.by_short_id.get(given, given)]
            if self.task.has_items:
                return self.episodes.by_item.get(given, [given])
        return [given]

    def scored_by(self, protocol: Protocol) -> "GroundTruth":
        """Return the ground truth of the episodes and annotated paths that a protocol scores by."""
        return self.first_instructions(protocol.scored_instructions).along(protocol.reference)

    def first_instructions(self, number: int | None) -> "GroundTruth":
        """Return the ground truth of the first instructions of each path; None for all."""
        if number is None:
            return self
        whole, rows = self.subset_of or (self, np.arange(len(self.episodes.instr_ids)))
        item = whole.episodes.item
        # The episodes of a path follow each other, so its first one is where its number begins.
        index = np.arange(len(item)) - np.searchsorted(item, item)
        is_scored = index[rows] < number
        if is_scored.all():
            return self
        scored = self._take(np.flatnonzero(is_scored))
        digest = subset_digest(scored.episodes.instr_ids) if self.subset_digest else ""
        return replace(scored, subset_digest=digest)

    def along(self, reference: str) -> "GroundTruth":
        """Return the ground truth with another path to score by; "" for the usual one.

        It is one of the further annotated paths, or ``TO_REGION``.
        """
        if not reference or self.solution is None:
            return self
        solution = self.solution
        if reference == TO_REGION:
            paths = list(self._paths_to_region(solution))
            further = np.concatenate(paths), offsets_of(np.array([len(path) for path in paths]))
            solution = replace(
                solution, further_paths={**solution.further_paths, reference: further}
            )
        return replace(self, solution=solution.along(reference, self.episodes.item))

    def _paths_to_region(self, solution: Solution) -> Iterator[IntArray]:
        """Yield each item's planner's path if it ends at a goal, else the route to a goal."""
        # Many items start at the same viewpoint.
        routes = cache(self.graph.routes_from)
        path, offsets = solution.further_paths["planner"]
        goal, goal_offsets = solution.goals()
        planned = np.split(path, offsets[1:-1])
        for way, region in zip(planned, np.split(goal, goal_offsets[1:-1]), strict=True):
            if way[-1] in region:
                yield way
            else:
                yield np.array(min((routes(way[0])[end] for end in region), key=len))

    def _take(self, rows: IntArray) -> "GroundTruth":
        solution = self.solution and self.solution.take(rows)
        whole, all_rows = self.subset_of or (self, np.arange(len(self.episodes.instr_ids)))
        episodes = self.episodes.take(rows)
        return replace(
            self, episodes=episodes, solution=solution, subset_of=(whole, all_rows[rows])
        )

    @property
    def task(self) -> Task:
        """The task of the split."""
        return find_task(self.header.task)

    @property
    def split(self) -> str:
        """The split, such as ``val_unseen``."""
        return self.header.split

    @property
    def fingerprint(self) -> str:
        """SHA-256 of everything that scores depend on."""
        return self.header.fingerprint

    @property
    def is_demo(self) -> bool:
        """Whether this is the synthetic world that ships with the package."""
        return self.header.dataset == DEMO_DATASET

    @property
    def provenance(self) -> str:
        """A description of this ground truth, shown with scores."""
        return self._described(self.origin)

    @property
    def shared_provenance(self) -> str:
        """A description of this ground truth for others, without the folder of its file."""
        # A report that is sent to others need not show the folders of a machine.
        return self._described(Path(self.origin).name)

    def _described(self, origin: str) -> str:
        if self.is_demo:
            return f"the synthetic demo world that ships with reverie-eval, not {self.task.title}"
        return f"{origin} ({self.header.dataset})"

    @property
    def scans(self) -> Sequence[str]:
        """The scan of each episode."""
        return [self.graph.scan_of(start) for start in self.episodes.start]

    @property
    def categories(self) -> Sequence[str]:
        """The annotated category of each episode's target, in lower case.

        Raises
        ------
        GroundTruthError
            If the bundle is public.
        ProtocolError
            If the task has no target objects.
        """
        annotated = self.require_targets().target_categories
        # Spellings that differ in case or spaces are one category.
        names = [category_text(name).strip().lower() or NO_CATEGORY for name in annotated]
        return [names[item] for item in self.episodes.item]

    def row_of(self, instr_id: str) -> int:
        """Return the row of an episode.

        Raises
        ------
        ReverieEvalError
            If the split has no such episode.
        """
        row = self.episodes.index.get(instr_id)
        if row is None:
            raise ReverieEvalError(self._unknown_episode(instr_id))
        return row

    def _unknown_episode(self, instr_id: str) -> str:
        from difflib import get_close_matches  # slow to import, and only needed in errors

        known = self.episodes.instr_ids
        close = get_close_matches(str(instr_id), known)
        examples = f"did you mean {first_few(close)}?" if close else f"it has {first_few(known)}"
        number = count_text(len(known), "episode")
        return f"no episode {instr_id!r} among the {number} of {self.split}; {examples}"

    def require_targets(self) -> Solution:
        """Return the solution of a task with target objects.

        Raises
        ------
        GroundTruthError
            If this is a public bundle.
        ProtocolError
            If the task has no target objects.
        """
        if not self.task.has_targets:
            raise ProtocolError(f"{self.task.title} has no target objects")
        return self.require_solution()

    def require_solution(self) -> Solution:
        """Return the solution.

        Raises
        ------
        GroundTruthError
            If this is a public bundle.
        """
        if self.solution is None:
            raise GroundTruthError(
                f"{self.origin} is a public bundle: it can check a {self.split} submission "
                "(`reverie-eval validate`), but has no solution, which scores and agents need"
            )
        return self.solution


def find_ground_truth(
    given: str | PathLike[str] | GroundTruth | None,
    split: str,
    task: str | None = None,
    subset: Iterable[str] | None = None,
) -> GroundTruth:
    """Return the ground truth of a split, or of a subset of its episodes.

    The first of these that exists is used: ``given``; the path in the environment variable
    ``REVERIE_EVAL_GROUND_TRUTH``; the demo world. A path is a bundle, or a folder with
    ``{split}.npz`` or ``{split}.public.npz``; for tasks other than REVERIE, these may be in a
    subfolder named after the task. The default task is that of the bundle, or REVERIE.

    Raises
    ------
    GroundTruthError
        If there is no ground truth for this split, or the file is not a valid bundle.
    ProtocolError
        If there is no such task.
    SubsetError
        If episodes of the subset are unknown or listed twice; lists every problem.
    """
    if isinstance(given, GroundTruth):
        truth = given
    else:
        named = os.environ.get(GROUND_TRUTH_VARIABLE) if given is None else given
        folder = DEMO_BUNDLES if named is None else Path(named)
        truth = _load(folder, split, find_task(task or DEFAULT_TASK))
    if task is not None and truth.task.name != task:
        raise GroundTruthError(
            f"{truth.origin} is the ground truth of {truth.task.title}, not of "
            f"{find_task(task).title}; choose the task {truth.task.name}, or another bundle"
        )
    if truth.split != split:
        raise GroundTruthError(
            f"{truth.origin} is the ground truth of {truth.split}, not of {split}"
        )
    return truth if subset is None else truth.subset(subset)


def bundled_splits(folder: Path) -> Sequence[str]:
    """Return the splits with a bundle in a folder."""
    return sorted({path.name.split(".")[0] for path in folder.glob("*.npz")})


def bundle_folder(folder: Path, task: str) -> Path:
    """Return the folder of a task's bundles in a folder with those of several tasks."""
    return folder if task == DEFAULT_TASK else folder / task


def _load(path: Path, split: str, task: Task) -> GroundTruth:
    """Load a bundle, or the split's bundle from a folder; the full one comes before the public."""
    own = bundle_folder(path, task.name)
    if own.is_dir():
        path = own
    elif path == DEMO_BUNDLES:
        raise GroundTruthError(
            f"the demo world has no {task.title}; `reverie-eval compile DATASET --task {task.name} "
            f"--split {split} -o bundles/` compiles its files, then pass --ground-truth bundles"
        )
    if not path.exists():
        raise GroundTruthError(
            f"there is no ground truth at {path}; `reverie-eval compile` creates it"
        )
    if path.is_file():
        return GroundTruth.load(path)
    is_demo = path.is_relative_to(DEMO_BUNDLES)
    for public in (False, True):
        bundle = path / bundle_name(split, public=public)
        if bundle.is_file():
            # Where the package is installed concerns nobody who uses the demo world.
            origin = f"the demo world's {bundle.name}" if is_demo else str(bundle)
            return GroundTruth.from_bundle(Bundle.load(bundle), origin)
    splits = bundled_splits(path)
    if splits:
        where = "the demo world" if is_demo else path
        raise GroundTruthError(f"{where} has no split {split!r}{did_you_mean(split, splits)}")
    if others := [each for each in BUILT_IN if bundled_splits(path / each)]:
        raise GroundTruthError(
            f"{path} has no bundles of {task.title}, only of other tasks: {', '.join(others)}; "
            "choose one of these tasks, or another folder"
        )
    name, dataset = bundle_name(split, public=False), shlex.quote(str(path))
    raise GroundTruthError(
        f"there are no bundles in {path}; if it is the dataset itself, run `reverie-eval "
        f"compile {dataset} --split {split} -o {name}` first"
    )


# Declared subsets: some episodes of a split, for quick or costly evaluations. A list of episodes
# has a digest, which is part of the signature of every score: results on a subset are comparable
# with each other, and never with those on the whole split.

# The fields of a record that can hold its id, in any of the tasks.
_ID_KEYS = [
    *dict.fromkeys(key for name in BUILT_IN for key in find_task(name).id_field.names),
    "id",
]
_JSON = ("[", "{", '"')


def read_episode_ids(file: str | PathLike[str]) -> Sequence[str]:
    """Read a list of episodes: an id a line; blank lines are left out.

    A JSON list of ids, of numbers or of records with an id is read as well, and so is a list under
    the only key of an object. The text may be UTF-8 or UTF-16, and begin with a byte order mark.

    Raises
    ------
    SubsetError
        If the file is neither.
    OSError
        If it cannot be read.
    """
    content = Path(file).read_bytes()
    try:
        text = content.decode(json.detect_encoding(content))
    except UnicodeDecodeError:
        message = "is not a text file; expected an instr_id on each line"
        raise SubsetError([Problem("not-text", "file", message)]) from None
    if text.lstrip().startswith(_JSON):
        return _ids_of_json(text)
    return [line.strip() for line in text.splitlines() if line.strip()]


def _ids_of_json(text: str) -> Sequence[str]:
    listed = _parse(text)
    if isinstance(listed, dict) and len(listed) == 1:
        (listed,) = listed.values()
    entries = listed if isinstance(listed, list) else [None]
    ids = [_id_of(each) for each in entries]
    if None in ids:
        where = f"entry {ids.index(None) + 1}" if entries is listed else "file"
        message = 'is not a JSON list of ids; write ["...", "..."], or an id on each line'
        raise SubsetError([Problem("not-a-list", where, message)])
    return [str(each).strip() for each in ids]


def _parse(text: str) -> Any:
    """Parse JSON, or JSON Lines; None if it is neither."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        pass
    try:
        return [json.loads(line) for line in text.splitlines() if line.strip()]
    except (ValueError, RecursionError):
        return None


def _id_of(entry: Any) -> str | int | None:
    """Return the id that an entry of a JSON list is, or has; None if it has none."""
    found = entry
    if isinstance(entry, dict):
        found = next((entry[key] for key in _ID_KEYS if key in entry), None)
    return found if isinstance(found, str | int) and not isinstance(found, bool) else None


def _subset_rows(chosen: Sequence[str], index: Mapping[str, int], split: str) -> IntArray:
    """Return the rows of the chosen episodes, ascending, or raise SubsetError with all problems."""
    if not chosen:
        message = f"no episode is listed; list the instr_ids of some episodes of {split}"
        raise SubsetError([Problem("no-episode", "list", message)])
    if len(chosen) > SHOWN_PROBLEMS and not any(each in index for each in chosen):
        message = (
            f"none of its {len(chosen):,} entries is an episode of {split}, the first is "
            f"{chosen[0]!r}; choose their split"
        )
        raise SubsetError([Problem("unknown-episode", "list", message)])
    first: dict[str, int] = {}
    problems = []
    for number, instr_id in enumerate(chosen, 1):
        where = f"entry {number}"
        if instr_id not in index:
            message = f"{instr_id!r} is not an episode of {split}; remove it, or choose its split"
            problems.append(Problem("unknown-episode", where, message, (number,)))
        elif first.setdefault(instr_id, number) < number:
            message = f"{instr_id} is listed already, in entry {first[instr_id]}; remove one"
            problems.append(Problem("duplicate-episode", where, message, (number,)))
    if problems:
        raise SubsetError(problems)
    return np.array(sorted(index[instr_id] for instr_id in chosen))


def subset_digest(instr_ids: Sequence[str]) -> str:
    """Return the digest of a list of episodes; their order does not matter."""
    return short_digest(_digest("\n".join(sorted(instr_ids))))


def draw_subset(strata: Mapping[str, str], number: int, seed: int, split: str) -> Sequence[str]:
    """Draw episodes at random, from each stratum in proportion to its size.

    Episodes are ordered by the SHA-256 of the seed and their id, so that the same ones are drawn by
    every version of every program.

    Parameters
    ----------
    strata : mapping of str to str
        The stratum of each episode, by instr_id; use a single stratum to draw from all alike.
    number : int
        Number of episodes to draw.
    seed : int
    split : str
        The split's name, for the error.

    Raises
    ------
    ProtocolError
        If there are not that many.
    """
    if not 1 <= number <= len(strata):
        raise ProtocolError(
            f"{split} has {count_text(len(strata), 'episode')}; choose between 1 and all of them, "
            f"got {number:,}"
        )
    members: defaultdict[str, list[str]] = defaultdict(list)
    for instr_id in sorted(strata, key=lambda each: _digest(f"{seed}:{each}")):
        members[strata[instr_id]].append(instr_id)
    # Largest remainders: each stratum has its share, rounded down or up.
    exact = {stratum: number * len(ids) / len(strata) for stratum, ids in members.items()}
    count = {stratum: int(share) for stratum, share in exact.items()}
    by_remainder = sorted(exact, key=lambda each: (count[each] - exact[each], each))
    for stratum in by_remainder[: number - sum(count.values())]:
        count[stratum] += 1
    drawn = {each for stratum, ids in members.items() for each in ids[: count[stratum]]}
    return [instr_id for instr_id in strata if instr_id in drawn]


def find_words(words: Sequence[str], instructions: Mapping[str, str]) -> Sequence[str]:
    """Return the episodes whose instruction has all of the words; see :meth:`Scores.with_words`."""
    wanted = {token for word in words for token in tokenize(word)}
    if not wanted:
        raise ProtocolError("with_words needs a word that instructions may have")
    tokens = {instr_id: set(tokenize(text)) for instr_id, text in instructions.items()}
    chosen = [instr_id for instr_id, found in tokens.items() if wanted <= found]
    if not chosen:
        unknown = sorted(wanted.difference(*tokens.values()))
        which = f": {', '.join(unknown)} is in none of them" if unknown else ""
        raise ProtocolError(f"no instruction has all the words {' '.join(words)!r}{which}")
    return chosen


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
