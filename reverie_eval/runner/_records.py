"""The records of a run: its identity, its circumstances, and what is logged of each episode."""

import ast
import inspect
import re
import textwrap
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import msgspec

from reverie_eval import logs
from reverie_eval.logs import Attempt, State, Step, total_usage
from reverie_eval.simulator import MOST_ACTIONS

SCHEMA_VERSION = 1
"""The version of the files in a run's folder."""

KEPT: frozenset[State] = frozenset({"ended", "cut_off"})
"""The states of attempts whose record is a part of the submission."""


class Limits(msgspec.Struct, frozen=True, kw_only=True):
    """Where an episode is cut off, if the agent does not end it."""

    steps: int = MOST_ACTIONS
    """Actions in an episode, at most."""
    seconds: float | None = None
    """Seconds of an episode, looked at between two actions: none that has begun is interrupted."""


class Identity(msgspec.Struct, frozen=True, kw_only=True):
    """Everything that can change an answer. A run that goes on has the same identity."""

    task: str
    """The benchmark, such as ``reverie``."""
    split: str
    """The split, such as ``val_unseen``."""
    fingerprint: str
    """SHA-256 of all that scores depend on."""
    shown: str
    """SHA-256 of what else is shown: instructions, names, headings at the start."""
    episodes: str
    """``all``, or the digest of a declared subset, as in signatures."""
    agent: str
    """The agent's name, or its file without the folder."""
    agent_version: str
    """The class's ``version``; empty if it has none."""
    agent_digest: str
    """A digest of the file that defines the agent, and of those beside it that it imports."""
    options: Mapping[str, Any]
    """The agent's options, or what of them can change an answer."""
    seed: int
    """Seed from which, with its id, each episode has a seed of its own."""
    limits: Limits
    """Where an episode is cut off."""
    boxes: str
    """Where the objects are from: ``solution``, ``none``, or a digest of the files."""
    pictures: str
    """Where pictures are from: ``none``, or a digest of the names and sizes of the split's."""
    reverie_eval: str
    """The version that showed the observations."""

    def differences(self, begun: "Identity") -> Iterable[str]:
        """Yield a line for each thing that was different when the run was begun."""
        mine, its = _by_title(self), _by_title(begun)
        for title in [*mine, *(each for each in its if each not in mine)]:
            now, was = mine.get(title, "not given"), its.get(title, "not given")
            if now != was:
                yield f"{title}: {was}, now {now}"


class Circumstance(msgspec.Struct, frozen=True, kw_only=True):
    """What cannot change an answer. It is noted each time that a run is started, never compared."""

    started: str
    """ISO 8601, in UTC."""
    jobs: int
    """Number of processes, or of threads."""
    options: Mapping[str, Any]
    """The agent's options as they were given, also those that cannot change an answer."""
    ground_truth: str
    """The path of the bundle."""
    boxes: str | None
    """The path of the boxes; null for those of the bundle."""
    pictures: str | None
    """The folder of the pictures, if there is one."""
    python: str
    """Version of Python."""
    platform: str
    """Operating system and processor."""


class Totals(msgspec.Struct, frozen=True, kw_only=True):
    """The outcome of a run. Each episode is one of the first four."""

    ended: int
    """Episodes that the agent ended, with an answer or a ``Stop``."""
    cut_off: int
    """Episodes that were ended for it, without an answer."""
    failed: int
    """Episodes whose last attempt ended in an error."""
    missing: int
    """Episodes that were not begun, or interrupted."""
    filled: int
    """Failed and missing episodes that the submission has a stop at the start for."""
    attempts: int
    """All of them, also those that failed or were interrupted; and so are the figures below."""
    steps: int
    """Number of all steps."""
    seconds: float
    """Seconds that the agent took in all attempts; those of a batch share its time."""
    input_tokens: int | None
    """All that were sent to a model, cached ones included; null if there is no such number."""
    cached_tokens: int | None
    """Tokens sent that the endpoint had in a cache."""
    output_tokens: int | None
    """All that came back, those of reasoning included."""
    reasoning_tokens: int | None
    """Tokens that came back as reasoning."""
    money: float | None
    """US dollars; null if a step has tokens but no price."""
    read: tuple[str, ...]
    """The parts of observations that the agent read in any attempt, and ``solution``."""

    @classmethod
    def of(cls, attempts: Sequence[Attempt], episodes: Collection[str], filled: int) -> "Totals":
        """Add up the attempts of a run."""
        last = {each.episode: each.state for each in attempts}
        states = Counter(last.get(episode) for episode in episodes)
        done = {state: states[state] for state in ("ended", "cut_off", "failed")}
        return cls(
            **done,
            missing=len(episodes) - sum(done.values()),
            filled=filled,
            attempts=len(attempts),
            steps=sum(each.steps for each in attempts),
            seconds=sum(each.seconds for each in attempts),
            read=tuple(sorted({part for each in attempts for part in each.read})),
            **asdict(total_usage(attempts)),
        )


class RunCard(msgspec.Struct, frozen=True, kw_only=True):
    """The file ``run.json``."""

    schema_version: int
    """The version of the files in the folder."""
    identity: Identity
    """Everything that can change an answer."""
    circumstances: Sequence[Circumstance]
    """One for each time that the run was started."""
    totals: Totals | None
    """Null while the run goes on."""


def encode(row: msgspec.Struct) -> bytes:
    """Return a record as a line of JSON."""
    return _ENCODER.encode(row) + b"\n"


def _plain(value: Any) -> Any:
    """Return a number of numpy as one of Python."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be written as JSON")


_ENCODER = msgspec.json.Encoder(enc_hook=_plain)


_TITLES: Mapping[str, str] = MappingProxyType(
    {
        "fingerprint": "fingerprint of the ground truth",
        "shown": "digest of instructions, names and headings",
        "agent_version": "version of the agent",
        "agent_digest": "digest of the agent's code",
        "reverie_eval": "version of reverie-eval",
    }
)
"""What fields are called in messages, if not by their name."""


def _by_title(identity: Identity) -> Mapping[str, str]:
    """Return the values of an identity as texts, by titles that messages can have."""
    plain = msgspec.to_builtins(identity)
    options, limits = plain.pop("options"), plain.pop("limits")
    values = {
        **{_TITLES.get(name, name): value for name, value in plain.items()},
        **{f"option {name}": value for name, value in options.items()},
        **{f"limit of {name}": value for name, value in limits.items()},
    }
    return {title: _shown(value) for title, value in values.items()}


def _shown(value: object) -> str:
    """Return a value as text; of a SHA-256, as much as a signature has."""
    text = "none" if value in (None, "") else str(value)
    return text[:12] if re.fullmatch("[0-9a-f]{64}", text) else text


# The JSON Schemas of the files.


RUN_SCHEMAS: Mapping[str, type[msgspec.Struct]] = MappingProxyType(
    {"run-card": RunCard, "run-episode": Attempt, "run-step": Step}
)
"""The records of a run's files by the names of their schemas."""


def run_schema(name: str) -> dict[str, Any]:
    """Return the JSON Schema of ``run.json``, or of a line of another file, by its name.

    Fields are described by their docstrings, which msgspec does not read.
    """
    schema = msgspec.json.schema(RUN_SCHEMAS[name])
    for title, definition in schema["$defs"].items():
        about = dict(_field_docstrings({**vars(logs), **globals()}[title]))
        for field, details in definition["properties"].items():
            details["description"] = about[field]
    return schema


def _field_docstrings(record: type) -> Iterator[tuple[str, str]]:
    """Yield the fields of a class, each with the text below it."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(record)))
    (definition,) = tree.body
    for field, below in pairwise(getattr(definition, "body", ())):
        match field, below:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(ast.Constant(str(text))):
                yield name, " ".join(text.split())
            case _:
                pass
