"""Compare the fast reader of submissions with the careful one."""

import json
import random
import re
from collections.abc import Iterator, Mapping
from functools import cache

import numpy as np

from reverie_eval import SubmissionError
from reverie_eval.ground_truth import ViewpointTable
from reverie_eval.submissions._document import parse_document
from reverie_eval.submissions._fast import read_fast
from reverie_eval.submissions._faults import ReadingLog
from reverie_eval.submissions._records import read_carefully
from reverie_eval.tasks import BUILT_IN, Task, find_task
from tests.conftest import SAMPLES
from tests.support.broken_files import MISTAKES
from tests.support.forms import FORMS, OFFICIAL
from tests.support.json_records import boxes_of, columns_of, hops_of, places_of

_FEW = 3
"""Records of a small file."""
_BYTES = b' "[]{},:\\-+.eE0123456789afltrunul\n\x00\x80'


def read_by_both(content: bytes, task: Task, *, answers_only: bool = False) -> bool:
    """Read a file by both readers and compare; return whether the fast one took it."""
    fast = read_fast(content, task, viewpoints_in(content), answers_only=answers_only)
    if fast is None:
        return False
    log = ReadingLog()
    try:
        document = parse_document(content, log)
        careful = read_carefully(document, log, task, answers_only=answers_only)
    except SubmissionError as error:
        raise AssertionError(f"read fast, and refused: {error}: {content!r}") from error
    assert not careful.problems, content
    assert columns_of(fast) == columns_of(careful), content
    assert places_of(fast) == places_of(careful), content
    assert hops_of(fast) == hops_of(careful), content
    assert boxes_of(fast) == boxes_of(careful), content
    for name in ("answer_is_text", "has_leading_zeros"):
        assert getattr(fast, name).tolist() == getattr(careful, name).tolist(), content
    for name in ("is_navigation_only", "differences", "signs"):
        assert getattr(fast, name) == getattr(careful, name), (name, content)
    assert list(fast.read_as) == list(careful.read_as), content
    assert list(fast.ignored_fields.items()) == list(careful.ignored_fields.items()), content
    assert (fast.point is None) == (careful.point is None), content
    if fast.point is not None and careful.point is not None:
        assert np.array_equal(fast.point, careful.point, equal_nan=True), content
    return True


def viewpoints_in(content: bytes) -> ViewpointTable:
    """Return a table of what may be a viewpoint id in a file."""
    return ViewpointTable([each.decode() for each in set(re.findall(rb"[0-9a-f]{32}", content))])


@cache
def small_files() -> Mapping[str, tuple[bytes, Task]]:
    """Return files of few records by their names: of every form, task and mistake."""
    reverie, records = find_task("reverie"), list(OFFICIAL[:_FEW])
    files = {name: (form.bytes(records), reverie) for name, form in FORMS.items()}
    boxed = [{**each, "predObjId": -1, "predBox": [10, 20.5, 3e2, 40]} for each in records]
    drawn = {
        "boxes": [{**each, "predView": 12} for each in boxed],
        "boxes by the last camera": [
            {**each, "trajectory": [[v, h, 0.5] for v, h, _ in each["trajectory"]]}
            for each in boxed
        ],
        "scaled boxes, and none": [
            {**boxed[0], "predView": None, "predImageSize": [320, 240]},
            {**boxed[1], "predView": 0, "predImageSize": None},
            {**boxed[2], "predView": 35, "predImageSize": None, "predBox": None},
        ],
    }
    files |= {name: (json.dumps(each).encode(), reverie) for name, each in drawn.items()}
    for name in BUILT_IN:
        if name != "reverie":
            some = json.loads((SAMPLES / f"{name}.json").read_bytes())[:_FEW]
            files[name] = json.dumps(some).encode(), find_task(name)
            lines = b"\n".join(json.dumps(each).encode() for each in some)
            files[f"{name}, lines"] = lines, find_task(name)
    for name, mistake in MISTAKES.items():
        broken = mistake(records)
        content = broken if isinstance(broken, bytes) else json.dumps(broken).encode()
        files[name] = content, reverie
    return files


def edited(content: bytes, count: int, seed: object) -> Iterator[bytes]:
    """Yield so many copies of a file, each with one byte changed, added or removed."""
    chance = random.Random(str(seed))
    for _ in range(count):
        at, byte = chance.randrange(len(content) + 1), bytes([chance.choice(_BYTES)])
        removed = chance.choice((0, 1))
        yield content[:at] + (byte if chance.random() < 0.8 else b"") + content[at + removed :]
