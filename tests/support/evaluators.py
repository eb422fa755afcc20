"""Run a public codebase's own evaluator on fresh submissions, and compare it with a protocol.

``scripts/evidence evaluator CLONE --protocol duet [--task ndh] [--split val_unseen] [--at FILE]``
finds the evaluator of a task in a clone, gives it the task's published files and a submission drawn
at random on their graphs (walks that reach the goal, stop early, go too far, wander, stay, return
or jump; answers that are right, wrong and missing), and scores the same by the protocol. Every list
of values per episode that the evaluator returns or keeps is compared, and the means it prints. It
exits with 1 if any differs by more than 1e-9.

Found are classes with ``eval_metrics`` (HAMT, DUET, NaviLLM and what grew from them) and with
``_score_item`` (the datasets' own scripts). What the clone imports and this machine lacks, such as
a simulator or torch, is replaced by empty things; its graphs and evaluation are its own.
"""

import argparse
import ast
import importlib
import inspect
import json
import logging
import math
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from datetime import UTC, datetime
from importlib.machinery import ModuleSpec
from io import StringIO
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any

import networkx as nx  # type: ignore[import-untyped]
import numpy as np

from fixtures.published import family_folder, published_folder, unpack_dataset, unpack_task
from reverie_eval import GroundTruth, evaluate
from reverie_eval.dataset import DatasetFiles, compile_split
from reverie_eval.tasks import find_task

WITHIN = 1e-9
"""Metres, and fractions of lengths: published evaluators add up in another order."""
FOLDERS = {"reverie": "reverie", "r2r": "r2r", "ndh": "cvdn|ndh", "soon": "soon"}
"""What a path has in which a codebase evaluates a task."""
TITLES = {"ndh": "CVDN", "r2r": "R2R"}
"""What NaviLLM calls the tasks."""
ANY_TASK = {"env.py", "eval.py"}
"""Files that evaluate a task of which their path says nothing."""
ALREADY_ABSENT: dict[str, ModuleType] = {}
NAMES = {
    "path_length": ("trajectory_lengths", "lengths", "length"),
    "steps": ("trajectory_steps", "steps"),
    "success": ("success", "visible", "sr", "success_rate"),
    "oracle_success": (
        "oracle_success",
        "oracle_visible",
        "oracle_sr",
        "oracle success_rate",
        "oracle_rate",
    ),
    "spl": ("spl",),
    "rgs": ("rgs",),
    "rgspl": ("rgspl",),
    "navigation_error": ("nav_error", "nav_errors"),
    "oracle_error": ("oracle_error", "oracle_errors"),
    "shortest_length": ("shortest_path_lengths", "shortest_lengths"),
    "dtw": ("DTW",),
    "ndtw": ("nDTW",),
    "sdtw": ("SDTW",),
    "cls": ("CLS",),
    "goal_progress": ("gp", "dist_to_end_reductions", "dist_to_end_reduction", "goal_progress"),
    "oracle_path_success": ("oracle path_success_rate",),
    "detection_success": ("det_success", "det_sr"),
    "sfpl": ("det_spl",),
}
"""What evaluators call our metrics."""


# What a clone imports and this machine lacks.


class _Absent:
    """Can be called, subclassed, indexed, and used as a decorator; every attribute is another."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return _Absent()

    def __call__(self, *given: Any, **_: Any) -> Any:
        return given[0] if len(given) == 1 and inspect.isfunction(given[0]) else self

    def __mro_entries__(self, _: object) -> tuple[type, ...]:
        return ()

    def __instancecheck__(self, _: object) -> bool:
        return False

    def __getitem__(self, _: object) -> Any:
        return self

    def __iter__(self) -> Iterator[Any]:
        return iter(())

    def __or__(self, _: object) -> Any:
        return self

    __ror__ = __add__ = __radd__ = __or__


class _AbsentModule(ModuleType):
    def __getattr__(self, name: str) -> Any:
        if name == "__version__":
            return "99"
        if name.startswith("__"):
            raise AttributeError(name)
        return _Absent()


class _Absences:
    """Finds every module that nothing else finds."""

    def find_spec(self, name: str, *_: object) -> ModuleSpec | None:
        if name.partition(".")[0] in sys.stdlib_module_names:
            return None  # that of another system: some packages ask whether it is there
        return ModuleSpec(name, self, is_package=True)  # type: ignore[arg-type]

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        return _AbsentModule(spec.name)

    def exec_module(self, module: ModuleType) -> None:
        ALREADY_ABSENT[module.__name__] = module


def load(file: Path, clone: Path) -> ModuleType:
    """Import a file of a clone under the root from which most of its imports are found."""
    tree = ast.parse(file.read_text("utf-8", "replace"))
    wanted = {
        name.split(".")[0]
        for node in ast.walk(tree)
        for name in (
            [each.name for each in node.names]
            if isinstance(node, ast.Import)
            else [node.module or ""]
            if isinstance(node, ast.ImportFrom) and not node.level
            else []
        )
    }
    roots = [each for each in file.parents if each == clone or clone in each.parents]
    is_relative = any(isinstance(node, ast.ImportFrom) and node.level for node in ast.walk(tree))

    def found_below(root: Path) -> int:
        here = {each.stem for each in root.iterdir() if each.is_dir() or each.suffix == ".py"}
        return len(wanted & here)

    candidates = roots[1:] if is_relative else roots
    root = max(candidates, key=lambda each: (found_below(each), -len(each.parts)))
    sys.path.insert(0, str(root))
    sys.meta_path.append(_Absences())
    module = importlib.import_module(".".join(file.relative_to(root).with_suffix("").parts))
    _tell(f"{file.relative_to(clone)}, without {', '.join(sorted(ALREADY_ABSENT)) or 'nothing'}")
    return module


def evaluators(clone: Path, task: str) -> list[tuple[Path, str]]:
    """Return the files and classes that evaluate a task."""
    files = sorted(clone.rglob("*.py"))
    words = FOLDERS[task].split("|")
    of_task = [each for each in files if _names(each.relative_to(clone), words)]
    return _classes(of_task) or _classes(each for each in files if each.name in ANY_TASK)


def _names(path: Path, words: Sequence[str]) -> bool:
    return any(word in part.lower() for part in path.parts for word in words)


def _classes(files: Iterable[Path]) -> list[tuple[Path, str]]:
    found = []
    for file in files:
        try:
            tree = ast.parse(file.read_text("utf-8", "replace"))
        except SyntaxError:
            continue
        for node in tree.body:
            if isinstance(node, ast.ClassDef):
                methods = {each.name for each in node.body if isinstance(each, ast.FunctionDef)}
                if methods & {"eval_metrics", "_score_item"}:
                    found.append((file, node.name))
    return found


# The files, and a submission.


class Data:
    """A split's published files, its ground truth, and a fresh submission."""

    def __init__(
        self, task: str, split: str, seed: int, folder: Path, *, long_hops: bool, jumps: bool
    ) -> None:
        published, family = published_folder(), family_folder()
        if published is None or family is None:
            raise SystemExit("the published files are not here (REVERIE_DATA names their folder)")
        dataset = unpack_dataset(published, folder)
        self.task, self.split = task, split
        self.connectivity = dataset / "connectivity"
        self.boxes = dataset / "tasks" / "REVERIE" / "data" / "BBox"
        if task == "reverie":
            files = DatasetFiles.find(dataset, split=split, object_positions=_positions(folder))
            self.annotations = dataset / "tasks" / "REVERIE" / "data" / f"REVERIE_{split}.json"
        else:
            unpack_task(family / task, folder / task)
            name = {"r2r": f"R2R_{split}.json", "ndh": f"{split}.json"}.get(
                task, "SYNTHETIC_val_unseen_house.json"
            )
            self.annotations = next((folder / task).rglob(name))
            files = DatasetFiles.find(
                annotations=self.annotations, connectivity=self.connectivity, split=split, task=task
            )
        self.truth = GroundTruth.from_bundle(compile_split(files, split))
        self.records = json.loads(self.annotations.read_text())
        self.scans = {self.truth.graph.scan_of(start) for start in self.truth.episodes.start}
        self._draw(Random(seed), long_hops=long_hops, jumps=jumps)

    def _draw(self, random: Random, *, long_hops: bool, jumps: bool) -> None:
        """Draw a walk and an answer for every episode."""
        truth, graph = self.truth, self.truth.graph
        solution = truth.require_solution()
        by_scan: dict[str, list[int]] = defaultdict(list)
        for viewpoint, scan in enumerate(graph.viewpoint_scan.tolist()):
            by_scan[graph.scan_ids[scan]].append(viewpoint)
        self.walks: dict[str, list[list[str]]] = {}
        self.answers: dict[str, str | None] = {}
        self.points: dict[str, tuple[float, float] | None] = {}
        path, offsets = solution.path.tolist(), solution.path_offsets.tolist()
        for instr_id, item, target in zip(
            truth.episodes.instr_ids, truth.episodes.item, solution.target_object, strict=True
        ):
            annotated = path[offsets[item] : offsets[item + 1]]
            places = by_scan[graph.scan_of(annotated[0])] if jumps else annotated[:1]
            walk = self._walk(random, annotated, places)
            named = [graph.viewpoint_ids[each] for each in walk]
            self.walks[instr_id] = list(_hops(random, named)) if long_hops else [[v] for v in named]
            seen = solution.candidate_object[solution.candidate_viewpoint == walk[-1]].tolist()
            choices = [int(target), *seen, None]
            answer = random.choice(choices)
            self.answers[instr_id] = None if answer is None else str(answer)
            self.points[instr_id] = random.choice(
                [None, (random.random(), random.uniform(0.3, 0.6))]
            )

    def _walk(self, random: Random, annotated: list[int], places: list[int]) -> list[int]:
        def wander(here: int, moves: int) -> list[int]:
            way = []
            for _ in range(moves):
                here = random.choice(list(self.truth.graph.neighbours(here)) or [here])
                way.append(here)
            return way

        start, goal = annotated[0], annotated[-1]
        there = np.array(places, np.int64)
        metres = self.truth.graph.distance_between(np.full_like(there, start), there)
        reachable = there[np.isfinite(metres)].tolist()
        ways = [
            annotated,
            annotated[: random.randint(1, len(annotated))],
            [*annotated, *wander(goal, random.randint(1, 3))],
            [start, *wander(start, random.randint(1, 8))],
            [start],
            [*annotated, *annotated[-2::-1], *annotated[1:]],
            [start, *random.choices(reachable, k=random.randint(0, 3)), goal],
        ]
        return random.choice(ways if len(places) > 1 else ways[:-1])

    def submission(self) -> list[dict[str, Any]]:
        """Return it as this package reads it."""
        if self.task == "soon":
            items: dict[str, list[Any]] = defaultdict(list)
            for instr_id, hops in self.walks.items():
                point = self.points[instr_id] or (None, None)
                items[instr_id.partition("#")[0]].append(
                    {
                        "path": [[v, 0, 0] for hop in hops for v in hop],
                        "obj_heading": point[0],
                        "obj_elevation": point[1],
                    }
                )
            return [{"instr_id": int(key), "trajectory": each} for key, each in items.items()]
        return [
            {"instr_id": key, "trajectory": hops, "predObjId": self._number(key)}
            for key, hops in self.walks.items()
        ]

    def _number(self, instr_id: str) -> int:
        return -1 if self.answers[instr_id] is None else int(self.answers[instr_id] or 0)


def _hops(random: Random, walk: list[str]) -> Iterator[list[str]]:
    """Cut a walk into hops of one to three viewpoints, the first of one."""
    yield walk[:1]
    rest = walk[1:]
    while rest:
        length = random.randint(1, 3)
        yield rest[:length]
        rest = rest[length:]


def _positions(folder: Path) -> Path:
    import lzma

    published = published_folder()
    assert published is not None
    path = folder / "objpos.json"
    path.write_bytes(lzma.decompress((published / "objpos.json.xz").read_bytes()))
    return path


# The two kinds of evaluators.


def with_metrics(_: ModuleType, kind: type, data: Data) -> Iterator[tuple[str, Any, Any]]:
    """Run a class with ``eval_metrics``; yield names, values per episode or means, and ids."""
    it: Any = object.__new__(kind)
    seen = _visible(data.boxes)
    vars(it).update(
        scans=data.scans, connectivity_dir=str(data.connectivity), obj2vps=seen, obj2viewpoint=seen
    )
    it._load_nav_graphs()  # noqa: SLF001  # as its constructor does
    it.gt_trajs, ids = _references(it, kind, data)
    if "obj_heading is not None" not in inspect.getsource(kind):  # it cannot do without a point
        data.points = {key: point or (0.5, 0.5) for key, point in data.points.items()}
    predictions = [
        {
            "instr_id": ids[key],
            "trajectory": _trajectory(kind, hops, data.points[key]),
            "pred_objid": data.answers[key],
            "predObjId": data.answers[key],
            "pred_obj_direction": data.points[key],
        }
        for key, hops in data.walks.items()
    ]
    logger = logging.getLogger("evaluator")
    known = {
        "preds": predictions,
        "logger": logger,
        "name": TITLES.get(data.task),
        "dataset": "r2r",
    }
    wanted = list(inspect.signature(it.eval_metrics).parameters)
    means, values = it.eval_metrics(*(known.get(name) for name in wanted))
    back = {theirs: ours for ours, theirs in ids.items()}
    order = [
        back[each] for each in values.get("instr_id", [each["instr_id"] for each in predictions])
    ]
    percent = {"sr", "oracle_sr", "spl", "rgs", "rgspl", "nDTW", "SDTW", "CLS", "det_sr", "det_spl"}
    percent.add("oracle path_success_rate")
    for name, value in means.items():
        yield name, float(value) / (100 if name in percent else 1), None
    for name, column in values.items():
        if name != "instr_id" and len(column) == len(order):
            yield name, np.array(column, dtype=float), order


def reads_hops(kind: type) -> bool:
    """Whether a class flattens nested hops; otherwise it takes the first of each pose."""
    source = inspect.getsource(sys.modules[kind.__module__])
    return "sum(pred_path, [])" in source or "sum(traj, [])" in source


def _trajectory(kind: type, hops: list[list[str]], point: tuple[float, float] | None) -> Any:
    """Return a trajectory in the form that the class reads."""
    if not reads_hops(kind):
        return [[viewpoint, 0.0, 0.0] for hop in hops for viewpoint in hop]
    if "['trajectory']['path']" in inspect.getsource(kind):
        heading, elevation = point or (None, None)
        return {"path": hops, "obj_heading": [heading], "obj_elevation": [elevation]}
    return hops


def _visible(boxes: Path) -> Mapping[str, Sequence[str]]:
    """Return the viewpoints from which each object is visible, as `obj2vps` has them."""
    found: dict[str, list[str]] = {}
    for file in sorted(boxes.iterdir()):
        scan = file.name.split("_")[0]
        for viewpoint, objects in json.loads(file.read_text()).items():
            for object_id, shown in objects.items():
                if shown["visible_pos"]:
                    found.setdefault(f"{scan}_{object_id}", []).append(viewpoint)
    return found


def _references(it: Any, kind: type, data: Data) -> tuple[Mapping[Any, Any], Mapping[str, Any]]:
    """Return what the evaluator compares with, by its ids, and its id for each of ours."""
    if data.task == "ndh" and hasattr(kind, "load_data"):  # NaviLLM chooses goals in __init__
        _as_navillm(kind, data)
        args = type("Args", (), {"max_datapoints": None, "path_type": "trusted_path"})()
        made = kind(args, None, source="CVDN")
        it.alldata = made.alldata
        return made.gt_trajs, {str(x["inst_idx"]): x["instr_id"] for x in made.alldata}
    items = list(_items(data))
    ids = {each["ours"]: each["instr_id"] for each in items}
    with_objects = data.task == "reverie" and "gt_objid" in inspect.getsource(kind)
    maker = getattr(kind, "_get_gt_trajs", None)
    if maker is not None and (data.task != "reverie" or "_get_gt_trajs" in vars(kind)):
        return maker(it, items), ids
    return {
        each["instr_id"]: (each["scan"], each["path"], *([each["objId"]] if with_objects else []))
        for each in items
    }, ids


def _items(data: Data) -> Iterator[dict[str, Any]]:
    """Yield the episodes as codebases have them after loading."""
    for record in data.records:
        if data.task == "ndh":
            yield {**record, "ours": str(record["inst_idx"]), "instr_id": str(record["inst_idx"])}
        elif data.task == "soon":
            boxes = {each["image_id"]: each for each in record["bboxes"]}
            scan = record.get("scan") or record["bboxes"][0]["scan"]
            for number, path in enumerate(record["path"]):
                id_ = f"{record['instr_id']}#{number}"
                yield {
                    "ours": id_,
                    "instr_id": id_,
                    "path_id": id_,
                    "scan": scan,
                    "path": path,
                    "bboxes": json.loads(json.dumps(boxes)),
                }
        else:
            name = record["id"] if data.task == "reverie" else record["path_id"]
            for number in range(len(record["instructions"])):
                yield {**record, "ours": f"{name}_{number}", "instr_id": f"{name}_{number}"}


def _as_navillm(kind: type, data: Data) -> None:
    """Let NaviLLM's base class load nothing but the annotations and graphs."""
    base = kind.__mro__[1]

    def init(self: Any, *_: Any, **__: Any) -> None:
        self.connectivity_dir, self.scans = str(data.connectivity), data.scans
        self._load_nav_graphs()
        self.alldata, self.gt_trajs = self.load_data(anno_file=data.annotations)

    base.__init__ = init  # type: ignore[misc]


def with_scores(module: ModuleType, kind: type, data: Data) -> Iterator[tuple[str, Any, Any]]:
    """Run a class with ``score``, which keeps lists of values in the order of the file."""
    it: Any = object.__new__(kind)
    graphs = _graphs(data)
    gt: dict[Any, Any] = {}
    for record in data.records:
        key = {"reverie": "id", "r2r": "path_id", "ndh": "inst_idx"}[data.task]
        gt[record[key]] = gt[str(record[key])] = record
        if data.task == "ndh":
            passes = record["planner_path"][-1] in record["player_path"][1:]
            record["trusted_path"] = record["player_path" if passes else "planner_path"]
    proposals: dict[str, Any] = {}
    seen: dict[str, list[str]] = {}
    if data.task == "reverie":
        near = _near(data) if "objpos" in inspect.getsource(module) else None
        for key, viewpoints in _visible(data.boxes).items():
            scan, object_id = key.split("_")
            for viewpoint in viewpoints:
                if near is None or near(scan, object_id, viewpoint):
                    proposals.setdefault(f"{scan}_{viewpoint}", {"objId": []})["objId"].append(
                        object_id
                    )
                    seen.setdefault(key, []).append(viewpoint)
    ids = {int(key) if data.task == "ndh" else key for key in data.walks}
    vars(it).update(
        error_margin=3.0,
        splits=[data.split],
        gt=gt,
        instr_ids=ids,
        scans=data.scans,
        graphs=graphs,
        distances={scan: dict(nx.all_pairs_dijkstra_path_length(g)) for scan, g in graphs.items()},
        objProposals=proposals,
        obj2viewpoint=seen,
        path_type=PATH_TYPE,
    )
    is_typed = "ref_objId == gt['objId']" in inspect.getsource(module)
    records = [
        {
            "instr_id": key,
            **({"inst_idx": int(key)} if data.task == "ndh" else {}),
            "trajectory": [[v, 0.0, 0.0] for hop in hops for v in hop],
            "predObjId": data._number(key) if is_typed else data.answers[key],  # noqa: SLF001
        }
        for key, hops in data.walks.items()
    ]
    with TemporaryDirectory() as folder:
        file = Path(folder, "submit.json")
        file.write_text(json.dumps(records))
        known = {"output_file": str(file), "data": records, "evalType": "whole"}
        wanted = list(inspect.signature(it.score).parameters)
        given = it.score(*(known.get(name) for name in wanted))
    means = given[0] if isinstance(given, tuple) else given
    for name, value in means.items():
        yield name, float(value), None
    order = list(data.walks)
    for name, column in it.scores.items():
        if len(column) == len(order):
            yield name, np.array(column, dtype=float), order


PATH_TYPE = "planner_path"


def _graphs(data: Data) -> Mapping[str, Any]:
    """Return the graphs as every published evaluator loads them."""
    graphs = {}
    for scan in data.scans:
        graph, places = (
            nx.Graph(),
            json.loads((data.connectivity / f"{scan}_connectivity.json").read_text()),
        )
        for here in places:
            for number, connected in enumerate(here["unobstructed"]):
                there = places[number]
                if connected and here["included"] and there["included"]:
                    apart = (
                        sum((here["pose"][at] - there["pose"][at]) ** 2 for at in (3, 7, 11)) ** 0.5
                    )
                    graph.add_edge(here["image_id"], there["image_id"], weight=apart)
        graphs[scan] = graph
    return graphs


def _near(data: Data) -> Any:
    """Whether a camera is at most 3 m from an object's centre: the challenge's condition."""
    graph = data.truth.graph
    centres = json.loads(next(data.annotations.parents[4].glob("objpos.json")).read_text())

    def near(scan: str, object_id: str, viewpoint: str) -> bool:
        if viewpoint not in graph.index or object_id not in centres.get(scan, {}):
            return False
        offset = graph.viewpoint_position[graph.index[viewpoint]] - np.array(
            centres[scan][object_id]
        )
        return bool(np.sqrt(np.square(offset).sum()) <= 3.0)

    return near


def _tell(line: str) -> None:
    """Print a line now: a run takes half a minute."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main() -> int:
    """Compare, and print what was compared."""
    global PATH_TYPE  # noqa: PLW0603
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("clone", type=Path)
    parser.add_argument("--protocol", required=True)
    parser.add_argument("--task", default="reverie", choices=FOLDERS)
    parser.add_argument("--split", default="val_unseen")
    parser.add_argument("--at", default="")
    parser.add_argument("--kind", default="")
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    PATH_TYPE = {"official-v1": "trusted_path", "official-player": "player_path"}.get(
        chosen.protocol, PATH_TYPE
    )
    clone = chosen.clone.resolve()
    sys.argv = sys.argv[:1]  # some modules read it when they are imported
    found = [
        (file, name)
        for file, name in evaluators(clone, chosen.task)
        if chosen.at in str(file) and chosen.kind in name
    ]
    if not found:
        _tell(f"no class with eval_metrics or _score_item for {chosen.task} in {clone}")
        return 2
    file, name = found[-1]
    if len(found) > 1:
        others = (f"{each.relative_to(clone)}:{kind}" for each, kind in found[:-1])
        _tell(f"boards: {', '.join(others)}")
    module = load(file, clone)
    kind = getattr(module, name)
    is_official = hasattr(kind, "_score_item")
    split = "val_unseen_house" if chosen.task == "soon" else chosen.split
    with TemporaryDirectory() as folder:
        long_hops = not is_official and reads_hops(kind)
        jumps = not find_task(chosen.task).protocol(chosen.protocol).rejects_jumps
        data = Data(chosen.task, split, chosen.seed, Path(folder), long_hops=long_hops, jumps=jumps)
        with redirect_stdout(StringIO()):
            theirs = list((with_scores if is_official else with_metrics)(module, kind, data))
    ours = evaluate(
        data.submission(), split=split, ground_truth=data.truth, protocol=chosen.protocol
    )
    row = {instr_id: number for number, instr_id in enumerate(ours.instr_ids)}
    ours_by = {name: key for key, names in NAMES.items() for name in names}
    worst, compared = 0.0, set[str]()
    for label, value, order in theirs:
        key = ours_by.get(label)
        if key is None or key not in ours:
            continue
        expected = ours[key] if order is None else ours.episodes[key][[row[each] for each in order]]
        difference = float(np.max(np.abs(np.asarray(value) - expected)))
        what = "mean" if order is None else f"{len(order)} episodes"
        _tell(f"  {label:26} {key:20} {what:>14}  differs by at most {difference:.3g}")
        worst = math.inf if math.isnan(difference) else max(worst, difference)
        compared.add(key)
    if not {"success", "spl", "path_length"} <= compared:
        _tell(f"compared only {', '.join(sorted(compared)) or 'nothing'}")
        return 2
    commit = subprocess.run(
        ["git", "-C", str(clone), "log", "-1", "--format=%h", "--abbrev=7"],
        capture_output=True,
        text=True,
        check=False,
    ).stdout.strip()
    verdict = "equal" if worst <= WITHIN else f"NOT EQUAL ({worst:.3g})"
    _tell(
        f"{clone.name} {commit or 'unknown commit'}, {file.relative_to(clone)} {name}: {verdict} "
        f"to {chosen.task} {chosen.protocol} in {len(row):,} episodes, {datetime.now(UTC).date()}"
    )
    return 0 if worst <= WITHIN else 1


if __name__ == "__main__":
    sys.exit(main())
