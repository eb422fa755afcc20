"""Submission files at random: sound ones, ones with mistakes that people make, and broken ones.

Each file comes from a seed, so a file that fails can be made again from the number in the message.
"""

import gzip
import json
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass
from random import Random
from typing import Any, TypeAlias

from reverie_eval import GroundTruth
from reverie_eval.runner import run_agent
from tests.support.broken_files import MISTAKES
from tests.support.forms import FORMS

Record: TypeAlias = dict[str, Any]
Box: TypeAlias = Sequence[float]

ODD_VALUES: Sequence[Any] = (
    *(None, True, -1, 0, 2**31, -(2**70), 1e300, 0.5, "", "-1", "\ud800", "\0", "x" * 3000),
    *([], {}, [[]], {"": None}, [1, [2, [3, [4]]]], float("nan"), float("inf")),
)
"""What stands where something else should."""

BOX_MISTAKES: Sequence[Callable[[Box], Box]] = (
    lambda box: box,
    lambda box: (box[0], box[1], box[0] + box[2], box[1] + box[3]),  # two corners
    lambda box: (box[1], box[0], box[3], box[2]),  # y before x
    lambda box: (box[0] + box[2] / 2, box[1] + box[3] / 2, box[2], box[3]),  # by its centre
    lambda box: (box[0] / 640, box[1] / 480, box[2] / 640, box[3] / 480),  # in fractions
    lambda box: tuple(value / 2 for value in box),  # of an image half the size
    lambda box: tuple(value * 1000 / 640 for value in box),  # of one of 1000 pixels
    lambda box: (box[0], 480 - box[1] - box[3], box[2], box[3]),  # from the lower edge
    lambda box: (640 - box[0] - box[2], box[1], box[2], box[3]),  # mirrored
)
"""Ways to write a box of ``[x, y, width, height]``, the right one first."""
VIEW_MISTAKES: Sequence[Callable[[int], int]] = (
    lambda view: view,
    lambda view: 35 - view,  # upside down
    lambda view: (view + 12) % 36,  # elevations counted from elsewhere
    lambda view: view + 1,  # counted from 1; 36 is not a view
    lambda view: view // 12 * 12 + (view + 6) % 12,  # turned by half
)
_AGENTS = ("shortest", "random", "stop")


@dataclass(frozen=True)
class FileMaker:
    """Makes files for a split, some of them out of what ground truths have for answers."""

    truths: Sequence[GroundTruth]

    def file(self, seed: int) -> bytes:
        """Return the file of a seed."""
        random = Random(seed)
        records = self._records(random)
        match random.choice(["sound", "boxes", "boxes", "mistake", "form", "nodes", "bytes"]):
            case "sound":
                made: object = records
            case "boxes":
                made = self._boxed(random, records)
            case "mistake":
                made = random.choice(list(MISTAKES.values()))(records)
            case "form":
                made = random.choice(list(FORMS.values())).bytes(records)
            case "nodes":
                made = with_odd_values(random, self._boxed(random, records))
            case _:
                made = with_odd_bytes(random, _text(records))
        content = made if isinstance(made, bytes) else _text(made)
        return gzip.compress(content, mtime=0) if random.random() < 0.05 else content

    def _records(self, random: Random) -> list[Record]:
        truth = random.choice(self.truths)
        agent = random.choice(_AGENTS)
        return json.loads(_text(run_agent(agent, truth, random.randrange(100))))  # type: ignore[no-any-return]

    def _boxed(self, random: Random, records: list[Record]) -> list[Record]:
        """Answer by boxes of a ground truth, all with the same mistake of writing them."""
        truth = random.choice(self.truths)
        write, turn = random.choice(BOX_MISTAKES), random.choice(VIEW_MISTAKES)
        fields = random.choice([{}, {}, {"predImageSize": [1, 1]}, {"predImageSize": [1000, 750]}])
        share, has_views = random.choice([1, 1, 0.5]), random.random() < 0.8
        boxes = _boxes_by_viewpoint(truth)
        changed = []
        for record in records:
            seen = boxes.get(record["trajectory"][-1][0], [])
            if not seen or random.random() > share:
                changed.append(record)
                continue
            view, box = random.choice(seen)
            drawn = {"predObjId": -1, "predBox": write(box), **fields}
            changed.append(record | drawn | ({"predView": turn(view)} if has_views else {}))
        return changed


def _boxes_by_viewpoint(truth: GroundTruth) -> dict[str, list[tuple[int, Box]]]:
    boxes = truth.require_solution().boxes
    found: dict[str, list[tuple[int, Box]]] = {}
    viewpoints = boxes.candidate_viewpoint[boxes.candidate].tolist()
    for row, view, xywh in zip(viewpoints, boxes.view.tolist(), boxes.xywh.tolist(), strict=True):
        found.setdefault(truth.graph.viewpoint_ids[row], []).append((view, xywh))
    return found


def _text(document: object) -> bytes:
    return json.dumps(document).encode()


def with_odd_values(random: Random, document: Any) -> Any:
    """Change, remove, repeat or rename a few values anywhere in a document."""
    for _ in range(random.choice([1, 1, 1, 3, 20])):
        holder, key = random.choice(list(_places(document)))
        match random.choice(["odd", "odd", "remove", "repeat", "text", "swap"]):
            case "odd":
                holder[key] = deepcopy(random.choice(ODD_VALUES))
            case "remove":
                del holder[key]
            case "repeat" if isinstance(holder, list):
                holder.insert(key, deepcopy(holder[key]))
            case "repeat":
                holder[f"{key} "] = deepcopy(holder[key])
            case "text":
                holder[key] = str(holder[key])
            case _:
                other, place = random.choice(list(_places(document)))
                holder[key] = deepcopy(other[place])
        if not document:
            return document
    return document


def damaged(random: Random, content: bytes) -> bytes:
    """Return a file with mistakes: in its values, or in its bytes, as always if it is not JSON."""
    try:
        document = json.loads(content)
    except (ValueError, RecursionError):
        return with_odd_bytes(random, content)
    if not isinstance(document, list | dict) or not document or random.random() < 0.5:
        return with_odd_bytes(random, content)
    return json.dumps(with_odd_values(random, document)).encode()


def _places(document: Any) -> Iterator[tuple[Any, Any]]:
    """Yield every value of a document as what holds it and its key."""
    keys = list(document) if isinstance(document, dict) else range(len(document))
    for key in keys:
        yield document, key
        if isinstance(document[key], list | dict):
            yield from _places(document[key])


def with_odd_bytes(random: Random, content: bytes) -> bytes:
    """Change, remove, repeat or insert a few pieces of a file."""
    for _ in range(random.choice([1, 1, 2, 10])):
        start = random.randrange(len(content) + 1)
        end = min(len(content), start + random.choice([0, 1, 1, 2, 50, 2000]))
        piece = random.choice(
            [b"", content[start:end] * 2, random.randbytes(2), *_TOKENS, content[: end - start]]
        )
        content = content[:start] + piece + content[end:]
    return content


_TOKENS = (
    *(b"[", b"]", b"{", b"}", b",", b":", b'"', b"\\", b"null", b"NaN", b"1e999", b"-", b"0"),
    *(b"\xef\xbb\xbf", b"\x00", b"\xff", b"[" * 2000, b'{"":' * 500, b"9" * 5000, b"\\ud800"),
    *(b"\x1f\x8b\x08", b"PK\x03\x04", b"\r\n"),
)
