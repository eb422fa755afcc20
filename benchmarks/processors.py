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


def family_of(process: int) -> list[int]:
    """Return a process and all running ones that it has started, or that these have."""
    children = Path(f"/proc/{process}/task").glob("*/children")
    started = [int(child) for file in children for child in file.read_text().split()]
    return [process, *(each for child in started for each in family_of(child))]


def busy_milliseconds() -> float:
    """Return the time for which the processors of the machine have been busy so far, together."""
    total = Path("/proc/stat").read_text().partition("\n")[0].split()[1:]
    user, nice, system, _, _, *interrupts = map(int, total[:7])  # without idle and waiting
    ticks = user + nice + system + sum(interrupts)
    return 1000 * ticks / os.sysconf("SC_CLK_TCK")
