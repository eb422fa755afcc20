"""The folder of a run: what is appended as episodes are run, and how it is read to go on."""

import fcntl
import os
from collections.abc import Collection, Mapping
from dataclasses import asdict
from pathlib import Path

import msgspec
from typing_extensions import Self

from reverie_eval.errors import RunError
from reverie_eval.files import staged_file
from reverie_eval.logs import (
    CARD,
    EPISODES,
    STEPS,
    Attempt,
    Step,
    read_attempts,
    read_steps,
    total_usage,
)
from reverie_eval.runner._records import (
    KEPT,
    SCHEMA_VERSION,
    Circumstance,
    Identity,
    RunCard,
    Totals,
    encode,
)
from reverie_eval.text import count_text, first_few

_LOGS = (EPISODES, STEPS)


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
        path.mkdir(parents=True, exist_ok=True)
        self._open = [os.open(path, os.O_RDONLY)]
        try:
            self._begin(circumstance)
        except BaseException:
            self.close()
            raise

    def _begin(self, circumstance: Circumstance) -> None:
        (folder,) = self._open
        try:
            fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RunError(f"{self.path}: another process is running there") from None
        card = read_card(self.path)
        self._circumstances = [*(card.circumstances if card else ()), circumstance]
        self._check_files(card)
        self._episodes, self._steps = (self._append_to(name) for name in (EPISODES, STEPS))
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

    def _append_to(self, name: str) -> int:
        path = self._path(name)
        self._open.append(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666))
        with path.open("r+b") as file:  # a line that was cut off is not a record
            file.truncate(sum(len(line) for line in file if line.endswith(b"\n")))
        return self._open[-1]

    def _check_identity(self, begun: Identity) -> None:
        # As it will be read: a tuple is a list then.
        mine = msgspec.json.decode(encode(self._identity), type=Identity)
        differences = list(mine.differences(begun))
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

    def close(self) -> None:
        """Leave the folder to others."""
        while self._open:
            os.close(self._open.pop())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


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
