"""Values that writers did not write as JSON has them: tensors, lists of one, line ends.

Such a value tells what was meant, whatever field it is in, but no published evaluator reads it.
"""

import json
import re
from typing import Any

from reverie_eval.submissions import _problems as problems
from reverie_eval.submissions._document import is_list, is_number
from reverie_eval.submissions._problems import Fault

NUMBER_AS_TEXT = re.compile(r"\s*-?\d{1,12}(\.\d{0,20})?(e[+-]?\d{1,2})?\s*")
"""A number written as text. Viewpoint ids are 32 hexadecimal digits."""

# What `str` and `repr` give for the arrays and numbers of PyTorch, TensorFlow, JAX and numpy:
# "tensor([3], device='cuda:0')", "<tf.Tensor: shape=(), dtype=int64, numpy=3>", "np.float64(0.5)".
# They take time in proportion to the text, whatever it is.
_TENSOR = re.compile(
    r"(?:Parameter containing:\s)?(?:(?:torch|tf|jnp|np|numpy)\.)?"
    r"(?:[Tt]ensor|[Aa]rray|DeviceArray|u?int\d+|float\d+|str_)"
    r"\((?P<value>.*?)(?:,\s*[a-z_]+=.*)?\)",
    re.DOTALL,
)
_TENSORFLOWS = re.compile(r"<tf\.(?:Tensor|Variable)[ :].*?\bnumpy=(?P<value>.*)>", re.DOTALL)
_QUOTED = re.compile(r"b?(?P<quote>['\"])(?P<value>.*)(?P=quote)", re.DOTALL)
"""A text as Python prints it, or bytes."""
_POINT_WITHOUT_DIGITS = re.compile(r"(?<=\d)\.(?!\d)")
_BETWEEN_NUMBERS = re.compile(r"(?<=[\d\]])\s+(?=[-\d\[])")
_TO_JSON = str.maketrans("'()", '"[]')
_MOST_LEVELS = 32


def unwrap(value: Any) -> tuple[Any, Fault | None]:
    r"""Return the value that was meant, and the mistake with which it is written, if any.

    >>> unwrap([["402\n"]])[0], unwrap("tensor([0.5], device='cuda:0')")[0], unwrap(7)[0]
    ('402', 0.5, 7)
    """
    fault: Fault | None = None
    for _ in range(_MOST_LEVELS):
        if is_list(value) and len(value) == 1:
            (value,), found = value, problems.LISTED_VALUES
        elif problems.size_of_array(value) == 1:
            value, found = value.tolist(), problems.ARRAYS_OF_ONE
        elif not isinstance(value, str):
            break
        elif (printed := read_printed(value)) is not None:
            value, found = printed, problems.PRINTED_VALUES
        elif (stripped := value.strip()) != value:
            value, found = stripped, problems.PADDED_VALUES
        else:
            break
        fault = fault or found
    return value, fault


def unwrap_number(value: Any) -> tuple[Any, Fault | None]:
    """Return the number that was meant, as :func:`unwrap` does; also from a number as text."""
    if isinstance(value, str) and NUMBER_AS_TEXT.fullmatch(value):
        return float(value), problems.NUMBERS_AS_TEXT
    meant, fault = unwrap(value)
    is_text = isinstance(meant, str) and NUMBER_AS_TEXT.fullmatch(meant)
    return (float(meant), fault or problems.NUMBERS_AS_TEXT) if is_text else (meant, fault)


def unwrap_numbers(value: Any) -> tuple[Any, Fault | None]:
    """Return the list of numbers that was meant, and the first mistake in it."""
    meant, fault = unwrap(value)
    if not is_list(meant):
        return meant, fault
    numbers = [(each, None) if is_number(each) else unwrap_number(each) for each in meant]
    first = next((found for _, found in numbers if found is not None), None)
    return [number for number, _ in numbers], fault or first


def is_number_as_text(value: Any) -> bool:
    """Whether a text is a number, also one in a printed tensor; a viewpoint id is neither."""
    if not isinstance(value, str):
        return False
    return NUMBER_AS_TEXT.fullmatch(value) is not None or is_number(unwrap(value)[0])


def read_printed(text: str) -> Any:
    """Return what a printed tensor, array, list or byte string holds; None for other text."""
    text = text.strip()
    if not text.endswith((")", "]", ">", "'", '"')):
        return None  # nearly always
    if match := _QUOTED.fullmatch(text):
        return match["value"]
    match = _TENSORFLOWS.fullmatch(text) or _TENSOR.fullmatch(text)
    if match:
        text = match["value"]
        inner = read_printed(text)
        return _read_literal(text) if inner is None else inner
    return _read_literal(text) if text.startswith(("[", "(")) else None


def _read_literal(text: str) -> Any:
    """Return the number, the text or the list that Python or numpy prints so."""
    text = _POINT_WITHOUT_DIGITS.sub(".0", text.translate(_TO_JSON))
    for each in (text, _BETWEEN_NUMBERS.sub(", ", text)):
        try:
            value = json.loads(each)
        except (ValueError, RecursionError):
            continue
        return value if isinstance(value, str | list) or is_number(value) else None
    return None
