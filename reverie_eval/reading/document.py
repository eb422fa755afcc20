"""Any JSON text as Python objects, or the place where it stops being JSON."""

from typing import Any

from reverie_eval.errors import SubmissionError
from reverie_eval.reading import problems


class RepeatingObject(dict[str, Any]):
    """A JSON object that holds some fields twice; a plain parser would keep the last silently."""

    repeated: str


def parse_document(content: bytes) -> Any:
    """Parse JSON text, NaN and infinities included, so that their places can be told.

    Raises
    ------
    SubmissionError
        If it is no JSON.
    """
    import json  # Seldom needed: most files take the fast lane.

    try:
        return json.loads(content, object_pairs_hook=_object)
    except json.JSONDecodeError as error:
        problem = problems.not_json(
            f"line {error.lineno}, column {error.colno}", error.msg.removesuffix(" at")
        )
    except UnicodeDecodeError as error:
        problem = problems.not_json(f"byte {error.start}", f"not {error.encoding} text")
    except RecursionError:
        problem = problems.too_deep()
    except ValueError:
        problem = problems.endless_number()
    raise SubmissionError([problem])


def _object(fields: list[tuple[str, Any]]) -> dict[str, Any]:
    record = dict(fields)
    if len(record) == len(fields):
        return record
    names = [name for name, _ in fields]
    repeating = RepeatingObject(record)
    repeating.repeated = next(name for name in names if names.count(name) > 1)
    return repeating
