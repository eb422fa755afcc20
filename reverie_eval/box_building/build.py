"""Build the boxes of many scans, and write them as the published dataset does.

The folder has its files when all are written. If building fails or is interrupted, it has none.
"""

import os
import signal
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, suppress
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Thread
from typing import NamedTuple, TypeAlias, TypeVar

import msgspec
import numpy as np

from reverie_eval.appearing import appearing
from reverie_eval.box_building.house import read_house
from reverie_eval.box_building.rules import Rules
from reverie_eval.box_building.scans import Scan, read_poses
from reverie_eval.box_building.sightings import annotation, listable, look_around
from reverie_eval.errors import DatasetError, Problem, ReverieEvalError

T = TypeVar("T")


class Built(NamedTuple):
    """How much was built."""

    viewpoints: int
    listed: int
    """Objects at viewpoints, visible or not."""
    boxes: int


Outcome: TypeAlias = Built | DatasetError
"""What became of a scan."""
Track: TypeAlias = Callable[[Iterable[Outcome], int], Iterable[Outcome]]
"""Wraps so many outcomes, as they come: where progress is shown."""


def untracked(outcomes: Iterable[Outcome], total: int) -> Iterable[Outcome]:  # noqa: ARG001
    """Show no progress."""
    return outcomes


def build_boxes(
    scans: Sequence[Scan], folder: Path, rules: Rules, *, jobs: int = 1, track: Track = untracked
) -> Built:
    """Build the boxes of scans into a folder of ``{scan}_{viewpoint}.json`` files.

    Every included viewpoint gets a file, also one where nothing is listed. The files are the same
    whatever the number of processes.

    Parameters
    ----------
    scans : sequence of Scan
        As :func:`~.scans.find_scans` finds them.
    folder : Path
        Where to write: a folder that is not there yet, or empty.
    rules : Rules
        What is listed, and what is hidden.
    jobs : int
        How many processes share the work.
    track : callable, optional
        Shows progress; called with the results to come and their number.

    Raises
    ------
    DatasetError
        Listing everything that is wrong with the scans' files; nothing is written then.
    ReverieEvalError
        If the folder holds something, or a process of the work was ended from outside.
    """
    _demand_empty(folder)
    with appearing(folder) as staging:
        work = partial(_build_scan, folder=staging, rules=rules)
        with closing(_outcomes(work, scans, min(jobs, len(scans)))) as coming:
            outcomes = list(track(coming, len(scans)))
        problems = [
            replace(problem, position=(place, *problem.position))
            for place, outcome in enumerate(outcomes)
            for problem in _problems(outcome)
        ]
        if problems:
            raise DatasetError(problems)
    built = [outcome for outcome in outcomes if isinstance(outcome, Built)]
    return Built(*map(sum, zip(*built, strict=True)))


def _demand_empty(folder: Path) -> None:
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ReverieEvalError(f"{folder} is not an empty folder; name another, or remove it first")


def _outcomes(
    work: Callable[[Scan], Outcome], scans: Sequence[Scan], jobs: int
) -> Generator[Outcome]:
    if jobs <= 1:
        yield from map(work, scans)
        return
    # Fresh processes: a copy of one that runs threads, like a progress bar's, may hang.
    context = get_context("spawn")
    their_end, our_end = context.Pipe(duplex=False)
    with (
        ProcessPoolExecutor(jobs, context, initializer=_hang_on, initargs=(their_end,)) as pool,
        their_end,
        our_end,  # closed first: the pool would wait for scans that nobody wants any more
    ):
        try:
            yield from pool.map(work, scans)
        except BrokenProcessPool as error:
            raise ReverieEvalError(
                "a process that was building boxes has been ended from outside, perhaps for want "
                "of memory; try fewer --jobs"
            ) from error


def _hang_on(parent: Connection) -> None:
    """Leave Ctrl-C to the parent, and end as soon as it lets go of the other end or is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: Connection) -> None:
    with suppress(EOFError):
        parent.recv_bytes()
    os._exit(1)


def _build_scan(scan: Scan, *, folder: Path, rules: Rules) -> Outcome:
    """Build and write one scan; an error is returned, to be raised with those of other scans."""
    house, viewpoints = _attempt(read_house, scan.house), _attempt(read_poses, scan.connectivity)
    if isinstance(house, DatasetError) or isinstance(viewpoints, DatasetError):
        return DatasetError([*_problems(house), *_problems(viewpoints)])
    house = listable(house, rules)
    listed = boxes = 0
    for viewpoint in viewpoints:
        sightings = look_around(house, np.array(viewpoint.position), rules)
        content = {viewpoint.image_id: annotation(house, sightings)}
        file = folder / f"{scan.scan_id}_{viewpoint.image_id}.json"
        file.write_bytes(msgspec.json.encode(content) + b"\n")
        listed += len(sightings)
        boxes += sum(map(len, sightings.values()))
    return Built(len(viewpoints), listed, boxes)


def _attempt(read: Callable[[Path], T], path: Path) -> T | DatasetError:
    try:
        return read(path)
    except DatasetError as error:
        return error
    except OSError as error:
        return DatasetError([Problem("unreadable-file", str(path), f"{error.strerror}")])


def _problems(outcome: object) -> tuple[Problem, ...]:
    return outcome.problems if isinstance(outcome, DatasetError) else ()
