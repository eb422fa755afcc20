"""What is wrong with a value that somebody sent, in a sentence for each kind of fault.

The API, forms and addresses of pages say the same; the framework's own words are for programmers.
"""

from collections.abc import Mapping
from typing import Any

from reverie_eval.schemas.report import ProblemReport

_LINK = "takes a link that begins with https://"
_WHOLE_NUMBER = "takes a whole number"
_NUMBER = "takes a number"
_DATE = "takes a date such as 2027-06-01"
_INSTANT = "takes an instant with its time zone, such as 2027-06-01T12:00:00Z"
_YES_OR_NO = "takes true or false"
_OBJECT = "takes an object with named fields"

_SENTENCES: Mapping[str, str] = {
    "missing": "is missing",
    "extra_forbidden": "is not known here; leave it out",
    "value_error": "{error}",
    "string_type": "takes text",
    "string_unicode": "takes text",
    "string_pattern_mismatch": "is not of the form {pattern}",
    "string_too_short": "takes {min_length:,} or more letters",
    "string_too_long": "takes up to {max_length:,} letters",
    "url_type": _LINK,
    "url_parsing": _LINK,
    "url_scheme": _LINK,
    "url_too_long": "takes up to {max_length:,} letters",
    "literal_error": "takes {expected}",
    "bool_type": _YES_OR_NO,
    "bool_parsing": _YES_OR_NO,
    "int_type": _WHOLE_NUMBER,
    "int_parsing": _WHOLE_NUMBER,
    "int_parsing_size": "is too large a number",
    "int_from_float": _WHOLE_NUMBER,
    "float_type": _NUMBER,
    "float_parsing": _NUMBER,
    "finite_number": _NUMBER,
    "greater_than_equal": "takes {ge:,} or more",
    "less_than_equal": "takes {le:,} or less",
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
    "list_type": "takes a list",
    "json_invalid": "is the letter from which on this is no JSON",
}
"""By the framework's name of the fault; what a fault knows goes into the braces."""

_CARRIERS = frozenset({"body", "query", "path", "header", "cookie"})
"""Of a request, which hold the fields; no part of a field's name."""


def wrong_value(detail: Mapping[str, Any]) -> ProblemReport:
    """Return what the framework found wrong with a value, and where: by the name of its field."""
    loc = [str(part) for part in detail["loc"]]
    where = ".".join(loc[1:] if loc and loc[0] in _CARRIERS else loc)
    sentence = _SENTENCES.get(detail["type"])
    message = sentence.format_map(detail.get("ctx", {})) if sentence else str(detail["msg"])
    return _problem(where, message)


def unreadable_json(error: RecursionError | ValueError) -> ProblemReport:
    """Return what keeps a body from being read as JSON, and from which byte on."""
    if isinstance(error, UnicodeDecodeError):
        return _problem(str(error.start), "is the byte from which on this is no UTF-8")
    if isinstance(error, RecursionError):
        return _problem("", "is nested too deeply")
    return _problem("", "holds a number with too many digits")


def _problem(where: str, message: str) -> ProblemReport:
    return ProblemReport(code="wrong-value", where=where, message=message)
