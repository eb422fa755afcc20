"""What is said to a model, and what its replies mean: prompts, observations in words, actions.

The texts are files, which a user can replace.
"""

import hashlib
import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import Any, NamedTuple, TypeVar

from reverie_eval.errors import ReverieEvalError
from reverie_eval.geometry import FOCAL_LENGTH, N_HEADINGS, STEP, WIDTH
from reverie_eval.simulator import (
    Action,
    Answer,
    AnswerBox,
    Candidate,
    Go,
    Neighbour,
    Observation,
    Stop,
)
from reverie_eval.text import did_you_mean, short_digest, whole_letters

DEFAULT_PROMPTS = Path(__file__).parent / "prompts"
"""The folder of our own."""

AHEAD = 10
"""Degrees on each side that are straight ahead, or behind."""
STEEP = math.radians(15)
"""From here on, a way leads up or down stairs."""
N_PICTURES = 6
"""Level views, every second of the twelve; each is 75 degrees wide, so they overlap."""
T = TypeVar("T")
_SYSTEM = frozenset({"instruction", "moves"})
# The names of the files, without ``.txt``, and the placeholders of each. The first four begin an
# episode: the answer is an object, a box, the place alone, or the end of a route.
_PLACEHOLDERS: Mapping[str, frozenset[str]] = {
    "object": _SYSTEM,
    "box": _SYSTEM,
    "place": _SYSTEM,
    "route": _SYSTEM,
    "step": frozenset({"map", "place", "neighbours", "visible", "moves_left"}),
    "repair": frozenset({"problem"}),
}
_FIRST_LEVEL_VIEW = N_HEADINGS
# Characters of a reply in which its action is looked for, at the end.
_LONGEST_REPLY = 100_000
# Of a number in a reply: enough for those of objects, and Python reads no thousands of digits.
_MOST_DIGITS = 9


class Prompts:
    """The texts of a folder, each with placeholders such as ``$instruction``.

    Parameters
    ----------
    folder : Path, optional
        Texts that it does not have are ours.

    Raises
    ------
    ReverieEvalError
        If the folder cannot be read, has a text of another name, or a placeholder of another name.
    """

    def __init__(self, folder: Path | None = None) -> None:
        own = [] if folder is None else _texts_in(folder)
        files = {path.stem: path for path in (*DEFAULT_PROMPTS.glob("*.txt"), *own)}
        self._texts = {name: _read(path) for name, path in sorted(files.items())}

    @property
    def digest(self) -> str:
        """A digest of all texts."""
        return short_digest(hashlib.sha256(repr(self._texts).encode()).hexdigest())

    def fill(self, name: str, **values: object) -> str:
        """Return a text with its placeholders filled; lines that are left empty are joined."""
        text = Template(self._texts[name]).substitute(values)
        return re.sub(r"\n{3,}", "\n\n", text).strip()


def _texts_in(folder: Path) -> list[Path]:
    files = sorted(folder.glob("*.txt"))
    if not files:
        raise ReverieEvalError(f"{folder}: there is no folder with prompts, such as object.txt")
    for file in files:
        if file.stem not in _PLACEHOLDERS:
            raise ReverieEvalError(
                f"{file} is not a prompt{did_you_mean(file.stem, _PLACEHOLDERS)}"
            )
    return files


def _read(file: Path) -> str:
    """Return the text of a file whose placeholders are known."""
    known = _PLACEHOLDERS[file.stem]
    try:
        text = file.read_text("utf-8")
        Template(text).substitute(dict.fromkeys(known, ""))
    except UnicodeDecodeError as error:
        raise ReverieEvalError(f"{file}: {error}") from None
    except KeyError as error:
        listed = ", ".join(f"${name}" for name in sorted(known)) or "none"
        raise ReverieEvalError(
            f"{file}: unknown placeholder ${error.args[0]}; there are: {listed}"
        ) from None
    except ValueError:
        raise ReverieEvalError(f"{file}: a $ that is not of a placeholder is written $$") from None
    return text


class NumberedMap:
    """The part of a building that was seen: places by numbers, in the order in which they came."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}
        self._ways: dict[int, list[int]] = {}
        self._objects: dict[int, str] = {}
        self._walked: list[int] = []

    def enter(self, seen: Observation) -> int:
        """Return the number of a place, and give its neighbours theirs."""
        here = self.number(seen.viewpoint_id)
        self._walked.append(here)
        self._ways[here] = [self.number(way.viewpoint_id) for way in seen.neighbours]
        return here

    def note_objects(self, candidates: Sequence[Candidate]) -> None:
        """Remember the names of what is visible from the last place."""
        names = sorted({each.name for each in candidates} - {""})
        self._objects[self._walked[-1]] = f"; visible: {', '.join(names)}" if names else ""

    def number(self, viewpoint_id: str) -> int:
        """Return the number of a place."""
        return self._numbers.setdefault(viewpoint_id, len(self._numbers) + 1)

    def is_visited(self, number: int) -> bool:
        """Whether the agent was at a place."""
        return number in self._ways

    def map(self, thought: str) -> str:
        """Return a description of all visited places, with what was thought last."""
        lines = [
            f"- place {number} leads to {_list(ways)}{self._objects.get(number, '')}"
            for number, ways in self._ways.items()
        ]
        unknown = sorted(set(self._numbers.values()) - self._ways.keys())
        ends = [
            f"Your way so far: {_list(self._walked)}",
            *[f"Not visited yet: {_list(unknown)}"] * bool(unknown),
            *[f"Your last thought: {thought}"] * bool(thought),
        ]
        return "\n".join(["Your map:", *lines, *ends])


def _list(numbers: Iterable[int]) -> str:
    return ", ".join(map(str, numbers))


def describe_ways(
    seen: Observation,
    neighbours: Sequence[Neighbour],
    explored: NumberedMap,
    pictures: Sequence[int],
) -> str:
    """Return a line for each neighbour that is left; with pictures, also in which it is."""
    lines = [_way(seen, each, explored, pictures) for each in neighbours]
    return "\n".join(lines) or "- nowhere any more"


def _way(seen: Observation, way: Neighbour, explored: NumberedMap, pictures: Sequence[int]) -> str:
    number = explored.number(way.viewpoint_id)
    elevation = seen.elevation + way.relative_elevation
    parts = [
        f"- place {number}: {direction(way.relative_heading)}",
        f"{way.distance:.1f} m",
        *["upwards"] * (elevation > STEEP),
        *["downwards"] * (elevation < -STEEP),
        *["visited"] * explored.is_visited(number),
    ]
    if pictures:
        off = [abs(_heading_of(seen, view) - way.relative_heading) for view in pictures]
        nearest = min(range(len(pictures)), key=lambda row: min(off[row], math.tau - off[row]))
        parts.append(f"in picture {nearest + 1}")
    return ", ".join(parts)


def describe_objects(seen: Observation) -> str:
    """Return a line for each visible object, from left to right."""
    lines = [
        f"- object {number}: {name or 'unnamed'}, {direction(heading)}"
        for heading, number, name in sorted(
            (_heading_of_object(seen, each), each.object_id, each.name) for each in seen.candidates
        )
    ]
    return "\n".join(["Visible from here:", *lines]) if lines else "No object is visible from here."


def pictures_around(seen: Observation) -> Sequence[int]:
    """Return the views to show, clockwise from the one that is nearest to straight ahead."""
    first = round(seen.heading / STEP)
    step = N_HEADINGS // N_PICTURES
    return [_FIRST_LEVEL_VIEW + (first + step * row) % N_HEADINGS for row in range(N_PICTURES)]


def captions_of(seen: Observation, views: Sequence[int]) -> str:
    """Return a line for each picture."""
    lines = [
        f"- picture {row}: {direction(_heading_of(seen, view))}"
        for row, view in enumerate(views, 1)
    ]
    return "\n".join(["The pictures show:", *lines])


def direction(heading: float) -> str:
    """Return a relative heading in words.

    >>> [direction(math.radians(each)) for each in (0, 45, -90, 175)]
    ['straight ahead', '45° right', '90° left', 'behind you']
    """
    degrees = round(math.degrees(heading))
    if abs(degrees) <= AHEAD:
        return "straight ahead"
    if abs(degrees) >= 180 - AHEAD:
        return "behind you"
    return f"{abs(degrees)}° {'right' if degrees > 0 else 'left'}"


def _heading_of(seen: Observation, view: int) -> float:
    """Return the heading of a view, relative to where the agent looks, in [-pi, pi]."""
    return math.remainder(view % N_HEADINGS * STEP - seen.heading, math.tau)


def _heading_of_object(seen: Observation, candidate: Candidate) -> float:
    """Return the relative heading of an object's largest box."""
    view, (left, _, width, _) = max(candidate.boxes, key=lambda box: box.xywh[2] * box.xywh[3])
    off = math.atan2(left + width / 2 - WIDTH / 2, FOCAL_LENGTH)
    return math.remainder(_heading_of(seen, view) + off, math.tau)


class Chosen(NamedTuple):
    """What a model chose."""

    action: Action
    thought: str
    text: str
    """The JSON object alone."""


class NoActionError(Exception):
    """Says what is wrong with a reply, for the model to read."""


@dataclass(frozen=True)
class Choices:
    """What a model can choose from, by the numbers that it is told."""

    viewpoints: Mapping[int, str]
    """The viewpoints that it can go to."""
    objects: Mapping[int, int] | None = None
    """The objects that it can answer with; None if it does not answer with one."""
    pictures: Mapping[int, int] | None = None
    """The views in which it can draw a box; None if it does not answer with one."""

    @property
    def response_format(self) -> Mapping[str, Any]:
        """The form of a reply, as endpoints take it: all fields, null where they do not apply."""
        number = {"type": ["integer", "null"]}
        box = {"type": ["array", "null"], "items": {"type": "number"}}
        answer: Mapping[str, Any] = {}
        if self.objects is not None:
            answer = {"object": number}
        if self.pictures is not None:
            answer = {"picture": number, "box": box}
        actions = ["go", *["answer"] * bool(answer), "stop"]
        fields = {
            "thought": {"type": "string"},
            "action": {"type": "string", "enum": actions},
            "place": number,
            **answer,
        }
        schema = {
            "type": "object",
            "properties": fields,
            "required": list(fields),
            "additionalProperties": False,
        }
        return {
            "type": "json_schema",
            "json_schema": {"name": "action", "strict": True, "schema": schema},
        }

    def read(self, text: str) -> Chosen:
        """Return the action in a reply.

        Raises
        ------
        NoActionError
            If the reply has no action that the agent can take.
        """
        reply = _last_object(text)
        thought = whole_letters(str(reply.get("thought") or ""))
        said = whole_letters(json.dumps(reply, ensure_ascii=False))
        return Chosen(self._action(reply), thought, said)

    def _action(self, reply: Mapping[str, Any]) -> Action:
        match reply.get("action"):
            case "go":
                return Go(_chosen(reply, "place", self.viewpoints))
            case "answer" if self.objects is not None:
                return Answer(_chosen(reply, "object", self.objects))
            case "answer" if self.pictures is not None:
                view = _chosen(reply, "picture", self.pictures)
                return AnswerBox(view, _box(reply.get("box")))
            case "stop":
                return Stop()
            case other:
                raise NoActionError(f'"action" is {json.dumps(other)}')


def _last_object(text: str) -> Mapping[str, Any]:
    """Return the last JSON object in a text: some models think aloud before it.

    What is in a thought's tags is not a reply, also if only one of the tags is there. A long text
    is looked at near its end alone, because each ``{`` in it may begin an object.
    """
    text = text.rpartition("</think>")[2].partition("<think>")[0][-_LONGEST_REPLY:]
    decoder, at = json.JSONDecoder(), text.find("{")
    found: Mapping[str, Any] | None = None
    while at >= 0:
        try:
            value, end = decoder.raw_decode(text, at)
        except (ValueError, RecursionError):
            end = at + 1
        else:
            found = value
        at = text.find("{", end)
    if found is None:
        raise NoActionError("it has no JSON object")
    return found


def _chosen(reply: Mapping[str, Any], name: str, known: Mapping[int, T]) -> T:
    given = reply.get(name)
    number = given
    if isinstance(given, str) and given.isdecimal() and len(given) <= _MOST_DIGITS:
        number = int(given)
    if type(number) is int and number in known:
        return known[number]
    can_be = ", ".join(map(str, known)) or "none, so choose another action"
    raise NoActionError(f'"{name}" is {json.dumps(given)}, and can be: {can_be}')


def _box(box: Any) -> tuple[float, float, float, float]:
    if isinstance(box, list) and len(box) == 4 and all(type(each) in (int, float) for each in box):
        left, top, width, height = map(float, box)
        if math.isfinite(left + top + width + height) and min(width, height) > 0:
            return left, top, width, height
    raise NoActionError(f'"box" is {json.dumps(box)}, and should be left, top, width and height')
