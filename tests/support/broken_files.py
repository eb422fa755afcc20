"""Mistakes that people make in their files, each made in a good file.

``python -m tests.support.broken_files`` prints the table of ``docs/reference/broken-files.md``.
"""

import bz2
import gzip
import io
import json
import lzma
import pickle
import re
import sys
import tarfile
import zipfile
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from reverie_eval import GroundTruth, SubmissionError, validate
from reverie_eval.ground_truth import find_ground_truth
from tests.conftest import SAMPLES
from tests.support.forms import OFFICIAL, Record
from tests.support.worlds import SPLIT

Records = list[Record]
Mistake = Callable[[Records], object]
"""Takes the records of a good file, and returns the records or the bytes of a broken one."""


def renamed(old: str, new: str) -> Mistake:
    """Return what writes a field under another name."""
    return lambda records: [
        {(new if name == old else name): value for name, value in record.items()}
        for record in records
    ]


def in_every(change: Callable[[Record], Mapping[str, Any]]) -> Mistake:
    """Return what changes every record."""
    return lambda records: [{**record, **change(record)} for record in records]


def in_one(change: Callable[[Record], Mapping[str, Any]]) -> Mistake:
    """Return what changes the fourth record."""
    return lambda records: [
        {**record, **(change(record) if row == 3 else {})} for row, record in enumerate(records)
    ]


def poses(change: Callable[[list[Any]], object]) -> Mistake:
    """Return what changes every pose."""
    return in_every(lambda record: {"trajectory": [change(pose) for pose in record["trajectory"]]})


def ids(change: Callable[[str], object]) -> Mistake:
    """Return what changes every instr_id."""
    return in_every(lambda record: {"instr_id": change(record["instr_id"])})


def answers(change: Callable[[int], object]) -> Mistake:
    """Return what changes every object id."""
    return in_every(lambda record: {"predObjId": change(record["predObjId"])})


def without(*names: str) -> Mistake:
    """Return what leaves fields out of every record."""
    return lambda records: [
        {name: value for name, value in record.items() if name not in names} for record in records
    ]


def boxed(key: str = "predBox", **fields: object) -> Mistake:
    """Return what answers by box in every record, under a key."""
    right = {"predObjId": -1, key: [10, 20, 30, 40], "predView": 12}
    return in_every(lambda _: right | fields)


def text(records: Records) -> bytes:
    """Return the file as it should be."""
    return json.dumps(records).encode()


def tarred(records: Records) -> bytes:
    """Return a gzipped tar archive."""
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz") as archive:
        member = tarfile.TarInfo("submit.json")
        member.size = len(text(records))
        archive.addfile(member, io.BytesIO(text(records)))
    return packed.getvalue()


def zipped(*names: str) -> Mistake:
    """Return what packs the file under several names."""

    def pack(records: Records) -> bytes:
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w") as archive:
            for name in names:
                archive.writestr(name, text(records))
        return packed.getvalue()

    return pack


def from_one(instr_id: str) -> str:
    """Return an instr_id whose instruction is counted from 1."""
    item, _, index = instr_id.rpartition("_")
    return f"{item}_{int(index) + 1}"


def first_of_items(records: Records) -> Records:
    """Return one record for each item, with its id."""
    first = {record["instr_id"].rpartition("_")[0]: record for record in records}
    return [{**record, "instr_id": item} for item, record in first.items()]


def in_renamed_walks(records: Records) -> Records:
    """Return records with the walk in ``pred_path``, and the annotated one in ``path``."""
    return [
        {
            **{name: value for name, value in record.items() if name != "trajectory"},
            "path": [record["trajectory"][0][0]],
            "pred_path": record["trajectory"],
        }
        for record in records
    ]


MISTAKES: Mapping[str, Mistake] = MappingProxyType(
    {
        # Fields.
        **{
            f"predObjId written {name}": renamed("predObjId", name)
            for name in (
                *("predObjID", "predobjid", "pred_obj", "objId", "obj_id", "pred_object_id"),
                *("predictedObjId", "predObjIds"),
            )
        },
        **{f"predBox written {name}": boxed(name) for name in ("predbox", "pred_box", "predBBox")},
        "predView written pred_view, no angles": lambda records: [
            {
                "instr_id": record["instr_id"],
                "trajectory": [pose[:1] for pose in record["trajectory"]],
                "predBox": [10, 20, 30, 40],
                "pred_view": 12,
            }
            for record in records
        ],
        "trajectory written path": renamed("trajectory", "path"),
        "trajectory written traj": renamed("trajectory", "traj"),
        "trajectory written pred_path": renamed("trajectory", "pred_path"),
        "trajectory written pred_path beside path": in_renamed_walks,
        "instr_id written instruction_id": renamed("instr_id", "instruction_id"),
        "instr_id written id": renamed("instr_id", "id"),
        "instr_id written instrId": renamed("instr_id", "instrId"),
        "no trajectory": without("trajectory"),
        "no instr_id": without("instr_id"),
        "one record without an answer": lambda records: [
            *records[:-1],
            *without("predObjId")(records[-1:]),  # type: ignore[misc]
        ],
        "predObjId written in three ways": lambda records: [
            {("predObjID", "objId", "pred")[row % 3]: record["predObjId"]}
            | {name: record[name] for name in ("instr_id", "trajectory")}
            for row, record in enumerate(records)
        ],
        "a field twice": lambda records: text(records).replace(
            b'"predObjId"', b'"predObjId": 1, "predObjId"', 1
        ),
        # Ids.
        "object ids as decimals": answers(float),
        "object ids as decimals in text": answers(lambda answer: f"{abs(answer)}.0"),
        "object ids with a name": answers(lambda answer: f"obj_{answer}"),
        "object ids in lists": answers(lambda answer: [answer]),
        "object ids printed by PyTorch": answers("tensor({}, device='cuda:0')".format),
        "object ids printed by TensorFlow": answers("tf.Tensor({}, shape=(), dtype=int64)".format),
        "object ids printed by numpy": answers("[{}]".format),
        "object ids with a line end": answers("{}\r\n".format),
        "object ids as probabilities": answers(lambda _: 0.25),
        "object ids as booleans": answers(lambda answer: answer > 0),
        "object ids as NaN": answers(lambda _: float("nan")),
        "object ids as NaN where there is none": lambda records: [
            {**record, "predObjId": float("nan") if row % 9 == 0 else record["predObjId"]}
            for row, record in enumerate(records)
        ],
        "object ids with several zeros after the point": answers(
            lambda answer: f"{abs(answer)}.00"
        ),
        "object ids within quotes": answers('"{}"'.format),
        "object ids below -1": answers(lambda _: -2),
        "different answers under two keys": in_every(lambda _: {"pred_objid": "99999"}),
        "different answers under two spellings": in_every(lambda _: {"predObjid": 99999}),
        "predObjId null, answers under predObjid": in_every(
            lambda record: {"predObjId": None, "predObjid": record["predObjId"]}
        ),
        "instructions counted from 1": ids(from_one),
        "only the items' ids": first_of_items,
        "the prefix r2r_": ids("r2r_{}".format),
        "the prefix val_unseen_": ids("val_unseen_{}".format),
        "a prefix of two parts": lambda records: [
            {**record, "instr_id": f"x_{row}_{record['instr_id']}"}
            for row, record in enumerate(records)
        ],
        "ids without the object": ids(lambda it: "_".join(it.split("_")[::2])),
        "ids without the path": ids(lambda it: it.partition("_")[2]),
        "a space after every id": ids("{} ".format),
        "ids with a line end": ids("{}\r\n".format),
        "something after every id": ids("{}_0".format),
        "ids with other marks": ids(lambda instr_id: instr_id.replace("_", "-")),
        "ids of padded numbers": ids(
            lambda instr_id: "_".join(part.zfill(5) for part in instr_id.split("_"))
        ),
        "ids as lists of numbers": ids(lambda instr_id: list(map(int, instr_id.split("_")))),
        "ids with the object first": ids(
            lambda instr_id: "_".join(instr_id.split("_")[part] for part in (1, 0, 2))
        ),
        "ids in lists": ids(lambda instr_id: [instr_id]),
        "ids printed by numpy": ids("np.str_('{}')".format),
        "ids as numbers": ids(lambda instr_id: int(instr_id.replace("_", ""))),
        "ids of another split": lambda records: [
            {**record, "instr_id": instr_id}
            for record, instr_id in zip(records, _val_seen_ids(), strict=False)
        ],
        "one unknown id": in_one(lambda _: {"instr_id": "99999_9_0"}),
        # Completeness.
        "half of the records": lambda records: records[: len(records) // 2],
        "all but one record": lambda records: records[1:],
        "the last batch twice, without angles": lambda records: [
            *records,
            *poses(lambda pose: [pose[0], 0, 0])(records[-5:]),  # type: ignore[misc]
        ],
        "every record twice": lambda records: [*records, *records],
        "the last batch twice": lambda records: [*records, *records[-5:]],
        "two answers for an episode": lambda records: [
            *records,
            {**records[0], "predObjId": 12345},
        ],
        "no records": lambda _: [],
        "val_seen and val_unseen": lambda records: [
            *records,
            *({**records[0], "instr_id": instr_id} for instr_id in _val_seen_ids()),
        ],
        # Poses.
        "poses as objects": poses(
            lambda pose: {"viewpoint": pose[0], "heading": pose[1], "elevation": pose[2]}
        ),
        "poses as objects of another kind": poses(lambda pose: {"node": pose[0]}),
        "viewpoints as numbers": poses(lambda pose: [7, *pose[1:]]),
        "viewpoints with their scan": poses(lambda pose: [f"2t7WUuJeko7_{pose[0]}", *pose[1:]]),
        "viewpoints with spaces": poses(lambda pose: [f" {pose[0]}", *pose[1:]]),
        "viewpoints in capitals": poses(lambda pose: [pose[0].upper(), *pose[1:]]),
        "viewpoints with the number of a view": poses(lambda pose: [f"{pose[0]}_12", *pose[1:]]),
        "angles that are null": poses(lambda pose: [pose[0], None, None]),
        "one unknown viewpoint": in_one(lambda _: {"trajectory": [["ffff", 0, 0]]}),
        "angles as text": poses(lambda pose: [pose[0], str(pose[1]), str(pose[2])]),
        "angles printed by PyTorch": poses(
            lambda pose: [pose[0], *map("tensor({})".format, pose[1:])]
        ),
        "angles in lists": poses(lambda pose: [pose[0], *([angle] for angle in pose[1:])]),
        "poses in lists": poses(lambda pose: [pose]),
        "viewpoints with a line end": poses(lambda pose: [f"{pose[0]}\n", *pose[1:]]),
        "a heading without elevation": poses(lambda pose: pose[:2]),
        "an angle that is NaN": in_one(
            lambda record: {"trajectory": [[record["trajectory"][0][0], float("nan"), 0.0]]}
        ),
        "empty trajectories": in_every(lambda _: {"trajectory": []}),
        "no start viewpoint": in_every(lambda record: {"trajectory": record["trajectory"][1:]}),
        "trajectories as text": in_every(lambda record: {"trajectory": str(record["trajectory"])}),
        "trajectories in objects, as in SOON": in_every(
            lambda record: {"trajectory": {"path": record["trajectory"]}}
        ),
        "several trajectories, as in SOON": in_every(
            lambda record: {"trajectory": [{"path": record["trajectory"]}] * 2}
        ),
        "positions of RxR-Habitat": lambda records: b"\n".join(
            json.dumps({"instruction_id": row, "path": [[1.5, 0.1, -2.5]]}).encode()
            for row, _ in enumerate(records)
        ),
        "positions of VLN-CE": lambda records: {
            str(row): [{"position": [1.5, 0.1, -2.5], "heading": 0.5, "stop": True}]
            for row, _ in enumerate(records)
        },
        # Boxes.
        "null boxes without object ids": lambda records: [
            {**record, "predBox": None}
            for record in without("predObjId")(records)  # type: ignore[attr-defined]
        ],
        "a box and an object": boxed(predObjId=3),
        "boxes without area": boxed(predBox=[10, 20, 0, 0]),
        "boxes of three numbers": boxed(predBox=[10, 20, 30]),
        "views as decimals": boxed(predView=12.0),
        "predView written view": in_every(
            lambda _: {"predObjId": -1, "predBox": [10, 20, 30, 40], "view": 12}
        ),
        "view 36": boxed(predView=36),
        "boxes as fractions without a size": boxed(predBox=[0.25, 0.5, 0.2, 0.3]),
        "boxes of 1280 x 960 images without a size": boxed(predBox=[700, 500, 300, 200]),
        "angles in degrees, boxes without view": lambda records: [
            {
                **record,
                "trajectory": [
                    *record["trajectory"][:-1],
                    [record["trajectory"][-1][0], 0.0, 30.0],
                ],
                "predObjId": -1,
                "predBox": [10, 20, 30, 40],
            }
            for record in records
        ],
        # The file.
        "JSON Lines with a line of a log": lambda records: b"\n".join(
            [
                *(json.dumps(record).encode() for record in records[:3]),
                b"done",
                *(json.dumps(record).encode() for record in records[3:]),
            ]
        ),
        "printed by Python": lambda records: repr(records).encode(),
        "a pickle": pickle.dumps,
        '{"results": [...]}': lambda records: {"results": records},
        '{"version": 1, "meta": {...}, "results": [...]}': lambda records: {
            "version": 1,
            "meta": {"model": "ours"},
            "results": records,
        },
        '{"val_unseen": {"results": [...], "scores": {...}}}': lambda records: {
            "val_unseen": {"results": records, "scores": {"sr": 50.0}}
        },
        '{"1196_0_0": [{...}]}': lambda records: {
            record["instr_id"]: without("instr_id")([record]) for record in records
        },
        '{"val_unseen": {"sr": ...}}': lambda _: {"val_unseen": {"sr": 50.0, "spl": 40.0}},
        "the annotations": lambda records: [
            {
                "id": record["instr_id"].rpartition("_")[0],
                "path": [record["trajectory"][0][0]],
                "instructions": ["Clean the sink."],
                "objId": 3,
            }
            for record in records
        ],
        '{"results": {...}}': lambda records: {
            "results": {record["instr_id"]: record for record in records}
        },
        '{"val_seen": [...], "val_unseen": [...]}': lambda records: {
            "val_seen": [{**records[0], "instr_id": instr_id} for instr_id in _val_seen_ids()],
            "val_unseen": records,
        },
        "one list per process": lambda records: [records[:40], records[40:]],
        "two files joined": lambda records: text(records[:40]) + b"\n" + text(records[40:]),
        "JSON within JSON": lambda records: json.dumps(text(records).decode()).encode(),
        "records as text": lambda records: [json.dumps(record) for record in records],
        "records as lists": lambda records: [list(record.values()) for record in records],
        "records with commas between them alone": lambda records: b"".join(
            json.dumps(record).encode() + b",\n" for record in records
        ),
        "pandas to_json": lambda records: {
            name: {str(row): record[name] for row, record in enumerate(records)}
            for name in records[0]
        },
        'pandas to_json(orient="index")': lambda records: {
            str(row): record for row, record in enumerate(records)
        },
        'pandas to_json(orient="split")': lambda records: {
            "columns": list(records[0]),
            "index": list(range(len(records))),
            "data": [list(record.values()) for record in records],
        },
        'pandas to_json(orient="table")': lambda records: {
            "schema": {"fields": [{"name": "instr_id", "type": "string"}]},
            "data": records,
        },
        "one record": lambda records: records[0],
        "tar.gz": tarred,
        "bzip2": lambda records: bz2.compress(text(records)),
        "xz": lambda records: lzma.compress(text(records)),
        "gzipped twice": lambda records: gzip.compress(gzip.compress(text(records))),
        "a zip of two files": zipped("val_seen.json", "val_unseen.json"),
        "an empty zip": zipped(),
        "a damaged gzip": lambda records: gzip.compress(text(records))[:-20],
        "a mail signature after the JSON": lambda records: text(records) + b"\n-- \nBest regards",
        "a cut file": lambda records: text(records)[:-500],
        "an empty file": lambda _: b"",
        "zero bytes": lambda records: bytes(len(text(records))),
        "a web page": lambda _: b"<!DOCTYPE html><title>Sign in</title>",
        "a merge conflict": lambda records: (
            b"<<<<<<< HEAD\n%s\n=======\n%s\n>>>>>>> ours\n" % (text(records), text(records[1:]))
        ),
        "CSV": lambda _: b"instr_id,predObjId\n1_2_0,3\n",
        "Latin-1": lambda records: text(records).replace(
            b'"trajectory"', b'"\xe9", "trajectory"', 1
        ),
        "comments": lambda records: b"// results\n" + text(records),
        "a comma after the last record": lambda records: text(records)[:-1] + b",]",
    }
)
"""Every mistake, by what it is."""


def walks(change: Callable[[Record], Mapping[str, Any]]) -> Mistake:
    """Return what changes every trajectory of SOON's items."""
    return in_every(
        lambda record: {"trajectory": [dict(change(it)) for it in record["trajectory"]]}
    )


def respelt(old: str, new: str) -> Callable[[Record], Mapping[str, Any]]:
    """Return what writes a field of a trajectory under another name."""
    return lambda walk: {(new if name == old else name): value for name, value in walk.items()}


MISTAKES_OF_TASKS: Mapping[str, tuple[str, Mistake]] = MappingProxyType(
    {
        "NDH: inst_idx written instIdx": ("ndh", renamed("inst_idx", "instIdx")),
        "NDH: numbers as decimals": (
            "ndh",
            in_every(lambda record: {"inst_idx": float(record["inst_idx"])}),
        ),
        "NDH: numbers as decimals in text": (
            "ndh",
            in_every(lambda record: {"inst_idx": f"{record['inst_idx']}.0"}),
        ),
        "NDH: an index after every number": (
            "ndh",
            in_every(lambda record: {"inst_idx": f"{record['inst_idx']}_0"}),
        ),
        "NDH: NaviLLM's prefix": (
            "ndh",
            lambda records: [
                {**record, "inst_idx": f"cvdn_{row}_{record['inst_idx']}"}
                for row, record in enumerate(records)
            ],
        ),
        "R2R: paths without the instruction": (
            "r2r",
            ids(lambda instr_id: int(instr_id.partition("_")[0])),
        ),
        "R2R: path_id and instr_idx": (
            "r2r",
            lambda records: [
                {
                    "path_id": int(record["instr_id"].partition("_")[0]),
                    "instr_idx": int(record["instr_id"].partition("_")[2]),
                    "trajectory": record["trajectory"],
                }
                for record in records
            ],
        ),
        "RxR: paths without the instruction": (
            "rxr",
            ids(lambda instr_id: int(instr_id.partition("_")[0])),
        ),
        "SOON: obj_heading written objHeading": (
            "soon",
            walks(respelt("obj_heading", "objHeading")),
        ),
        "SOON: path written traj": ("soon", walks(respelt("path", "traj"))),
        "SOON: trajectories in a list of one": (
            "soon",
            in_every(lambda record: {"trajectory": [record["trajectory"]]}),
        ),
        "SOON: no points": ("soon", walks(lambda walk: {"path": walk["path"]})),
        "SOON: points printed by PyTorch": (
            "soon",
            walks(
                lambda walk: (
                    walk
                    | {
                        key: None if walk[key] is None else f"tensor([{walk[key]}])"
                        for key in ("obj_heading", "obj_elevation")
                    }
                )
            ),
        ),
        "SOON: lists of poses": (
            "soon",
            lambda records: [
                {**record, "trajectory": walk["path"]}
                for record in records
                for walk in record["trajectory"]
            ],
        ),
        "SOON: DUET's ids": ("soon", in_every(lambda _: {"instr_id": "4-0_0"})),
    }
)
"""Mistakes in files of the other tasks, with the task of each."""


def message_about_task(name: str) -> str:
    """Return what is said about the file of another task with a mistake."""
    task, mistake = MISTAKES_OF_TASKS[name]
    records = json.loads((SAMPLES / f"{task}.json").read_bytes())
    try:
        validate(json.dumps(mistake(records)).encode(), split=SPLIT, task=task)
    except SubmissionError as error:
        return str(error)
    return ""


def broken(name: str) -> bytes:
    """Return the file with a mistake."""
    made = MISTAKES[name]([dict(record) for record in OFFICIAL])
    return made if isinstance(made, bytes) else json.dumps(made).encode()


def message_about(name: str, truth: GroundTruth) -> str:
    """Return what is said about the file with a mistake; empty if it is accepted."""
    try:
        validate(broken(name), split=SPLIT, ground_truth=truth)
    except SubmissionError as error:
        return str(error)
    return ""


def _val_seen_ids() -> list[str]:
    return list(find_ground_truth(None, "val_seen").episodes.instr_ids)


def table(truth: GroundTruth) -> str:
    """Return the table of the documentation: each mistake and the first line about it.

    Mistakes share a row if their lines differ in nothing but what they quote.
    """
    told = {
        **{name: message_about(name, truth) for name in MISTAKES},
        **{name: message_about_task(name) for name in MISTAKES_OF_TASKS},
    }
    alike: dict[str, list[str]] = {}
    first: dict[str, str] = {}
    for name, message in told.items():
        line = message.splitlines()[1].replace("`", "").replace("<", "&lt;")
        kind = re.sub(r"'.*?'|\".*?\"", "", line)
        alike.setdefault(kind, []).append(name)
        first.setdefault(kind, line)
    rows = [f"| {'; '.join(names)} | {first[kind]} |" for kind, names in alike.items()]
    return "\n".join(["| mistake | first line of the message |", "|---|---|", *rows])


if __name__ == "__main__":
    sys.stdout.write(f"{table(find_ground_truth(None, SPLIT))}\n")
