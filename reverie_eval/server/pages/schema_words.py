"""A JSON schema in words: what a field of a submission takes."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

_PLAIN = {
    "string": "text",
    "number": "number",
    "integer": "whole number",
    "boolean": "true or false",
}


class Field(NamedTuple):
    """A field, as a table shows it."""

    name: str
    takes: str
    is_required: bool
    meaning: str


def fields_of(schema: Mapping[str, Any]) -> Sequence[Field]:
    """Return the fields of an object's schema, in its order."""
    required = schema.get("required", ())
    return [
        Field(name, in_words(field), name in required, field.get("description", ""))
        for name, field in schema["properties"].items()
    ]


def in_words(schema: Mapping[str, Any]) -> str:
    """Say what a value is.

    >>> in_words({"type": "integer", "minimum": 0, "exclusiveMaximum": 36})
    'whole number, at least 0, below 36'
    >>> in_words({"type": "array", "prefixItems": [{"type": "string"}, {"type": "number"}]})
    'list of [text, number]'
    """
    if "anyOf" in schema:
        kinds = [kind for kind in schema["anyOf"] if kind.get("type") != "null"]
        return " or ".join(map(in_words, kinds))
    if schema["type"] == "array":
        return _list_in_words(schema)
    return ", ".join([_PLAIN[schema["type"]], *_bounds(schema)])


def _list_in_words(schema: Mapping[str, Any]) -> str:
    if "prefixItems" in schema:
        return f"list of [{', '.join(_PLAIN[item['type']] for item in schema['prefixItems'])}]"
    least = f"{schema['minItems']} or more of " if "minItems" in schema else ""
    return f"list of {least}{in_words(schema['items']).removeprefix('list of ')}"


def _bounds(schema: Mapping[str, Any]) -> Sequence[str]:
    said = {
        "minimum": "at least",
        "exclusiveMinimum": "above",
        "maximum": "at most",
        "exclusiveMaximum": "below",
    }
    return [f"{words} {schema[key]:,}" for key, words in said.items() if key in schema]
