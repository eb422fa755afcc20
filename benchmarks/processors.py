"""What processes have spent of the processors, as Linux counts it."""

import os
from pathlib import Path


def processor_milliseconds(*processes: int) -> float:
    """Return the user and system time of processes so far, in steps of usually 10 ms."""
    ticks = 0
    for process in processes:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        ticks += int(fields[11]) + int(fields[12])
    return 1000 * ticks / os.sysconf("SC_CLK_TCK")
