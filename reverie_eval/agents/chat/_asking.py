"""Asking a model, so that no reply is paid for twice and a busy endpoint is tried again.

Each reply that was paid for is on disk before it is used. What replies cost is counted by a table
of prices that the user gives.
"""

import fcntl
import hashlib
import json
import logging
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import date
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias
from weakref import finalize

import msgspec
from typing_extensions import Self

from reverie_eval.agents.chat._endpoint import Endpoint, Reply
from reverie_eval.agents.chat.errors import BusyError, CostLimitError, EndpointError
from reverie_eval.errors import ReverieEvalError, naming_missing_parts
from reverie_eval.files import read_toml
from reverie_eval.logs import Usage, read_steps
from reverie_eval.text import first_few

ATTEMPTS = 6
"""With the pauses between them, half a minute, unless the endpoint says how long to wait."""
FIRST_PAUSE = 1.0
"""Seconds before the second attempt, doubled before each further one."""
REPLIES = "replies.jsonl"
"""The name of the file of replies."""

Message: TypeAlias = Mapping[str, Any]
OnPaid: TypeAlias = Callable[[Reply], None]
"""Called with each reply that was paid for and is not in the log of steps."""

_CLASSES = ("input", "cached", "output")
# Prices are those of a million tokens.
_UNIT = 1e-6
# Of a key: 128 bits, which no two questions share by chance.
_DIGITS = 32
_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True)
class Prices:
    """What tokens of a model cost, in US dollars for a million of them."""

    date: str
    """The day on which these were the prices."""
    input: float
    """Tokens that are sent, and not cached."""
    cached: float
    """Tokens that are sent, and that the endpoint had in its cache."""
    output: float
    """Tokens that come back, those of reasoning included."""

    @classmethod
    def read(cls, file: Path, model: str) -> Self:
        """Read the prices of a model.

        Raises
        ------
        ReverieEvalError
            If the file is not such a table, or has no prices of the model.
        """
        table = read_toml(file)
        day, row = table.pop("date", None), table.get(model)
        if not isinstance(day, date):
            raise ReverieEvalError(f"{file} has no date; add the day of the prices: 2026-11-26")
        if not isinstance(row, dict):
            listed = f", but for {first_few(table)}" if table else ""
            raise ReverieEvalError(f"{file} has no prices for {model!r}{listed}")
        wrong = [name for name in _CLASSES if not _is_price(row.get(name))]
        if wrong:
            raise ReverieEvalError(
                f"{file}, {model!r}: {', '.join(wrong)} should be US dollars for a million tokens, "
                "0 if they are free"
            )
        return cls(str(day), *(float(row[name]) for name in _CLASSES))

    def cost(self, usage: Usage) -> float | None:
        """Return US dollars; None if the number of tokens is unknown, unless all are free."""
        sent, back = usage.input_tokens, usage.output_tokens
        if sent is None or back is None:
            return None if self.input or self.cached or self.output else 0.0
        cached = usage.cached_tokens or 0
        each = (sent - cached) * self.input + cached * self.cached + back * self.output
        return each * _UNIT


@dataclass(frozen=True)
class Budget:
    """What may be paid for replies.

    Parameters
    ----------
    prices : Prices, optional
    most : float, optional
        US dollars.

    Raises
    ------
    ReverieEvalError
        If there is a limit, and there are no prices.
    """

    prices: Prices | None
    most: float | None

    def __post_init__(self) -> None:
        if self.most is not None and self.prices is None:
            raise ReverieEvalError(
                "a limit of the cost needs prices: give a file of them (--prices)"
            )

    def cost(self, usage: Usage) -> float | None:
        """Return what a reply cost; None if that is unknown."""
        return None if self.prices is None else self.prices.cost(usage)

    def check(self, paid: float | None) -> None:
        """Raise CostLimitError if another reply may not be paid for."""
        if self.most is not None and paid is None:
            raise CostLimitError("the cost of earlier replies is unknown, and there is a limit")
        if self.most is not None and paid is not None and paid >= self.most:
            raise CostLimitError(
                f"the limit of ${self.most:g} is reached; the same command goes on with a "
                "higher one"
            )


def _is_price(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value < 1e9


class Replies:
    """The replies of a model on file in a folder, which several processes may use at once.

    Parameters
    ----------
    folder : Path
        It may have replies of other models, too.
    asked : str
        The model, as it is asked for.
    cost_of : callable
        Returns what a reply cost in US dollars, or None if that is unknown.

    Raises
    ------
    ReverieEvalError
        If a line of the file is not a reply.
    """

    def __init__(self, folder: Path, asked: str, cost_of: Callable[[Usage], float | None]) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._path = folder / REPLIES
        self._asked = asked
        self._cost_of = cost_of
        self._file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
        finalize(self, os.close, self._file)
        self._spans: dict[str, tuple[int, int]] = {}
        self._read_to = 0
        self._begun_at = os.fstat(self._file).st_size
        self.model = ""
        """The model that replied first, as the endpoint calls it; others' replies are not used."""
        self.cost: float | None = 0.0
        """US dollars that all replies cost together; None if that is unknown."""

    def find(self, key: str) -> Reply | None:
        """Return the reply with a key, whichever process wrote it; None if nobody has."""
        if key not in self._spans:
            self._read_on()
        if key not in self._spans:
            return None
        begin, size = self._spans[key]
        return _DECODER.decode(os.pread(self._file, size, begin))

    def is_lost(self, key: str) -> bool:
        """Whether a run in this folder was killed after it paid for a reply, before it logged it.

        It says so once.
        """
        begin, _ = self._spans[key]
        is_lost = begin < self._begun_at and self._logged is not None and key not in self._logged
        if is_lost and self._logged is not None:
            self._logged.add(key)
        return is_lost

    @cached_property
    def _logged(self) -> set[str] | None:
        """The keys of the replies that steps of a run have; None if the folder is not a run's."""
        try:
            return {
                key for step in read_steps(self._folder) for key in step.notes.get("replies", ())
            }
        except FileNotFoundError:
            return None

    def add(self, reply: Reply) -> None:
        """Append a reply; it is on disk when this returns."""
        line = msgspec.json.encode(reply) + b"\n"
        with self._locked():
            # Somebody who was killed while writing leaves a part of a line.
            os.ftruncate(self._file, self._end_of_lines())
            while line:
                line = line[os.write(self._file, line) :]
            os.fsync(self._file)

    def _read_on(self) -> None:
        """Read the lines that were appended since the last time."""
        with self._locked():
            content = os.pread(self._file, os.fstat(self._file).st_size, self._read_to)
        for line in content.splitlines(keepends=True):
            if not line.endswith(b"\n"):
                return
            try:
                reply = _DECODER.decode(line)
            except msgspec.DecodeError as error:
                where = f"{self._path}, byte {self._read_to:,}"
                raise ReverieEvalError(f"{where}: not a reply of a model: {error}") from None
            if reply.asked == self._asked:
                self._take(reply, self._read_to, len(line))
            self._read_to += len(line)

    def _take(self, reply: Reply, begin: int, size: int) -> None:
        self.model = self.model or reply.model
        if reply.key and reply.model == self.model:
            self._spans.setdefault(reply.key, (begin, size))
        cost = self._cost_of(reply.usage)
        self.cost = None if self.cost is None or cost is None else self.cost + cost

    def _end_of_lines(self) -> int:
        """Return the number of bytes up to the end of the last complete line."""
        size = os.fstat(self._file).st_size
        tail = os.pread(self._file, size - self._read_to, self._read_to)
        return self._read_to + tail.rfind(b"\n") + 1

    @contextmanager
    def _locked(self) -> Iterator[None]:
        fcntl.flock(self._file, fcntl.LOCK_EX)
        try:
            yield
        finally:
            fcntl.flock(self._file, fcntl.LOCK_UN)


_DECODER = msgspec.json.Decoder(Reply)


class Asker:
    """Asks one model at one endpoint.

    Parameters
    ----------
    endpoint : Endpoint
    model : str
        The model, as it is asked for.
    settings : mapping
        Further fields of each request, such as the temperature.
    folder : Path
        Where replies are kept.
    budget : Budget
        For all replies of the model in the folder.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        model: str,
        settings: Mapping[str, Any],
        folder: Path,
        budget: Budget,
    ) -> None:
        with naming_missing_parts():
            import tenacity  # noqa: F401
        self._endpoint = endpoint
        self._model = model
        self._settings = settings
        self._budget = budget
        self._replies = Replies(folder, model, budget.cost)

    def ask(
        self,
        messages: Sequence[Message],
        response_format: Mapping[str, Any],
        seed: int,
        on_paid: OnPaid,
    ) -> Reply:
        """Return the reply to some messages: that on file, or else the endpoint's.

        Parameters
        ----------
        messages : sequence of Message
        response_format : mapping
            The form of the reply, for endpoints that take it.
        seed : int
            Tells repeated questions from each other. It is not sent.
        on_paid : callable
            Called with each reply that is to be logged, also if it cannot be used.

        Raises
        ------
        EndpointError
            If the endpoint refuses or stays busy, or the money is used up.
        RefusalError, LongPromptError
            If the endpoint says that it will not or cannot reply.
        """
        from tenacity import stop_after_attempt

        from reverie_eval.client.sending import retrying

        content = [self._model, self._settings, messages, seed]
        key = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:_DIGITS]
        if reply := self._replies.find(key):
            if self._replies.is_lost(key):
                on_paid(reply)
            return reply
        attempts = retrying(BusyError, stop_after_attempt(ATTEMPTS), FIRST_PAUSE, _announce)
        body = {"model": self._model, **self._settings, "messages": messages}
        return attempts(self._receive, key, body, response_format, on_paid)

    def _receive(
        self,
        key: str,
        body: Mapping[str, Any],
        response_format: Mapping[str, Any],
        on_paid: OnPaid,
    ) -> Reply:
        self._budget.check(self._replies.cost)
        received = self._endpoint.ask(body, response_format)
        is_same = received.model == (self._replies.model or received.model)
        is_empty = not (received.text or received.refusal) and received.end in {"", "stop"}
        reply = replace(
            received,
            key=key if is_same and not is_empty else "",
            usage=replace(received.usage, money=self._budget.cost(received.usage)),
        )
        self._replies.add(reply)
        on_paid(reply)
        if not is_same:
            raise EndpointError(
                f"the model that replies is {reply.model!r} now, and was {self._replies.model!r}; "
                "for another model, begin a run in a new folder"
            )
        if self._budget.prices and reply.usage.money is None:
            raise EndpointError(
                "the endpoint does not say how many tokens it used, so the cost is unknown; leave "
                "prices out"
            )
        if is_empty:
            raise BusyError("the endpoint sent an empty reply")
        return reply


def _announce(reason: Exception, seconds: float) -> None:
    _LOGGER.warning("%s; asking again in %g s", reason, seconds)
