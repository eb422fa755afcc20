"""Messages for invalid values: one for each kind of error that pydantic reports.

The API, forms, the query parameters of pages and the options of commands use the same ones.
Pydantic's own messages are for programmers.
"""

from collections.abc import Mapping
from typing import Any

from reverie_eval.schemas.report import ProblemReport

_LINK = "must be a link that begins with https://"
_WHOLE_NUMBER = "must be a whole number"
_NUMBER = "must be a number"
_DATE = "must be a date, such as 2027-06-01"
_INSTANT = "must be a time with its time zone, such as 2027-06-01T12:00:00Z"
_YES_OR_NO = "must be true or false"
_OBJECT = "must be an object"
_LIST = "must be a list"

_SENTENCES: Mapping[str, str] = {
    "missing": "required but missing",
    "extra_forbidden": "unknown field; remove it",
    "value_error": "{error}",
    "string_type": "must be text",
    "string_unicode": "must be text",
    "string_pattern_mismatch": "must match the pattern {pattern}",
    "string_too_short": "must have {min_length:,} or more characters",
    "string_too_long": "must have at most {max_length:,} characters",
    "too_short": "must have {min_length:,} or more entries",
    "too_long": "must have at most {max_length:,} entries",
    "url_type": _LINK,
    "url_parsing": _LINK,
    "url_scheme": _LINK,
    "url_too_long": "must have at most {max_length:,} characters",
    "literal_error": "must be {expected}",
    "bool_type": _YES_OR_NO,
    "bool_parsing": _YES_OR_NO,
    "int_type": _WHOLE_NUMBER,
    "int_parsing": _WHOLE_NUMBER,
    "int_parsing_size": "the number is too large",
    "int_from_float": _WHOLE_NUMBER,
    "float_type": _NUMBER,
    "float_parsing": _NUMBER,
    "finite_number": _NUMBER,
    "greater_than_equal": "must be {ge:,} or more",
    "greater_than": "must be more than {gt:,}",
    "less_than": "must be less than {lt:,}",
    "less_than_equal": "must be {le:,} or less",
    "date_type": _DATE,
    "date_parsing": _DATE,
    "date_from_datetime_parsing": _DATE,
    "date_from_datetime_inexact": _DATE,
    "datetime_type": _INSTANT,
    "datetime_parsing": _INSTANT,
    "datetime_from_date_parsing": _INSTANT,
    "datetime_object_invalid": _INSTANT,
    "timezone_aware": _INSTANT,
    "dict_type": _OBJECT,
    "model_type": _OBJECT,
    "model_attributes_type": _OBJECT,
    "list_type": _LIST,
    "tuple_type": _LIST,
    "path_type": "must be a path",
    "json_invalid": "invalid JSON from here",
}
"""By pydantic's error type; the braces take values from the error's context."""

_CARRIERS = frozenset({"body", "query", "path", "header", "cookie"})
"""Parts of a request, which are not part of a field's name."""


def wrong_value(detail: Mapping[str, Any]) -> ProblemReport:
    """Return one of pydantic's errors as a problem, located by the name of the field."""
    loc = [str(part) for part in detail["loc"]]
    where = ".".join(loc[1:] if loc and loc[0] in _CARRIERS else loc)
    if detail["type"] == "json_invalid":  # located by a bare number
        where = f"character {where}"
    sentence = _SENTENCES.get(detail["type"])
    message = sentence.format_map(detail.get("ctx", {})) if sentence else str(detail["msg"])
    return wrong_field(where, message)


def unreadable_json(error: RecursionError | ValueError) -> ProblemReport:
    """Return why a body cannot be read as JSON, and from which byte on."""
    if isinstance(error, UnicodeDecodeError):
        return wrong_field(f"byte {error.start}", "invalid UTF-8 from here")
    if isinstance(error, RecursionError):
        return wrong_field("", "nested too deeply")
    return wrong_field("", "contains a number with too many digits")


def wrong_field(where: str, message: str) -> ProblemReport:
    """Return what is wrong with the value of a field."""
    return ProblemReport(code="wrong-value", where=where, message=message)
