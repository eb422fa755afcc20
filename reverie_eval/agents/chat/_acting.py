"""Actions in a model's replies."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

from reverie_eval.simulator import Action, Answer, AnswerBox, Go, Stop

T = TypeVar("T")


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
        thought = str(reply.get("thought") or "")
        return Chosen(self._action(reply), thought, json.dumps(reply, ensure_ascii=False))

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
    """Return the last JSON object in a text: some models think aloud before it."""
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
    number = int(given) if isinstance(given, str) and given.isdecimal() else given
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
