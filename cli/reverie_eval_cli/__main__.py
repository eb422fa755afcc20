"""The command as a process of its own: ``reverie-eval``, or ``python -m reverie_eval_cli``."""

import gc
import os
from signal import SIG_DFL, SIGINT, SIGTERM, default_int_handler, getsignal, signal
from typing import NoReturn


def run() -> NoReturn:
    """Run the command and exit with its status.

    The cycle collector is off, and the process leaves without dismantling its modules and arrays.
    Each would take a tenth of the time that scoring a file takes, and helps only processes that
    live longer; ``serve`` turns the collector on again.
    """
    gc.disable()
    # OpenBLAS, which numpy loads, starts a thread for each processor. Each would wait for work in a
    # busy loop first, for longer than scoring takes, also in processes that this one starts.
    os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "4")
    # Nothing has begun while modules are imported: Ctrl-C ends the process without a word.
    handler = getsignal(SIGINT)
    if handler is default_int_handler:
        signal(SIGINT, SIG_DFL)
    from reverie_eval_cli.main import main

    if handler is default_int_handler:
        signal(SIGINT, handler)
    # Python would end at once, and leave drafts and other processes behind. A cluster sends this
    # when the time is over.
    if getsignal(SIGTERM) is SIG_DFL:
        signal(SIGTERM, default_int_handler)
    os._exit(main())


if __name__ == "__main__":
    run()
