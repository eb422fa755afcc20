"""Run the result writers of public codebases on made-up agents, and read what they write.

``scripts/evidence writers CLONE...`` takes clones, in folders that are named like the repositories.
A codebase's own functions are taken from its source by name and executed. What they use beside
that, such as models, simulators and logs, is a stand-in that does nothing. Executed are

- what collects the results of an agent, merges those of two processes and writes the file;
- the statements with which a rollout begins its record of an episode, records each move and, at
  the stop, the answer; in the family of DUET with the shortest paths of its own map, and the way
  back to the best stop.
"""

import ast
import builtins
import contextlib
import copy
import json
import math
import os
import subprocess
import sys
import tempfile
import time
import typing
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType, SimpleNamespace
from typing import Any

import numpy as np

from reverie_eval.errors import SubmissionError
from reverie_eval.submissions import read_predictions
from reverie_eval.tasks import codebases, find_task


@dataclass(frozen=True)
class Agent:
    """What an agent did in an episode."""

    instr_id: str
    moves: Sequence[Sequence[str]]
    """The viewpoints of each decision, the start first."""
    object_id: str | None
    """The object that it predicts, as codebases have it in memory."""

    @property
    def viewpoints(self) -> list[str]:
        """All viewpoints in walking order."""
        return [viewpoint for move in self.moves for viewpoint in move]


AGENTS: Sequence[Agent] = (
    Agent("4_402_0", [["hall"], ["stairs"], ["attic"]], "402"),
    Agent("4_402_1", [["hall"], ["stairs"], ["attic"], ["stairs", "hall", "porch"], ["hall"]], "0"),
    Agent("4_402_2", [["hall"], ["stairs"], ["attic"], ["stairs", "hall"]], "17"),
    Agent("5_17_0", [["porch"]], None),
    Agent("5_17_1", [["porch"], ["hall"]], None),
)
"""One walks a viewpoint at a time, one goes on from far back, one goes back to stop, and two see no
object: they stop at once, or after a move."""
EDGES = (("porch", "hall"), ("hall", "stairs"), ("stairs", "attic"))
_PROCESSES = (slice(2), slice(2, None))
_MOST_LOOKS = 1_000
_DIRECTION = (0.25, 0.5)
"""Where agents see their object, in turns."""


def agents_of(task: str) -> Sequence[Agent]:
    """Return the agents with ids as our reader has them for a task.

    SOON's are only those that see an object: DUET's writer fails for others.
    """
    ids = {
        "r2r": ("4_0", "4_1", "4_2", "5_0", "5_1"),
        "ndh": ("41", "42", "43", "44", "45"),
        "soon": ("4#0", "4#1", "5#0"),
    }
    given = ids.get(task, [agent.instr_id for agent in AGENTS])
    return [replace(agent, instr_id=it) for agent, it in zip(AGENTS, given, strict=False)]


# Parts of a codebase.


class Nothing:
    """A stand-in for what a writer uses: whatever is asked of it, it is nothing, or 0, or two."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return Nothing()

    def __call__(self, *_: object, **__: object) -> Any:
        """Do nothing."""
        return Nothing()

    def __getitem__(self, _: object) -> Any:
        return Nothing()

    def __iter__(self) -> Iterator[Any]:
        return iter((Nothing(), Nothing()))  # an environment and its evaluator; a key and its value

    def __bool__(self) -> bool:
        return False

    def __int__(self) -> int:
        return 0

    def __float__(self) -> float:
        return 0.0

    def __round__(self, _: int = 0) -> float:
        return 0.0

    __enter__ = __exit__ = __call__


class Names(dict[str, Any]):
    """The names that a piece of source sees: given and built-in ones, and stand-ins."""

    def __missing__(self, name: str) -> Any:
        return getattr(builtins, name, Nothing())


class Scores(np.ndarray[Any, Any]):
    """Scores of a model, of which writers ask the largest and its index."""

    def max(self, *_: Any) -> Any:  # type: ignore[override]  # as torch has it
        """Return the largest value and its index."""
        return np.max(np.asarray(self)), int(np.argmax(np.asarray(self)))


class Options(SimpleNamespace):
    """The options of a command; all that are not given are off."""

    def __getattr__(self, _: str) -> Nothing:
        return Nothing()


def _import(name: str, *args: Any, **kwargs: Any) -> Any:
    try:
        return builtins.__import__(name, *args, **kwargs)
    except ImportError:
        return Nothing()


def _empty(value: object) -> None:
    if not isinstance(value, Nothing):
        raise TypeError(f"Object of type {type(value).__name__} is not JSON serializable")


def names_with(**names: Any) -> Names:
    """Return the names that many writers use, and these."""
    return Names(
        {
            "__builtins__": {**vars(builtins), "__import__": _import},
            "json": SimpleNamespace(**vars(json) | {"dump": partial(json.dump, default=_empty)}),
            "os": os,
            "copy": copy,
            "math": math,
            "np": np,
            "time": time,
            "defaultdict": defaultdict,
            "is_default_gpu": lambda _: True,
            "print": Nothing(),
            **names,
        }
    )


def parse(file: Path) -> ast.Module:
    """Parse a source file, also one that mixes tabs and spaces."""
    return ast.parse(file.read_text(encoding="utf-8", errors="replace").expandtabs(8))


def functions(trees: Iterable[ast.AST], name: str) -> list[ast.FunctionDef]:
    """Return the functions and methods with a name, in the order of the files."""
    nodes = (node for tree in trees for node in ast.walk(tree))
    return [node for node in nodes if isinstance(node, ast.FunctionDef) and node.name == name]


def execute(nodes: Sequence[ast.stmt], names: Names) -> Names:
    """Execute statements and return the names."""
    for node in nodes:
        if isinstance(node, ast.FunctionDef):
            node.decorator_list = []
    module = ast.fix_missing_locations(ast.Module([*nodes], []))
    exec(compile(module, "<clone>", "exec"), names)  # what this module is for
    return names


def function_of(parameters: str, statement: ast.stmt, names: Names) -> Callable[..., Any]:
    """Return a function of one statement."""
    (made,) = ast.parse(f"def made({parameters}): pass").body
    assert isinstance(made, ast.FunctionDef)
    made.body = [statement]
    made_function: Callable[..., Any] = execute([made], names)["made"]
    return made_function


# What a rollout returns, recorded by the codebase's own statements.


class House(Nothing):
    """A simulator in which an agent walks along its viewpoints."""

    def __init__(self, viewpoints: Sequence[str]) -> None:
        """Begin at the first of the viewpoints."""
        self.rest = list(viewpoints)
        self.looks = 0

    def makeAction(self, *_: object) -> None:  # noqa: N802  # the simulator's name
        """Go to the next viewpoint: turns are never needed."""
        del self.rest[0]

    def getState(self) -> Any:  # noqa: N802
        """Return where the agent is, and that the next viewpoint is straight ahead."""
        self.looks += 1
        if self.looks > _MOST_LOOKS:
            raise RuntimeError(
                "the codebase waits for a simulator that does what this one does not"
            )
        near = [SimpleNamespace(viewpointId=viewpoint) for viewpoint in self.rest[:2]]
        state = State(location=near[0], navigableLocations=near, viewIndex=12)
        state.heading, state.elevation = 0.5, 0.0
        return state


class State(SimpleNamespace):
    """The state of a simulator, which later versions have in a list."""

    def __getitem__(self, _: int) -> "State":
        return self


def observation(agent: Agent, viewpoint: str, following: str = "") -> Names:
    """Return what an agent sees at a viewpoint."""
    ahead = {"viewpointId": following, "pointId": 12, "idx": 1}
    objects = [] if agent.object_id is None else [agent.object_id]
    return Names(
        instr_id=agent.instr_id,
        viewpoint=viewpoint,
        scan="house",
        viewIndex=12,
        heading=0.5,
        elevation=0.0,
        candidate=[ahead],
        candidate_obj=([], [], objects),
    )


def begun(agent: Agent, rollout: ast.FunctionDef) -> list[dict[str, Any]]:
    """Let a rollout begin its record of an episode."""
    beginning = [
        node
        for node in ast.walk(rollout)
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "traj"
    ]
    obs = [observation(agent, agent.viewpoints[0])]
    traj: list[dict[str, Any]] = execute(beginning[:1], names_with(obs=obs, perm_obs=obs))["traj"]
    return traj


def walked(agent: Agent, clone: Path, moves: str, answers: str, name: str) -> dict[str, Any]:
    """Let a codebase before DUET record each move in the simulator, and the answer at the stop."""
    rollout = functions([parse(clone / answers)], name)[-1]
    traj = begun(agent, rollout)
    move = functions([parse(clone / moves)], "make_equiv_action")[-1]
    make_move = execute([move], names_with())["make_equiv_action"]
    house = House(agent.viewpoints)
    env = SimpleNamespace(env=SimpleNamespace(sims=[house]))
    for here, following in pairwise(agent.viewpoints):
        obs = [observation(agent, here, following)]
        given = {"self": Options(env=env), "a_t": [0], "traj": traj, "max_hist_len": 0}
        given |= {"obs": obs, "perm_obs": obs}
        make_move(**{each.arg: given[each.arg] for each in move.args.args if each.arg in given})
    stops = [
        statement
        for node in ast.walk(rollout)
        if isinstance(node, ast.For) and "cpu_a_t" in ast.unparse(node.iter)
        for statement in node.body
        if "predObjId" in ast.unparse(statement)
    ]
    obs = [observation(agent, agent.viewpoints[-1])]
    count = agent.object_id is not None
    names = names_with(
        t=0,
        i=0,
        next_id=5,
        ob_img_max_len=5,
        max_hist_len=0,
        traj=traj,
        ended=[False],
        just_ended=[False],
        obj_lens=[count],
        obj_leng=[count + 1],
        **dict.fromkeys(("obs", "perm_obs"), obs),
        **dict.fromkeys(
            ("obj_logits", "logit_REF"), np.array([[0.9] * count + [0.1]]).view(Scores)
        ),
        self=SimpleNamespace(feedback="argmax", episode_len=1, args=Options(max_action_len=1)),
        args=Options(submit=True),
    )
    execute(stops, names)
    return traj[0]


def moved(agent: Agent, clone: Path, moves: str, answers: str, maps: str) -> dict[str, Any]:
    """Let a codebase of DUET's family record moves, go back to the best stop, and answer."""
    names = names_with()
    kinds = ("FloydGraph", "GraphMap")
    classes = [node for node in parse(clone / maps).body if isinstance(node, ast.ClassDef)]
    execute([node for node in classes if node.name in kinds], names)
    execute(functions([parse(clone / moves)], "make_equiv_action")[-1:], names)
    rollout = functions([parse(clone / answers)], "rollout")[-1]
    given = "self, obs, gmaps, ended, just_ended, traj, batch_size"
    end = function_of(given, _loop_that_stops(rollout), names)
    gmap = names["GraphMap"](agent.viewpoints[0])
    graph = next(graph for key, graph in vars(gmap).items() if key in ("graph", "nav_graph"))
    for a, b in EDGES:
        graph.add_edge(a, b, 1)
    for viewpoint in agent.viewpoints:
        graph.update(viewpoint)
    objects = [] if agent.object_id is None else [agent.object_id]
    stop = agent.viewpoints[-1]
    gmap.node_stop_scores = {
        viewpoint: {
            "stop": float(viewpoint == stop),
            "og": agent.object_id if viewpoint == stop else "99",
            "og_direction": _DIRECTION if objects else None,
            "og_details": {"objids": objects, "logits": np.array([0.5] * len(objects))},
        }
        for viewpoint in agent.viewpoints
    }
    views: Mapping[str, object] = defaultdict(lambda: defaultdict(int))
    self = Options(args=Options(detailed_output=True), scanvp_cands=views)
    traj = begun(agent, rollout)
    here = agent.viewpoints[0]
    goes_back = len(agent.moves[-1]) > 1
    for move in agent.moves[1 : -1 if goes_back else None]:
        names["make_equiv_action"](self, move[-1:], [gmap], [observation(agent, here)], traj)
        here = move[-1]
    end(self, [observation(agent, here)], [gmap], [False], [True], traj, 1)
    return traj[0]


def _loop_that_stops(rollout: ast.FunctionDef) -> ast.stmt:
    loops = [ast.unparse(node) for node in ast.walk(rollout) if isinstance(node, ast.For)]
    writing = [loop for loop in loops if "stop_node" in loop and "['path']" in loop]
    return ast.parse(min(writing, key=len)).body[0]


# Writers.


def poses_of(agent: Agent) -> list[tuple[str, float, float]]:
    """Return an agent's poses."""
    return [(viewpoint, 0.5, 0.0) for viewpoint in agent.viewpoints]


def recorded(agent: Agent) -> dict[str, Any]:
    """Return what an agent keeps of an episode, where a codebase's own recording is not run."""
    poses = poses_of(agent)
    return {"instr_id": agent.instr_id, "path": poses, "trajectory": poses}


class Writer(typing.Protocol):
    """Runs what a codebase writes its results with."""

    @property
    def task(self) -> str:
        """The task that the results are of."""

    def run(self, clone: Path, folder: Path) -> None:
        """Write the files into a folder."""


@dataclass(frozen=True)
class Valid:
    """An agent runs, processes are merged, and the file is written, all in one function."""

    main: str
    """The file with the function."""
    agents: Sequence[str]
    """The files with ``test`` and ``get_results`` of its agents."""
    rollout: str
    """The file with the function that records episodes."""
    moves: str = ""
    """The file with ``make_equiv_action``, if it is another one."""
    maps: str = ""
    """The file with the maps of DUET's family."""
    records: str = "rollout"
    """The name of the function that records episodes."""
    function: str = "valid"
    options: Mapping[str, object] = field(default_factory=dict)
    task: str = "reverie"

    def run(self, clone: Path, folder: Path) -> None:
        """Write the file into a folder."""
        options = Options(
            **{
                **dict.fromkeys(("pred_dir", "log_dir", "ckpt_dir", "output_dir"), str(folder)),
                "submit": True,
                "detailed_output": False,
                "fusion": "dynamic",
                "load": "",
                "resume_file": None,
                **self.options,
            }
        )
        function = functions([parse(clone / self.main)], self.function)[-1]
        agents = [
            replace(agent, instr_id=agent.instr_id.replace("#", "-0_"))
            for agent in agents_of(self.task)
        ]
        results = [self._result(agent, clone) for agent in agents]
        trees = [parse(clone / file) for file in self.agents]
        methods = [functions(trees, name)[0] for name in ("test", "get_results")]
        is_merging = "all_gather" in ast.unparse(function)
        parts = [results[part] for part in _PROCESSES] if is_merging else [results]
        first, *others = (_Runner(part, methods, options) for part in parts)
        for other in others:
            other.test()
        names = names_with(
            args=options,
            log_dir=str(folder),
            all_gather=lambda results: [
                results,
                *(other.get_results(**first.asked) for other in others),
            ],
            **{
                node.id: lambda *_, **__: first
                for node in ast.walk(function)
                if isinstance(node, ast.Name) and node.id.lower().endswith("agent")
            },
        )
        merge = functions(map(parse, clone.rglob("distributed.py")), "merge_dist_results")
        execute([*merge, function], names)
        given = {"args": options, "val_envs": {"val_unseen": Nothing()}}
        names[self.function](*(given.get(each.arg, Nothing()) for each in function.args.args))

    def _result(self, agent: Agent, clone: Path) -> dict[str, Any]:
        if self.maps:
            return moved(agent, clone, self.moves or self.rollout, self.rollout, self.maps)
        return walked(agent, clone, self.moves or self.rollout, self.rollout, self.records)


class _Runner(Nothing):
    """An agent whose rollouts have these results, with methods of a codebase."""

    def __init__(
        self, results: Sequence[object], methods: Sequence[ast.FunctionDef], args: object
    ) -> None:
        names = execute(methods, names_with())
        self.results: dict[str, Any] = {}
        self.args = args
        # A run ends when an episode comes again, or in one codebase with None.
        ends = [None] if "traj is None" in ast.unparse(methods[0]) else results
        rollouts = iter([results, ends])
        self.rollout = self.rollout_test = lambda **_: next(rollouts)
        self.test = partial(names["test"], self)
        self._get_results = names["get_results"]
        self.asked: Mapping[str, Any] = {}

    def get_results(self, **options: Any) -> Any:
        """Return the results, and keep how they were asked for."""
        self.asked = options
        return self._get_results(self, **options)


@dataclass(frozen=True)
class Saved:
    """NaviLLM and what is built on it: a dataset saves what ``get_results`` returns."""

    agent: str
    dataset: str
    options: Mapping[str, object] = field(default_factory=dict)
    task: str = "reverie"

    def run(self, clone: Path, folder: Path) -> None:
        """Write the file into a folder."""
        names = names_with()
        execute(functions([parse(clone / self.agent)], "get_results"), names)
        execute(functions([parse(clone / self.dataset)], "save_json"), names)
        prefix = {"reverie": "reverie_", "r2r": "r2r_", "ndh": "cvdn_0_", "soon": "soon_0_"}
        parts = []
        for part in _PROCESSES:
            results = {
                prefix[self.task] + agent.instr_id.replace("#", "-0_"): {
                    "path": agent.moves,
                    **self._answer(agent),
                }
                for agent in agents_of(self.task)[part]
            }
            parts += names["get_results"](results)
        name = {"reverie": "REVERIE", "r2r": "R2R", "ndh": "CVDN", "soon": "SOON"}[self.task]
        names["save_json"](Nothing(), parts, str(folder / f"{name}_val_unseen.json"))

    def _answer(self, agent: Agent) -> Mapping[str, object]:
        if self.task not in ("reverie", "soon"):
            return {}
        direction = _DIRECTION if self.task == "soon" else None
        return {"pred_objid": agent.object_id, "pred_obj_direction": direction}


class _Python2Dict(dict[Any, Any]):
    iteritems = dict.items


@dataclass(frozen=True)
class Written:
    """An agent writes its results with a method of its own."""

    agent: str
    method: str = "write_results"
    keeps_records: bool = False
    """Whether it keeps more of an episode than its trajectory."""
    task: str = "r2r"

    def run(self, clone: Path, folder: Path) -> None:
        """Write the file into a folder."""
        agents = [recorded(agent) for agent in agents_of(self.task)]
        results = {
            (int(each["instr_id"]) if self.task == "ndh" else each["instr_id"]): (
                each if self.keeps_records else each["path"]
            )
            for each in agents
        }
        self_ = Options(results=_Python2Dict(results), results_path=str(folder / "results.json"))
        method = functions([parse(clone / self.agent)], self.method)[0]
        execute([method], names_with())[self.method](self_)


@dataclass(frozen=True)
class Grounded:
    """The dataset's baseline adds objects to a file of a navigator."""

    script: str
    task: str = "reverie"

    def run(self, clone: Path, folder: Path) -> None:
        """Write the file into a folder."""
        given = [
            {"instr_id": agent.instr_id, "trajectory": poses_of(agent)}
            for agent in agents_of(self.task)
        ]
        answers = [agent.object_id for agent in agents_of(self.task)]
        prefix = "NP_cg_pm_sample_imagenet_mean_pooled_1heads_"
        (folder / f"{prefix}val_unseen").with_suffix(".json").write_text(json.dumps(given))
        tree = parse(clone / self.script)
        loop = next(
            node
            for node in ast.walk(tree)
            if isinstance(node, ast.For) and "_submission.json" in ast.unparse(node)
        )
        waiting = iter(answers)

        def grounding(*_: object, **__: object) -> Mapping[str, object] | None:
            answer = next(waiting)
            return None if answer is None else {"scores": [0.9], "objIds": [answer]}

        names = names_with(
            splits=["val_unseen"],
            resBaseDir=f"{folder}/",
            max_length=40,
            idToScan=lambda _: defaultdict(lambda: ("house", ["go"] * 3)),
            sentToToken=lambda *_: [],
            pointer=SimpleNamespace(groundingForView=grounding),
        )
        execute([loop], names)
        (folder / f"{prefix}val_unseen.json").unlink()


@dataclass(frozen=True)
class Gathered:
    """ORIST: the records of all processes are written once each, in the middle of a function."""

    script: str
    task: str = "reverie"

    def run(self, clone: Path, folder: Path) -> None:
        """Write the file into a folder."""
        blocks = [
            node
            for node in ast.walk(parse(clone / self.script))
            if isinstance(node, ast.If) and "_submit.json" in ast.unparse(node)
        ]
        block = min(blocks, key=lambda node: len(ast.unparse(node)))
        results = [recorded(agent) for agent in agents_of(self.task)]
        args = Options(local_rank=0, resume=str(folder / "last"))
        names = names_with(args=args, result=[*results, results[0]], env_name="val_unseen")
        execute([block], names)


def duet(source: str, main: str = "reverie/main_nav_obj.py", **changes: Any) -> Valid:
    """Return the writer of a codebase that is built on DUET's."""
    agent, base = f"{source}/reverie/agent_obj.py", f"{source}/reverie/agent_base.py"
    maps = f"{source}/models/graph_utils.py"
    return replace(Valid(f"{source}/{main}", [base], agent, maps=maps), **changes)


def navigator(source: str, main: str, folder: str, **changes: Any) -> Valid:
    """Return the writer of a codebase that is built on DUET's and predicts no objects."""
    agent, base = f"{source}/{folder}/agent.py", f"{source}/{folder}/agent_base.py"
    maps = f"{source}/models/graph_utils.py"
    return replace(Valid(f"{source}/{main}", [base], agent, maps=maps), **changes)


def before_training(writer: Valid) -> Valid:
    """Return the writer of the evaluation before training, ``--eval_first``."""
    options = {"eval_first": True, "iters": 0, "log_every": 1}
    return replace(writer, function="train", options=options)


def hamt(source: str) -> Valid:
    """Return the writer of a codebase that is built on HAMT's."""
    agent = f"{source}/reverie/agent.py"
    main, moves = f"{source}/reverie/main_navref.py", f"{source}/r2r/agent_cmt.py"
    return Valid(main, [agent], agent, moves)


_DETAILED = {"detailed_output": True}
_HAMT_BASE, _HAMT_AGENT = ["finetune_src/r2r/agent_base.py"], "finetune_src/r2r/agent_cmt.py"
_NAVILLM = "tasks/agents/mp3d_agent.py"

WRITERS: Mapping[str, Sequence[Writer]] = MappingProxyType(
    {
        "REVERIE": [
            Grounded("tasks/REVERIE/groundingAfterNav.py"),
            *(
                Written("tasks/REVERIE/follower.py", name, keeps_records=True, task="reverie")
                for name in ("write_results", "write_test_results")
            ),
        ],
        "HOP-REVERIE-Challenge": [
            Valid(
                "r2r_src/train.py", ["r2r_src/agent.py"], "r2r_src/agent.py", records="rollout_test"
            )
        ],
        "airbert-recurrentvln": [
            Valid("reverie_src/train.py", ["reverie_src/agent.py"], "reverie_src/agent.py")
        ],
        "ORIST": [Gathered("train_reverie_multiloss.py")],
        "CKR": [
            Written("follower.py", name, keeps_records=True, task="reverie")
            for name in ("write_results", "write_test_results")
        ],
        **{name: [hamt("finetune_src")] for name in ("TD-STP", "FDA")},
        "VLN-HAMT": [
            hamt("finetune_src"),
            Valid("finetune_src/r2r/main.py", _HAMT_BASE, _HAMT_AGENT, task="r2r"),
            Valid(
                *("finetune_src/cvdn/main.py", _HAMT_BASE, "finetune_src/cvdn/agent.py"),
                *(_HAMT_AGENT,),
                task="ndh",
            ),
        ],
        **{
            name: [duet("map_nav_src")]
            for name in (
                *("AZHP", "HM3DAutoVLN", "LGK", "KESU", "DOPE", "VLN-SUSA", "HGPG", "StratXplore"),
                *("VLN-MBA-VisualPerturbations", "IPM_BTK"),
            )
        },
        "VLN-BEVBert": [
            duet("map_nav_src"),
            navigator("map_nav_src", "r2r/main_nav.py", "r2r", task="r2r"),
        ],
        "VLN-DUET": [
            duet("map_nav_src"),
            duet("map_nav_src", options=_DETAILED),
            navigator("map_nav_src", "r2r/main_nav.py", "r2r", task="r2r"),
            Valid(
                "map_nav_src/soon/main.py",
                ["map_nav_src/soon/agent_obj.py", "map_nav_src/reverie/agent_base.py"],
                "map_nav_src/soon/agent_obj.py",
                "map_nav_src/reverie/agent_obj.py",
                "map_nav_src/models/graph_utils.py",
                task="soon",
            ),
        ],
        **{
            name: [duet("map_nav_src", "main_nav_obj.py")]
            for name in ("DART-VLN", "ODENvln", "ICML2024-FSTTA")
        },
        "GridMM": [
            duet("map_nav_src", "main_nav_obj.py"),
            navigator("map_nav_src", "main_nav.py", "r2r", task="r2r"),
        ],
        "DSRG": [duet("finetune_src"), before_training(duet("finetune_src"))],
        "VLN-GOAT": [
            duet("map_nav_src", rollout="map_nav_src/reverie/agent_obj_goat.py"),
            before_training(duet("map_nav_src", rollout="map_nav_src/reverie/agent_obj_goat.py")),
        ],
        "REVERIE-Challenge22": [duet("VLN-DUET/map_nav_src")],
        "KERM": [duet("knowledge_nav_src")],
        "ScaleVLN": [
            duet("VLN-DUET-RVR/map_nav_src"),
            navigator("VLN-DUET/map_nav_src", "r2r/main_nav.py", "r2r", task="r2r"),
        ],
        "LAD": [
            Valid(
                "training_src/nav_obj.py",
                ["training_src/rever_agent.py", "training_src/env_bases/reverie/agent_base.py"],
                "training_src/rever_agent.py",
                maps="training_src/models/graph_utils.py",
                options=options,
            )
            for options in ({}, {"record_rt": True})
        ],
        "NaviLLM": [
            Saved(_NAVILLM, "tasks/datasets/reverie.py"),
            Saved(_NAVILLM, "tasks/datasets/r2r.py", task="r2r"),
            Saved(_NAVILLM, "tasks/datasets/cvdn.py", task="ndh"),
            Saved(_NAVILLM, "tasks/datasets/soon.py", task="soon"),
        ],
        "roomtour3d-NaviLLM": [Saved(_NAVILLM, "tasks/datasets/reverie.py")],
        "EvolveNav": [Saved(_NAVILLM, "tasks/datasets/r2r.py", task="r2r")],
        "NavGPT-2": [
            navigator("map_nav_src", "r2r/main_nav.py", "r2r"),
            navigator("map_nav_src", "r2r/main_nav.py", "r2r", options=_DETAILED),
        ],
        "NavRAG": [navigator("VLN-DUET-RVR/map_nav_src", "reverie/main_nav.py", "reverie")],
        "MapGPT": [
            Valid(
                "vln/main_gpt.py",
                ["vln/agent_base.py"],
                "vln/gpt_agent.py",
                options={"save_pred": True},
            )
        ],
        "Matterport3DSimulator": [Written("tasks/R2R/agent.py")],
        "Recurrent-VLN-BERT": [
            Valid("r2r_src/train.py", ["r2r_src/agent.py"], "r2r_src/agent.py", task="r2r")
        ],
        "cvdn": [Written("tasks/NDH/agent.py", task="ndh")],
    }
)
"""The writers of each codebase, by the name of its repository."""


# What the files hold.


def run_writer(writer: Writer, clone: Path) -> Mapping[str, bytes]:
    """Run a writer and return the first file of each name, with ``{split}`` and the like in it."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        writer.run(clone, Path(folder))
        files = sorted(file for file in Path().rglob("*.json") if not file.stem.endswith("_args"))
        ids = {agent.instr_id: "{instr_id}" for agent in agents_of(writer.task)}
        parts = {"val_unseen": "{split}", "dynamic": "{fusion}"} | ids
        found: dict[str, bytes] = {}
        for file in files:
            name = file.name
            for part, stands_for in parts.items():
                name = name.replace(part, stands_for)
            found.setdefault(name, file.read_bytes())
        return found


_ANSWERS = ("predObjId", "pred_objid", "pred_obj_id")
_IDS = ("instr_id", "inst_idx")


def describe(document: Any, without: Collection[str]) -> str:
    """Say in a line what form a result has, some of whose agents predict no object."""
    records = [document] if "trajectory" in document else document
    records = list(records.values()) if isinstance(records, dict) else records
    shape = "list" if isinstance(document, list) else "records by episode"
    if not all(isinstance(step, list) for step in records[0]["trajectory"]):
        return f"{shape}; {_walks(records)}"
    known = {*_IDS, "trajectory", *_ANSWERS}
    others = sorted({key for record in records for key in record} - known)
    answers = [key for key in _ANSWERS if key in records[0]]
    return "; ".join(
        [
            "one record in each file" if "trajectory" in document else shape,
            *(["inst_idx"] if "inst_idx" in records[0] else []),
            _steps([step for record in records for step in record["trajectory"]]),
            *(_answer(key, records, without) for key in answers),
            *([] if answers else ["no answer"]),
            *([f"also {', '.join(others)}"] if others else []),
        ]
    )


def _walks(records: Sequence[Mapping[str, Any]]) -> str:
    """Describe trajectories that are objects, or lists of objects."""
    given = [record["trajectory"] for record in records]
    is_listed = isinstance(given[0], list)
    walks = [walk for each in given for walk in (each if is_listed else [each])]
    others = ", ".join(
        f"{key} {'in a list of one' if isinstance(value, list) else 'a number'}"
        for key, value in walks[0].items()
        if key != "path"
    )
    objects = "a list of one object" if is_listed else "an object"
    steps = _steps([step for walk in walks for step in walk["path"]])
    return f"trajectory {objects} with path, {steps}, and {others}"


def _steps(steps: Sequence[Sequence[object]]) -> str:
    if all(isinstance(each, str) for step in steps for each in step):
        return "hops [viewpoint, ...]" if any(len(step) != 1 for step in steps) else "[viewpoint]"
    has_angles = any(step[1:] != [0, 0] for step in steps)
    return f"poses [viewpoint, {'heading, elevation' if has_angles else '0, 0'}]"


def _answer(key: str, records: Sequence[Mapping[str, Any]], without: Collection[str]) -> str:
    of_object = next(record[key] for record in records if record["instr_id"] not in without)
    of_none = next(record[key] for record in records if record["instr_id"] in without)
    kind = "text" if isinstance(of_object, str) else "a number"
    return f"{key} {kind}, {json.dumps(of_none)} without an object"


def what_is_read(content: bytes, task: str) -> str:
    """Say whether the reader finds what the agents did, or where it differs."""
    try:
        predictions = read_predictions(content, find_task(task))
    except SubmissionError as error:
        return f"rejected: {error.problems[0]}"
    if predictions.problems:
        return f"rejected: {predictions.problems[0]}"
    rows = {instr_id: row for row, instr_id in enumerate(predictions.instr_ids)}
    differences = []
    for agent in agents_of(task):
        row = rows[agent.instr_id]
        walk = predictions.viewpoint_ids[slice(*predictions.offsets[row : row + 2])]
        if walk != agent.viewpoints:
            differences.append(f"{agent.instr_id} walks {walk} instead of {agent.viewpoints}")
        predicted, meant = int(predictions.predicted_object[row]), int(agent.object_id or -1)
        if predicted != meant and not predictions.is_navigation_only and task == "reverie":
            differences.append(f"{agent.instr_id} predicts {predicted} instead of {meant}")
    return "; ".join(differences) or "as meant"


def lines_about(clone: Path) -> Iterator[str]:
    """Run the writers of a clone, and yield what they write and how it is read."""
    revision = ["git", "-C", str(clone), "log", "-1", "--format=%h", "--abbrev=7"]
    commit = subprocess.run(revision, capture_output=True, text=True, check=True).stdout.strip()
    listed = {
        (file.name or "results.json", file.form)
        for codebase in codebases()
        if codebase.repository.endswith(f"/{clone.name}") and codebase.commit == commit
        for file in codebase.file
    }
    for writer in WRITERS[clone.name]:
        without = {agent.instr_id for agent in agents_of(writer.task) if not agent.object_id}
        for name, content in run_writer(writer, clone).items():
            document = json.loads(content)
            form = describe(document, without)
            yield f"{clone.name} {commit}, {writer.task}: {name}"
            yield f"    {form}"
            yield f"    read {what_is_read(content, writer.task)}"
            if (name, form) not in listed:
                yield "    not so in codebases.toml"
                yield f"    {json.dumps(_one_of(document))}"


def _one_of(document: Any) -> Any:
    """Return the record of the agent that walks back, or the only one."""
    if "trajectory" in document:
        return document
    return document[2] if isinstance(document, list) else dict([list(document.items())[2]])


if __name__ == "__main__":
    for folder in map(Path, sys.argv[1:]):
        sys.stdout.writelines(f"{line}\n" for line in lines_about(folder.resolve()))
