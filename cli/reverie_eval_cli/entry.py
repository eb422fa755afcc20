"""The installed command as a process of its own.

Looking for cycles, and taking modules and arrays apart before the system does, would come to a
tenth of the time that scoring a file takes, and pays only in processes that live longer.
"""

import gc
import os
from typing import NoReturn


def run() -> NoReturn:
    """Run the command and leave the process with its exit status."""
    gc.disable()
    from reverie_eval_cli.main import main

    os._exit(main())
