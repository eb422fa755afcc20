"""Print measurements with their limits."""

from collections.abc import Sequence

Figure = tuple[str, float, float]
"""What was measured, its value, and the largest value allowed."""


def judge(figures: Sequence[Figure]) -> int:
    """Print measurements with their limits; return 1 if one is over its limit, else 0."""
    width = max(len(name) for name, _, _ in figures)
    for name, figure, bar in figures:
        verdict = "ok" if figure <= bar else "OVER"
        print(f"{name:{width}} {figure:7.2f}   at most {bar:5.1f}   {verdict}")
    return int(any(figure > bar for _, figure, bar in figures))
