"""Work on many things, in several processes, and how far it is."""

import fcntl
import os
import signal
import sys
import typing
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar

from reverie_eval.errors import ReverieEvalError, RunError

T = TypeVar("T")
Argument = TypeVar("Argument")
Result = TypeVar("Result")

# glibc's ``M_TOP_PAD``: https://man7.org/linux/man-pages/man3/mallopt.3.html
_TOP_PAD = -2
# Bytes of freed memory that each of glibc's arenas keeps.
_BYTES_KEPT = 16 << 20


def can_start_processes() -> bool:
    """Whether the main script may run again in a process that starts afresh.

    One that does not ask for its ``__name__`` would start processes in each process, and one that
    comes from standard input cannot be read again.
    """
    script = Path(getattr(sys.modules["__main__"], "__file__", None) or "")
    if script.name == "<stdin>":
        return False
    return not script.is_file() or b"__name__" in script.read_bytes()


@contextmanager
def locked_folder(folder: Path) -> Iterator[int]:
    """Keep other processes out of a folder, and yield its descriptor.

    The lock ends with the process, also if that is killed.

    Raises
    ------
    RunError
        If another process is running in the folder.
    OSError
        If it cannot be opened.
    """
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RunError(f"{folder}: another process is running there") from None
        yield descriptor
    finally:
        os.close(descriptor)


@contextmanager
def starting_processes() -> Iterator[None]:
    """Start processes that Ctrl-C does not reach: a terminal sends it to all, and this one decides.

    It is blocked here until they have started, and stays blocked in them, from their first moment.
    """
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # otherwise the first process starts it, which ends blocking
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


def map_in_processes(
    work: Callable[[Argument], Result], arguments: Sequence[Argument], jobs: int
) -> Generator[Result]:
    """Yield the results of a function in the order of its arguments.

    Parameters
    ----------
    work : callable
        With its arguments and results, it must be possible to pickle it.
    arguments : sequence
        One for each call.
    jobs : int
        Number of processes. With one job, the work is done in this process. Closing the generator
        stops them.

    Raises
    ------
    ReverieEvalError
        If a process was killed, or none can be started.
    """
    jobs = min(jobs, len(arguments))
    if jobs <= 1:
        yield from map(work, arguments)
        return
    if not can_start_processes():
        raise ReverieEvalError(
            "several jobs start this script again in each process; put its commands into a file, "
            'below if __name__ == "__main__":'
        )
    # `multiprocessing.Pool` waits forever for a process that was killed, and `concurrent.futures`
    # cannot stop running ones.
    from multiprocessing import get_context

    from pebble import ProcessExpired, ProcessPool

    # "spawn" starts fresh processes: a forked copy of a process with threads, which a progress bar
    # has, may hang.
    context = get_context("spawn")
    with ProcessPool(jobs, initializer=keep_freed_memory, context=context) as pool:
        try:
            with starting_processes():
                results = pool.map(work, arguments)
            yield from results.result()
        except ProcessExpired as error:
            pool.stop()
            raise ReverieEvalError(
                "a process was killed while it worked, perhaps for lack of memory; try fewer --jobs"
            ) from error
        except BaseException:
            pool.stop()  # otherwise leaving the block waits for the calls that are still to be made
            raise


def keep_freed_memory() -> None:
    """Tell glibc to keep some of the memory of freed arrays for the next ones.

    Otherwise it returns that of each file's arrays to the system, and asks for it again for those
    of the next file, which takes a tenth of the processor's time.
    """
    with suppress(ImportError, AttributeError):  # Python without ctypes, or another C library
        import ctypes

        ctypes.CDLL(None).mallopt(_TOP_PAD, _BYTES_KEPT)


class Progress(typing.Protocol):
    """Wraps what is about to be worked on, one after another, and may show how far that is."""

    def __call__(self, several: Iterable[T], description: str, total: int, /) -> Iterable[T]:
        """Return them all, ``total`` of them."""


def no_progress(several: Iterable[T], description: str, total: int, /) -> Iterable[T]:  # noqa: ARG001
    """Return them all, and show nothing."""
    return several
