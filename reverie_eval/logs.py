"""The logs of a run: what an agent did in each episode, and what that cost.

A run's folder has a line for each :class:`Attempt` in ``episodes.jsonl`` and one for each
:class:`Step` in ``steps.jsonl``. :mod:`reverie_eval.runner` writes them, and others can.
"""

import errno
import math
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import chain
from operator import attrgetter
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, BinaryIO, Literal, TypeVar, get_args

import msgspec
import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import FloatArray, frozen
from reverie_eval.errors import LogError, Problem
from reverie_eval.text import count_text, first_few

__all__ = ["COSTS", "Attempt", "RunLog", "Step", "Usage", "read_attempts", "read_steps"]

CARD = "run.json"
EPISODES = "episodes.jsonl"
STEPS = "steps.jsonl"
SUBMISSION = "submission.json"

State = Literal["ended", "cut_off", "failed", "interrupted"]
"""How an attempt ended: by the agent, with an answer or a Stop; cut off by a limit, or because the
agent did what cannot be done; by an error that is not an answer; or with the whole run."""

COSTS: Mapping[str, str] = MappingProxyType(
    {
        "actions": "actions",
        "seconds": "s",
        "input_tokens": "input tokens",
        "cached_tokens": "cached tokens",
        "output_tokens": "output tokens",
        "reasoning_tokens": "reasoning tokens",
        "money": "US dollars",
    }
)
"""What an episode costs, and the unit of each. Actions are the steps of the log: a score table's
are the poses after the first."""

_TOKENS = [key for key in COSTS if key.endswith("tokens")]

Count = Annotated[int, msgspec.Meta(ge=0)]
Amount = Annotated[float, msgspec.Meta(ge=0)]
Row = TypeVar("Row", bound=msgspec.Struct)


@dataclass(frozen=True, slots=True)
class Usage:
    """What calls of a model used up; None is unknown, or that there was none."""

    input_tokens: int | None = None
    """All that were sent, cached ones included."""
    cached_tokens: int | None = None
    output_tokens: int | None = None
    """All that came back, those of reasoning included."""
    reasoning_tokens: int | None = None
    money: float | None = None
    """US dollars."""


class Step(msgspec.Struct, frozen=True, kw_only=True):
    """A line of ``steps.jsonl``: an action of an agent."""

    episode: str
    """The episode's id."""
    attempt: Count
    """Counted from 1, for each episode."""
    step: Count
    """Counted from 1, in each attempt."""
    viewpoint_id: str
    """Where the agent was when it chose the action; with the next two, and the identity of the run,
    this determines all that it could observe."""
    heading: float
    """Radians."""
    elevation: float
    """Radians."""
    action: str
    """``Go``, ``Turn``, ``Stop``, ``Answer``, ``AnswerBox`` or ``Point``; empty if the agent failed
    to choose one."""
    arguments: Any
    """The fields of the action."""
    seconds: Amount
    """How long the agent took to choose; of a batch that it chose for, an equal share."""
    input_tokens: Count | None = None
    """All that were sent to a model, cached ones included; null if there is no such number."""
    cached_tokens: Count | None = None
    """Tokens sent that the endpoint had in a cache."""
    output_tokens: Count | None = None
    """All that came back, those of reasoning included."""
    reasoning_tokens: Count | None = None
    """Tokens that came back as reasoning."""
    money: Amount | None = None
    """US dollars; null if unknown, 0 if it was free."""
    notes: Mapping[str, Any] = {}
    """Whatever else the agent logged."""


class Attempt(msgspec.Struct, frozen=True, kw_only=True):
    """A line of ``episodes.jsonl``: an attempt at an episode, the last of which is its summary."""

    episode: str
    """The episode's id."""
    attempt: Count
    """Counted from 1, for each episode."""
    state: State
    """``ended`` by the agent, with an answer or a ``Stop``; ``cut_off`` by a limit, or because the
    agent did what cannot be done; ``failed`` by another error; ``interrupted`` with the run."""
    reason: str = ""
    """Which limit it was, or which error; empty if the agent ended the episode."""
    steps: Count
    """Number of its steps."""
    seconds: Amount
    """How long the agent took to start and to choose its actions, or to fail; of a batch, an equal
    share."""
    input_tokens: Count | None = None
    """All that were sent to a model, cached ones included; null if there is no such number."""
    cached_tokens: Count | None = None
    """Tokens sent that the endpoint had in a cache."""
    output_tokens: Count | None = None
    """All that came back, those of reasoning included."""
    reasoning_tokens: Count | None = None
    """Tokens that came back as reasoning."""
    money: Amount | None = None
    """US dollars; null if a step has tokens but no price."""
    read: tuple[str, ...] = ()
    """The parts of observations that the agent read, and ``solution`` if it asked for that."""
    is_retried: bool = False
    """Whether the error is one after which the episode is tried again."""
    traceback: str = ""
    """Where the error was raised, as Python prints it."""
    record: Mapping[str, Any] | None = None
    """The episode's record in the submission; null if it has none."""


def total_usage(rows: Iterable[Step | Attempt]) -> Usage:
    """Add up what was used; what no row knows stays unknown.

    Money is unknown as soon as one row has tokens without a price: a sum without them would be too
    small.
    """
    rows = list(rows)
    totals: dict[str, Any] = {}
    for name in Usage.__dataclass_fields__:
        known = [value for row in rows if (value := getattr(row, name)) is not None]
        totals[name] = sum(known) if known else None
    has_unknown = any(
        row.money is None and (row.input_tokens, row.output_tokens) != (None, None) for row in rows
    )
    if has_unknown:
        totals["money"] = None
    return Usage(**totals)


@dataclass(frozen=True, eq=False, repr=False)
class RunLog:
    """The log of a run, by episode."""

    folder: Path
    attempts: Mapping[str, Sequence[Attempt]]
    """All attempts at each episode; those that failed cost something too."""

    @classmethod
    def read(cls, folder: str | PathLike[str]) -> Self:
        """Read the attempts of a run; its steps are read when they are looked at.

        Raises
        ------
        LogError
            If lines are invalid, or an attempt is there twice; lists all of them.
        OSError
            If there is no ``episodes.jsonl``, or it cannot be read.
        """
        problems: list[Problem] = []
        attempts: dict[str, list[Attempt]] = {}
        try:
            for each in read_attempts(folder):
                attempts.setdefault(each.episode, []).append(each)
        except LogError as error:
            problems += error.problems
        for episode, several in attempts.items():
            for number, count in Counter(each.attempt for each in several).items():
                if count > 1:
                    message = f"{count} lines of attempt {number} at {episode}; expected one"
                    problems.append(Problem("log-twice", str(Path(folder, EPISODES)), message))
        if problems:
            raise LogError(problems)
        return cls(Path(folder), attempts)

    def steps(self, episode: str) -> Sequence[Step]:
        """Return the steps of the last attempt at an episode; none without a ``steps.jsonl``.

        Raises
        ------
        LogError
            If lines of any episode are invalid; lists all of them.
        """
        offsets = self._offsets.get(episode, ())
        if not offsets:
            return ()
        decoder = msgspec.json.Decoder(Step)
        with (self.folder / STEPS).open("rb") as file:
            return [decoder.decode(_line_at(file, offset)) for offset in offsets]

    @cached_property
    def _offsets(self) -> Mapping[str, Sequence[int]]:
        """Where the steps are in the file: what agents said would take gigabytes of memory."""
        found: dict[str, tuple[int, list[int]]] = {}
        if (self.folder / STEPS).exists():
            for offset, step in _read_located(self.folder / STEPS, Step):
                attempt, offsets = found.get(step.episode, (0, []))
                if attempt != step.attempt:
                    offsets = []
                offsets.append(offset)
                found[step.episode] = step.attempt, offsets
        return {episode: offsets for episode, (_, offsets) in found.items()}

    def costs(self, episodes: Sequence[str]) -> Mapping[str, FloatArray]:
        """Return what each episode cost, all attempts together, by the keys of ``COSTS``.

        Arrays have the shape (n_episodes,), with NaN where the log does not say it.
        """
        rows = [_sum(self.attempts.get(episode, ())) for episode in episodes]
        return {key: frozen(np.array([row.get(key) for row in rows], float)) for key in COSTS}

    def stop(self, episode: str) -> str | None:
        """Return the viewpoint where an episode ended; None if the log does not say it."""
        attempts = self.attempts.get(episode)
        record = max(attempts, key=attrgetter("attempt")).record if attempts else None
        last = (record or {}).get("trajectory")
        while isinstance(last, list) and last and not isinstance(last[0], str):
            last = last[-1]
        viewpoints = [each for each in last or () if isinstance(each, str)]  # of a pose or a hop
        return viewpoints[-1] if viewpoints else None

    def notes(self, stops: Mapping[str, str], whole: Collection[str]) -> Iterator[str]:
        """Yield what a run cost and read, and where the log and the submission differ.

        ``stops`` are the viewpoints where the scored episodes ended, by episode, and ``whole`` are
        the episodes of the whole split.
        """
        episodes = list(stops)
        yield costs_text(self.costs(episodes))
        attempts = chain.from_iterable(self.attempts.values())
        if read := {part for each in attempts for part in each.read}:
            yield f"the agent read {read_text(read)}"
        if missing := [each for each in episodes if each not in self.attempts]:
            count = count_text(len(missing), "episode")
            yield f"the run's log has no attempt at {count}, such as {first_few(missing)}"
        if others := [each for each in self.attempts if each not in whole]:
            count = count_text(len(others), "episode")
            yield f"the run's log has {count} of another split, such as {first_few(others)}"
        if elsewhere := [
            episode for episode, stop in stops.items() if self.stop(episode) not in (None, stop)
        ]:
            count = count_text(len(elsewhere), "episode")
            yield (
                f"the run's log has another stop for {count}, such as {first_few(elsewhere)}: it "
                "may be the log of another run"
            )


def mean_costs(costs: Mapping[str, FloatArray]) -> Mapping[str, float | None]:
    """Return the mean of each cost over episodes; None if it is unknown for one of them.

    A mean over the others would be that of other episodes.
    """
    means = {key: float(values.mean()) for key, values in costs.items()}
    return {key: None if np.isnan(mean) else mean for key, mean in means.items()}


def cost_number(value: float) -> str:
    """Return an amount with three digits or more, or a whole number.

    >>> cost_number(0.0017846), cost_number(12_345.6), cost_number(7)
    ('0.00178', '12,346', '7')
    """
    is_whole = float(value).is_integer()
    decimals = 0 if is_whole else max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:,.{decimals}f}"


def cost_text(key: str, value: float) -> str:
    """Return a cost in its unit: ``12.5 actions``."""
    return f"{cost_number(value)} {COSTS[key]}"


def cost_name(key: str) -> str:
    """Return what a cost is called without a number: ``input tokens``, ``money``."""
    return key.replace("_", " ")


def costs_text(costs: Mapping[str, FloatArray]) -> str:
    """Say what an episode cost on average, and what of it is unknown."""
    means = mean_costs(costs)
    known = [cost_text(key, mean) for key, mean in means.items() if mean is not None]
    unknown: dict[str, None] = {}
    has_tokens = not all(np.isnan(costs[key]).all() for key in _TOKENS)
    for key, values in costs.items():
        if missing := int(np.isnan(values).sum()):
            name = cost_name(key) if has_tokens or key not in _TOKENS else "tokens"
            some = f" of {count_text(missing, 'episode')}" if missing < len(values) else ""
            unknown[f"{name}{some}"] = None
    parts = [", ".join(known), f"unknown: {', '.join(unknown)}" if unknown else ""]
    return f"cost per episode: {'; '.join(filter(None, parts))}"


def read_text(parts: Collection[str]) -> str:
    """List the parts of observations that were read; say so if some are labels of annotators."""
    listed = ", ".join(sorted(parts))
    if {"names", "boxes"}.isdisjoint(parts):
        return listed
    return f"{listed}; names and boxes are annotators' labels: perfect perception"


def _sum(attempts: Sequence[Attempt]) -> Mapping[str, float | None]:
    if not attempts:
        return {}
    return {
        "actions": sum(each.steps for each in attempts),
        "seconds": sum(each.seconds for each in attempts),
        **asdict(total_usage(attempts)),
    }


def find_run(submission: str) -> Path | None:
    """Return the folder of the run that wrote a submission, if its log is beside it."""
    file = Path(submission)
    if is_run(file):
        return file
    has_log = file.name == SUBMISSION and file.with_name(EPISODES).is_file()
    return file.parent if has_log else None


def is_run(folder: str | PathLike[str]) -> bool:
    """Whether this is the folder of a run, which stands for its submission."""
    # Both, because a result file may be called run.json.
    return Path(folder, CARD).is_file() and Path(folder, EPISODES).is_file()


def submission_in(folder: str | PathLike[str]) -> Path:
    """Return the submission in the folder of a run.

    Raises
    ------
    FileNotFoundError
        If the run has none yet; says what is missing, and how to go on.
    """
    submission = Path(folder, SUBMISSION)
    if submission.exists():
        return submission
    states: dict[str, Attempt] = {}
    with suppress(FileNotFoundError, LogError):  # which the command that goes on will say
        states |= {each.episode: each for each in read_attempts(folder)}
    failed = [each for each in states.values() if each.state == "failed"]
    done = count_text(sum(each.record is not None for each in states.values()), "episode")
    why = f", and {len(failed):,} failed, such as {failed[0].reason}" if failed else ""
    raise FileNotFoundError(
        errno.ENOENT,
        f"this run has no submission yet: {done} ended{why}; the `reverie-eval run` that began it "
        "goes on, and with --fill-missing writes a stop at the start for the others",
        str(folder),
    )


def read_attempts(folder: str | PathLike[str]) -> Iterator[Attempt]:
    """Yield all attempts of a run, in the order in which they ended; see :func:`read_lines`."""
    return read_lines(Path(folder, EPISODES), Attempt)


def read_steps(folder: str | PathLike[str]) -> Iterator[Step]:
    """Yield all steps of a run, in the order in which they were made; see :func:`read_lines`."""
    return read_lines(Path(folder, STEPS), Step)


def read_lines(path: Path, kind: type[Row]) -> Iterator[Row]:
    """Yield the records of a file of JSON lines.

    A last line that was cut off is left out: a run is writing it, or was killed as it did.

    Raises
    ------
    LogError
        At the end, if there are other lines; lists all of them.
    OSError
        If the file cannot be read.
    """
    return (row for _, row in _read_located(path, kind))


def _read_located(path: Path, kind: type[Row]) -> Iterator[tuple[int, Row]]:
    """Yield the records with the positions of their lines in the file, in bytes."""
    decoder = msgspec.json.Decoder(kind)
    problems = []
    offset = 0
    with path.open("rb") as file:
        for number, line in enumerate(file, 1):
            try:
                yield offset, decoder.decode(line)
            except msgspec.DecodeError as error:
                if line.endswith(b"\n"):
                    problems.append(_problem(path, number, error))
            offset += len(line)
    if problems:
        raise LogError(problems)


def _line_at(file: BinaryIO, offset: int) -> bytes:
    file.seek(offset)
    return file.readline()


def _problem(path: Path, number: int, error: msgspec.DecodeError) -> Problem:
    """Say what is wrong with a line, and in which field."""
    message, _, field = str(error).replace("`", "").partition(" - at $.")
    if message.startswith("Invalid enum"):
        message += f"; expected {', '.join(get_args(State))}"
    where = f"{path}, line {number}{field and f', {field}'}"
    return Problem("log-line", where, message, (number,))
