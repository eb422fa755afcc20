"""What a value is, whether it came from JSON or from Python with its numpy types."""

import math
from collections.abc import Sequence
from numbers import Integral, Real
from typing import Any, TypeGuard

_NUMBERS = (float, int, Real)
"""Common types first: asking an abstract class takes ten times as long."""


def is_list(value: Any) -> TypeGuard[Sequence[Any]]:
    """Whether this is what JSON writes as a list."""
    return isinstance(value, list | tuple)


def is_number(value: Any) -> TypeGuard[float]:
    """Whether this is a number; true and false are none."""
    return isinstance(value, _NUMBERS) and not isinstance(value, bool)


def is_whole(value: Any) -> TypeGuard[int]:
    """Whether this is a number of a whole type; 3.0 is none."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def is_finite(number: float) -> bool:
    """Whether a number is one that a float can hold, and neither infinite nor NaN."""
    try:
        return math.isfinite(number)
    except OverflowError:  # a whole number beyond the range of floats
        return False
