"""The file of all replies that were paid for: each is on disk before it is used."""

import fcntl
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from weakref import finalize

import msgspec

from reverie_eval.errors import ReverieEvalError
from reverie_eval.logs import Usage, read_steps

REPLIES = "replies.jsonl"
"""The name of the file in its folder."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """A line of the file."""

    key: str = ""
    """A digest of model, settings, messages and seed; empty if there is nothing to use again."""
    asked: str
    """The model that was asked for."""
    model: str
    """The model that replied, as the endpoint calls it."""
    text: str
    refusal: str
    """Why the model refused; empty if it did not."""
    end: str
    """Why it ended: ``stop``, ``length`` and so on."""
    usage: Usage
    received: str
    """ISO 8601, in UTC."""


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
