"""What reads files that others wrote, as functions of bytes, and small files to start from."""

import atexit
import gzip
import json
import shutil
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import mkdtemp
from types import MappingProxyType

from reverie_eval import DatasetError, GroundTruth, SubmissionError, evaluate
from reverie_eval.dataset import (
    DatasetFiles,
    compile_split,
    describe_dataset,
    lint_dataset,
    parse_house,
)
from tests.support.broken_files import MISTAKES
from tests.support.drawings import BOX
from tests.support.flat_world import FLAT, SINK, TUB, WALKS
from tests.support.forms import FORMS, Record
from tests.support.worlds import OBJECT_POSITIONS, SPLIT, ground_truth_by_hand, write_world


@dataclass(frozen=True)
class FileReader:
    """A way to read a file, the only errors that it may raise, and files to start from."""

    read: Callable[[bytes], object]
    refusals: tuple[type[Exception], ...]
    examples: Callable[[], Sequence[bytes]]
    head: int = 0
    """Bytes before the file itself, which say what file it is."""

    def accepts(self, content: bytes) -> bool:
        """Read a file; whether it was accepted. All but a refusal is a fault."""
        try:
            self.read(content)
        except self.refusals:
            return False
        return True


@cache
def _truth() -> GroundTruth:
    return ground_truth_by_hand(FLAT)


def _score(content: bytes) -> object:
    return evaluate(content, split=SPLIT, ground_truth=_truth()).to_report()


def _submissions() -> Sequence[bytes]:
    """Return a file of each form that is read, and of each mistake that is known."""
    records: list[Record] = [
        {
            "instr_id": f"7_1_{row}",
            "trajectory": [[place, 0.0, 0.0] for place in walk],
            "predObjId": answer,
        }
        for row, (walk, answer) in enumerate(WALKS)
    ]
    boxes = [{**record, "predObjId": -1, "predBox": BOX, "predView": 12} for record in records]
    made = [*(form.bytes(records) for form in FORMS.values()), json.dumps(boxes).encode()]
    for mistake in MISTAKES.values():
        broken = mistake([dict(record) for record in records])
        made.append(broken if isinstance(broken, bytes) else json.dumps(broken).encode())
    return [*made, gzip.compress(made[0], mtime=0), _zipped(made[0])]


def _zipped(content: bytes) -> bytes:
    packed = BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("submit.json", content)
    return packed.getvalue()


@cache
def _dataset() -> tuple[Path, Sequence[tuple[Path, bytes]]]:
    """Write a dataset, and return its folder and its files with what they hold."""
    folder = Path(mkdtemp(prefix="reverie-eval-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    scan = replace(FLAT.scans["flat"], centres={TUB: (8.0, 8.0, 1.0), SINK: (9.0, 6.0, 1.0)})
    write_world(replace(FLAT, scans={"flat": scan}), folder)
    files = sorted(path for path in folder.rglob("*.json"))
    return folder, [(path, path.read_bytes()) for path in files]


def _compile(content: bytes) -> object:
    """Check, describe and compile a dataset, one file of which is another.

    The first byte says which file, the rest is its content.
    """
    folder, files = _dataset()
    path, original = files[content[0] % len(files) if content else 0]
    path.write_bytes(content[1:])
    try:
        centres = folder / OBJECT_POSITIONS
        dataset = DatasetFiles.find(folder, split=SPLIT, object_positions=centres)
        lint_dataset(dataset)
        describe_dataset(dataset)
        return compile_split(dataset, SPLIT)
    finally:
        path.write_bytes(original)


def _datasets() -> Sequence[bytes]:
    _, files = _dataset()
    return [bytes([row]) + content for row, (_, content) in enumerate(files)]


HOUSE = """ASCII 1.1
H demo - 0 1 0 0 0 4 2 1 1 1 0 0 0 0 0 -5 -5 0 5 5 3 0 0 0 0 0
L 0 1 - 0 0 1 -5 -5 0 5 5 3 0 0 0 0 0
R 0 0 0 0 d 0 0 1 -5 -5 0 5 5 3 2.8 0 0 0 0
P 0 0 1 - 0 0 0 1 1 2 0 0 0 0
P 0123456789abcdef 0 0 0 0 0 1.5 0 0 0 0 0
C 0 12 dining#room#chair 3 chair 0 0 0 0 0
C 1 7 - 41 unlabeled 0 0 0 0 0
O 3 -1 -1 1 2 3 0 0 1 1 0 0 .9 .5 .2 0 0 0 0 0 0 0 0
O 0 0 0 0.5 0 0.25 2 0 0 0 3 0 1 0.5 0.25 0 0 0 0 0 0 0 0
O 1 0 0 0 0 0 1 0 0 0 1 0 -1 -1 -1 0 0 0 0 0 0 0 0
O 2 0 1 0 0 0 1 0 0 0 1 0 1 1 0 0 0 0 0 0 0 0 0
"""


def _read_house(content: bytes) -> object:
    return parse_house(content.decode("utf-8", "replace"), "a.house")


READERS: Mapping[str, FileReader] = MappingProxyType(
    {
        "submissions": FileReader(_score, (SubmissionError,), _submissions),
        "datasets": FileReader(_compile, (DatasetError,), _datasets, head=1),
        "houses": FileReader(_read_house, (DatasetError,), lambda: [HOUSE.encode()]),
    }
)
"""Every reader by what it reads."""
