"""Examples for the API's description, made from those of the schemas' fields."""

from collections.abc import Mapping
from typing import Any

from reverie_eval.metrics import PRIMARY_METRIC
from reverie_eval.scoring import DEFAULT_PROTOCOL
from reverie_eval.server.errors import EXAMPLE_NOW
from reverie_eval.tasks import DEFAULT_TASK, find_task
from reverie_eval.version import __version__

_HEADLINE = {
    "path_length": 13.47,
    "success": 0.5451,
    "oracle_success": 0.6198,
    "spl": 0.4712,
    "rgs": 0.3605,
    "rgspl": 0.3102,
}
_FIELDS: Mapping[str, Any] = {
    "metric": PRIMARY_METRIC,
    "protocol": DEFAULT_PROTOCOL,
    "scores": {
        key: _HEADLINE.get(key, 0.5)  # valid for every metric
        for key in find_task(DEFAULT_TASK).headline
    },
    "signature": f"split:test|protocol:{DEFAULT_PROTOCOL}|data:b29e8e6d06f6|n:6292"
    f"|version:{__version__}",
    "version": __version__,
}
"""Fields whose examples change with the code, by name."""
_NULL = {"type": "null"}
_KINDS: Mapping[str | None, Any] = {
    "array": [],
    "boolean": False,
    "date-time": f"{EXAMPLE_NOW:%Y-%m-%dT%H:%M:%SZ}",
    "integer": 1,
    "number": 0.5,
    "object": {},
    "string": "...",
    "uri": "https://example.org/",
}
"""Examples of fields that have none, by their format or type."""


def example_of(schema: Mapping[str, Any], models: Mapping[str, Any]) -> Any:
    """Build an example of a JSON schema.

    Without an example of their own, optional fields are left out, and required ones that may be
    null are null.

    Parameters
    ----------
    schema : mapping
        The schema of a message, or of a part of one.
    models : mapping
        The schemas that it refers to, by name.

    Examples
    --------
    >>> field = {"type": "string", "examples": ["Ada"]}
    >>> team = {"type": "object", "properties": {"people": {"type": "array", "items": field}}}
    >>> example_of({"$ref": "#/$defs/Team"}, {"Team": team | {"required": ["people"]}})
    {'people': ['Ada']}
    """
    match schema:
        case {"examples": [first, *_]} | {"const": first} | {"enum": [first, *_]}:
            return first
        case {"$ref": reference}:
            return example_of(models[reference.rpartition("/")[2]], models)
        case {"anyOf": choices}:
            shown = (each for each in choices if each.keys() & {"examples", "$ref"})
            return example_of(next(shown, _NULL if _NULL in choices else choices[0]), models)
        case {"properties": fields}:
            required = schema.get("required", ())
            return {
                name: _FIELDS[name]
                if name in _FIELDS and "examples" not in field
                else example_of(field, models)
                for name, field in fields.items()
                if name in required or "examples" in field
            }
        case {"type": "array", "items": item}:
            return [example_of(item, models)]
        case _:
            return _KINDS.get(schema.get("format", schema.get("type")))


SUBMISSION = [
    {"instr_id": "4774_267_1", "trajectory": [["a68b5ae6571e", 3.14, 0.0]], "predObjId": 402}
]
FORM = {"file": "(the result file)", "name": "Walker", "extra_data": True}
