"""Forms in which published codebases write the same results, each made from the official one.

The letters are those of the survey of evaluators that the forms were collected in; the names are
the codebases that write them. Every form with a letter is one that ``scripts/evidence writers`` has
seen their own code write, keys, types and all, and that ``codebases.toml`` lists (a test holds them
to it). The others are variations.
"""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, TypeAlias

from tests.conftest import SAMPLES

Record: TypeAlias = dict[str, Any]
Viewpoints: TypeAlias = Sequence[str]

OFFICIAL: Sequence[Record] = json.loads((SAMPLES / "good.json").read_bytes())


@dataclass(frozen=True)
class Form:
    """How a codebase writes its results, and what reading says of it."""

    trajectory: Callable[[Record], Any]
    answer: Callable[[int], Mapping[str, Any]]
    extra: Callable[[Record], Mapping[str, Any]] = lambda _: {}
    prefix: str = ""
    document: Callable[[list[Record]], Any] = list
    read_as: tuple[str, ...] = ()
    dropped: tuple[str, ...] = ()
    none: int = -1
    """What the file predicts where the agent predicts no object."""

    def meaning(self) -> list[Record]:
        """Return the official results that a file in this form states."""
        stated = {-1: self.none}
        return [
            {**record, "predObjId": stated.get(record["predObjId"], record["predObjId"])}
            for record in OFFICIAL
        ]

    def write(self, records: Iterable[Record] = OFFICIAL) -> Any:
        """Return what the file holds that the codebase would write for these results."""
        return json.loads(self.bytes(records))

    def bytes(self, records: Iterable[Record] = OFFICIAL) -> bytes:
        """Return the content of that file."""
        written = [
            {
                "instr_id": self.prefix + record["instr_id"],
                **self.answer(record["predObjId"]),
                "trajectory": self.trajectory(record),
                **self.extra(record),
            }
            for record in records
        ]
        return json.dumps(self.document(written)).encode()


def viewpoints(record: Record) -> list[str]:
    """Return the viewpoints of an official record."""
    return [viewpoint_id for viewpoint_id, *_ in record["trajectory"]]


# Trajectories.


def poses(record: Record) -> Any:
    """Return the trajectory as published."""
    return record["trajectory"]


def single(record: Record) -> Any:
    """Return a list of viewpoints in lists of their own, as LAD writes."""
    return [[viewpoint_id] for viewpoint_id in viewpoints(record)]


def bare(record: Record) -> Any:
    """Return a list of viewpoints, as people write who make the file themselves."""
    return viewpoints(record)


def with_zeros(record: Record) -> Any:
    """Return poses whose angles are whole zeros, as NaviLLM writes."""
    return [[viewpoint_id, 0, 0] for viewpoint_id in viewpoints(record)]


def hops(record: Record) -> Any:
    """Return DUET's hops: the start alone, then one and two viewpoints in turns."""
    start, *rest = viewpoints(record)
    nested = [[start]]
    while rest:
        length = 2 - len(nested) % 2
        nested.append(rest[:length])
        rest = rest[length:]
    return nested


def hops_with_empty_ones(record: Record) -> Any:
    """Return hops of which the last leads nowhere."""
    return [*hops(record), []]


# Answers; -1 where the agent predicts none.


def written(key: str, write: Callable[[int], Any], none: Any) -> Callable[[int], Mapping[str, Any]]:
    """Return what writes an answer under a key, and no answer as this."""
    return lambda answer: {key: none if answer == -1 else write(answer)}


def navillm_answer(answer: int) -> Mapping[str, Any]:
    """Return the agent's answer and a number, as NaviLLM does: null and 0 for no object."""
    text = None if answer == -1 else str(answer)
    return {"pred_objid": text, "pred_obj_direction": None, "predObjId": int(text or 0)}


def no_answer(answer: int) -> Mapping[str, Any]:
    """Return no answer, as codebases without grounding do."""
    return {}


def details(record: Record) -> Mapping[str, Any]:
    """Return what DUET adds with --detailed_output."""
    stop = viewpoints(record)[-1]
    ids = [str(record["predObjId"]), "17"]
    return {"details": {stop: {"stop_prob": 0.71, "obj_ids": ids, "obj_logits": [3.1, 0.2]}}}


def keyed(records: list[Record]) -> Any:
    """Return an object of records by their ids, as the dataset's write_results does."""
    return {record["instr_id"]: record for record in records}


# How often what occurs in the official results.

_RECORDS = len(OFFICIAL)
_POSES = sum(len(record["trajectory"]) for record in OFFICIAL)
_NESTED = [hops(record) for record in OFFICIAL]
_LONG = sum(len(hop) > 1 for nested in _NESTED for hop in nested)
_WALKING = sum(any(len(hop) > 1 for hop in nested) for nested in _NESTED)
_NONE = sum(record["predObjId"] == -1 for record in OFFICIAL)

_OTHER_KEY = f"{_RECORDS} answers under a key other than predObjId"
_TEXT = f"{_RECORDS - _NONE} object ids written as text"
_ABSTAIN = f"{_NONE} answers that predict no object, not written as -1"
_SINGLE = f"{_POSES} poses without heading and elevation"
_HOPS = (
    f"{_WALKING} trajectories of nested hops",
    f"{_LONG} hops with more than one viewpoint, every viewpoint counted",
    f"{_POSES} poses without heading and elevation",
)
_EMPTY_HOPS = (f"{_RECORDS} trajectories of nested hops", *_HOPS[1:])

FORMS: Mapping[str, Form] = MappingProxyType(
    {
        "A official": Form(poses, written("predObjId", int, -1)),
        "NaviLLM's ids in memory": Form(
            poses,
            written("predObjId", int, -1),
            prefix="reverie_",
            read_as=(f'{_RECORDS} instr_ids with the prefix "reverie_"',),
        ),
        "B HOP": Form(poses, written("predObjId", int, None), read_as=(_ABSTAIN,)),
        "C HAMT": Form(poses, written("predObjId", str, "None"), read_as=(_TEXT, _ABSTAIN)),
        "D Airbert": Form(poses, written("predObjId", int, 0), none=0),
        "E DUET": Form(
            hops,
            written("pred_objid", str, None),
            read_as=(*_HOPS, _OTHER_KEY, _TEXT, _ABSTAIN),
        ),
        "E DUET with details": Form(
            hops,
            written("pred_objid", str, None),
            details,
            read_as=(*_HOPS, _OTHER_KEY, _TEXT, _ABSTAIN),
            dropped=("details",),
        ),
        "F KERM, G DSRG": Form(
            hops, written("predObjId", str, None), read_as=(*_HOPS, _TEXT, _ABSTAIN)
        ),
        "H DSRG, GOAT": Form(hops, written("predObjId", int, None), read_as=(*_HOPS, _ABSTAIN)),
        "J LAD": Form(
            single,
            written("predObjId", int, None),
            lambda _: {"record_rt": [0.5, 0.25]},
            read_as=(_SINGLE, _ABSTAIN),
            dropped=("record_rt",),
        ),
        "K NaviLLM": Form(
            with_zeros,
            navillm_answer,
            lambda _: {"success": 1, "spl": 0.5},
            read_as=(f"{_NONE} records with null under pred_objid, beside an answer",),
            dropped=("pred_obj_direction", "success", "spl"),
            none=0,
        ),
        "L NavGPT-2": Form(
            hops,
            no_answer,
            lambda record: {**details(record), "thoughts": ["hm"]},
            read_as=(*_HOPS, f"{_RECORDS} records, none with an answer: navigation only"),
            dropped=("details", "thoughts"),
        ),
        "M write_results": Form(
            poses,
            no_answer,
            document=keyed,
            read_as=(
                f"{_RECORDS} records keyed by their id",
                f"{_RECORDS} records, none with an answer: navigation only",
            ),
        ),
        "keyed, with answers": Form(
            poses,
            written("predObjId", int, -1),
            document=keyed,
            read_as=(f"{_RECORDS} records keyed by their id",),
        ),
        "keyed, ids nowhere else": Form(
            poses,
            written("pred_obj_id", str, ""),
            document=lambda records: {
                record["instr_id"]: {
                    name: value for name, value in record.items() if name != "instr_id"
                }
                for record in records
            },
            read_as=(
                f"{_RECORDS} records keyed by their id",
                _OTHER_KEY,
                _TEXT,
                _ABSTAIN,
            ),
        ),
        "bare viewpoints": Form(
            bare,
            no_answer,
            lambda _: {"thoughts": "hm", "a_t": [1]},
            read_as=(
                f"{_POSES} poses that are bare viewpoint ids",
                f"{_RECORDS} records, none with an answer: navigation only",
            ),
            dropped=("thoughts", "a_t"),
        ),
        "empty hops": Form(
            hops_with_empty_ones,
            written("predObjId", int, -1),
            details,
            read_as=_EMPTY_HOPS,
            dropped=("details",),
        ),
        "-1 as text": Form(poses, written("predObjId", str, "-1"), read_as=(_TEXT, _ABSTAIN)),
    }
)
"""Every form by its writers."""

NAVIGATION_ONLY = frozenset(name for name, form in FORMS.items() if form.answer is no_answer)
