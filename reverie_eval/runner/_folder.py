"""The folder of a run: its records, what is appended as episodes are run, and how it is read again.

The card has the run's identity and circumstances; the logs have a line for each step and attempt.
"""

import ast
import inspect
import os
import textwrap
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec
from typing_extensions import Self

from reverie_eval import logs
from reverie_eval.errors import RunError
from reverie_eval.files import made_folder, staged_file
from reverie_eval.logs import (
    CARD,
    EPISODES,
    STEPS,
    Attempt,
    State,
    Step,
    read_attempts,
    read_steps,
    total_usage,
)
from reverie_eval.processes import locked_folder
from reverie_eval.text import changes, count_text, first_few

_LOGS = (EPISODES, STEPS)
SCHEMA_VERSION = 1
"""The version of the files in a run's folder."""

KEPT: frozenset[State] = frozenset({"ended", "cut_off"})
"""The states of attempts whose record is a part of the submission."""


class Limits(msgspec.Struct, frozen=True, kw_only=True):
    """Where an episode is cut off, if the agent does not end it."""

    steps: int = 200
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

    def by_title(self) -> Mapping[str, Any]:
        """Return all values, by titles that messages can have."""
        plain = msgspec.to_builtins(self)
        options, limits = plain.pop("options"), plain.pop("limits")
        return {
            **{_TITLES.get(name, name): value for name, value in plain.items()},
            **{f"option {name}": value for name, value in options.items()},
            **{f"limit of {name}": value for name, value in limits.items()},
        }


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


# The folder itself.


class RunFolder:
    """The files of a run, which one process has at a time.

    Attempts and steps are appended and never changed; what is on disk is what counts. Steps are
    written as they are made, so that what an attempt cost is known even if it was interrupted.

    Parameters
    ----------
    path : Path
        A new folder, or one of a run with the same identity.
    episodes : collection of str
        Those of the run.
    identity : Identity
    circumstance : Circumstance

    Raises
    ------
    RunError
        If another process is running here, the folder has something else in it, some of its run is
        lost, or it has another identity.
    """

    def __init__(
        self,
        path: Path,
        episodes: Collection[str],
        identity: Identity,
        circumstance: Circumstance,
    ) -> None:
        if path.exists() and not path.is_dir():
            raise RunError(f"{path} is a file; a run needs a folder, such as runs/{path.stem}")
        self.path = path
        self._episode_ids = episodes
        self._identity = identity
        self._opened = ExitStack()
        try:
            self._opened.enter_context(made_folder(path))
            self._begin(circumstance)
        except BaseException:
            self._opened.close()
            raise

    def _begin(self, circumstance: Circumstance) -> None:
        folder = self._opened.enter_context(locked_folder(self.path))
        card = read_card(self.path)
        self._circumstances = [*(card.circumstances if card else ()), circumstance]
        self._check_files(card)
        self._episodes, self._steps = (self._append_to(name) for name in _LOGS)
        self.attempts = list(read_attempts(self.path))
        unfinished = self._unfinished_steps()
        if card:
            if self.kept:  # otherwise there is nothing that another agent would spoil
                self._check_identity(card.identity)
            self._check_lines(card)
        self.write_card()  # after the others, so that a folder that has it has those too
        os.fsync(folder)
        for steps in unfinished.values():
            self.add(_interrupted(steps))

    def _check_files(self, card: RunCard | None) -> None:
        if card is None:
            # A run that was killed as it began has left files without a line.
            made = [it for it in self.path.iterdir() if it.name not in _LOGS or it.stat().st_size]
            if any(not each.name.startswith(".") for each in made):
                raise RunError(f"{self.path} is not empty and has no {CARD}; choose a new folder")
        elif lost := [name for name in _LOGS if not self._path(name).is_file()]:
            raise RunError(
                f"{self.path} has a run whose {' and '.join(lost)} is lost, so it cannot go on; "
                "restore it, or choose a new folder"
            )

    def _check_lines(self, card: RunCard) -> None:
        """Refuse to go on if lines are lost, or are of another run: all would be paid for again."""
        if card.totals and len(self.attempts) < card.totals.attempts:
            raise RunError(
                f"{self._path(EPISODES)} has {count_text(len(self.attempts), 'attempt')}, and "
                f"{CARD} says {card.totals.attempts:,}; restore it, or choose a new folder"
            )
        if foreign := [each for each in self.kept if each not in self._episode_ids]:
            raise RunError(
                f"{self._path(EPISODES)} has {count_text(len(foreign), 'episode')} that the split "
                f"does not have, such as {first_few(foreign)}; restore it, or choose a new folder"
            )

    def _path(self, name: str) -> Path:
        return self.path / name

    def _open(self, path: Path, flags: int) -> int:
        descriptor = os.open(path, flags, 0o666)
        self._opened.callback(os.close, descriptor)
        return descriptor

    def _append_to(self, name: str) -> int:
        path = self._path(name)
        descriptor = self._open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        with path.open("r+b") as file:  # a line that was cut off is not a record
            file.truncate(sum(len(line) for line in file if line.endswith(b"\n")))
        return descriptor

    def _check_identity(self, begun: Identity) -> None:
        # As it will be read: a tuple is a list then.
        mine = msgspec.json.decode(encode(self._identity), type=Identity)
        differences = changes(begun.by_title(), mine.by_title())
        if differences:
            raise RunError(
                f"{self.path} has another run ({'; '.join(differences)}); go on as it was begun, "
                "or choose a new folder"
            )

    def _unfinished_steps(self) -> Mapping[tuple[str, int], list[Step]]:
        """Return the steps of attempts that did not end, because the run did."""
        expected = {(each.episode, each.attempt): each.steps for each in self.attempts}
        found: dict[tuple[str, int], list[Step]] = {}
        for step in read_steps(self.path):
            found.setdefault((step.episode, step.attempt), []).append(step)
        for (episode, attempt), steps in expected.items():
            has = len(found.pop((episode, attempt), ()))
            if has != steps:
                raise RunError(
                    f"{self._path(STEPS)} has {count_text(has, 'step')} of attempt {attempt} at "
                    f"{episode}, and {EPISODES} says {steps:,}; restore it, or choose a new folder"
                )
        return found

    @property
    def kept(self) -> Mapping[str, Attempt]:
        """The attempt that counts, for each episode that has one."""
        return {each.episode: each for each in self.attempts if each.state in KEPT}

    def add(self, row: Step | Attempt) -> None:
        """Append a step, or the end of an attempt; that is on disk when this returns."""
        try:
            if isinstance(row, Step):
                _write(self._steps, encode(row))
                return
            os.fsync(self._steps)
            _write(self._episodes, encode(row))
            os.fsync(self._episodes)
        except OSError as error:
            error.filename = str(self.path)  # the system knows no name of an open file
            raise
        self.attempts.append(row)

    def write_card(self, totals: Totals | None = None) -> None:
        """Write the run's card, with what came of it if it ended."""
        card = RunCard(
            schema_version=SCHEMA_VERSION,
            identity=self._identity,
            circumstances=self._circumstances,
            totals=totals,
        )
        self.write(CARD, msgspec.json.format(encode(card)) + b"\n")

    def write(self, name: str, content: bytes) -> None:
        """Write a file that appears complete or not at all."""
        with staged_file(self._path(name)) as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())

    def remove(self, name: str) -> None:
        """Remove a file that is written again in the end."""
        self._path(name).unlink(missing_ok=True)

    def _remove_blank(self) -> None:
        """Remove the files if nothing was begun, unless the folder has files of others."""
        made = {CARD, *_LOGS}
        is_blank = not self.attempts and not self._path(STEPS).stat().st_size
        if is_blank and {each.name for each in self.path.iterdir()} <= made:
            for name in made:
                self.remove(name)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, error: type[BaseException] | None, *_: object) -> None:
        if error:  # perhaps before anything was begun, as when an agent is refused
            with suppress(OSError):
                self._remove_blank()
        self._opened.close()  # leaves the folder to others


def read_card(folder: Path) -> RunCard | None:
    """Return the card of a run, by its folder; None if there is none.

    Raises
    ------
    RunError
        If it is not a card, or has another version of the schema.
    """
    path = folder / CARD
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return None
    try:
        version = msgspec.json.decode(content, type=_Version).schema_version
        if version == SCHEMA_VERSION:
            return msgspec.json.decode(content, type=RunCard)
    except msgspec.DecodeError as error:
        raise RunError(f"{path} is not the card of a run: {error}") from None
    raise RunError(
        f"{path} has version {version} of the schema, and this is version {SCHEMA_VERSION}; use "
        "the release that began the run"
    )


class _Version(msgspec.Struct):
    schema_version: int


def _interrupted(steps: list[Step]) -> Attempt:
    """Return an attempt that did not end, with what it cost."""
    return Attempt(
        episode=steps[0].episode,
        attempt=steps[0].attempt,
        state="interrupted",
        steps=len(steps),
        seconds=sum(each.seconds for each in steps),
        **asdict(total_usage(steps)),
    )


def _write(descriptor: int, content: bytes) -> None:
    """Write all of it: one call may write a part only."""
    while content:
        content = content[os.write(descriptor, content) :]
