"""The splits with their ground truth in memory, and the processes that score."""

from multiprocessing import forkserver

from reverie_eval.processes import starting_processes


def begin_importing() -> None:
    """Start the process of which all that score are copies, unless it runs.

    It imports what they need while this one goes on.
    """
    forkserver.set_forkserver_preload([f"{__name__}.processes"])
    with starting_processes():
        forkserver.ensure_running()
