"""Logs: one JSON object per line on standard error.

They never contain bodies, tokens or answers. A fault is logged with all its frames, but exception
messages only if they come from the operating system or the database: others may quote an answer.
"""

import json
import logging
import traceback
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Any

from sqlalchemy.exc import SQLAlchemyError

from reverie_eval.server.store.damage import damage_in

_SAID_BY_OTHERS = (OSError, SQLAlchemyError)


class JsonLines(logging.Formatter):
    """Formats a record as a line of JSON: time, level, logger, event, and the event's fields."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        at = datetime.fromtimestamp(record.created, UTC)
        line: dict[str, Any] = {
            "time": at.isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "event": record.getMessage().strip(),
            **getattr(record, "fields", {}),
        }
        if record.exc_info and record.exc_info[1]:
            line["fault"] = list(told(record.exc_info[1]))
        return json.dumps(line, ensure_ascii=False, default=str)


def told(error: BaseException) -> Iterator[dict[str, Any]]:
    """Yield an exception and those that caused it, the first cause first, with their frames."""
    cause = error.__cause__ or (None if error.__suppress_context__ else error.__context__)
    if cause is not None:
        yield from told(cause)
    yield {
        "kind": f"{type(error).__module__}.{type(error).__qualname__}",
        "said": damage_in(error) or str(error) if isinstance(error, _SAID_BY_OTHERS) else "",
        "frames": [
            f"{frame.filename}:{frame.lineno} in {frame.name}"
            for frame in traceback.extract_tb(error.__traceback__)
        ],
    }


LOGGING: dict[str, Any] = {
    "version": 1,
    "disable_existing_loggers": False,
    "formatters": {"json": {"()": JsonLines}},
    "handlers": {"stderr": {"class": "logging.StreamHandler", "formatter": "json"}},
    "root": {"handlers": ["stderr"], "level": "WARNING"},
    "loggers": {
        "reverie_eval.server": {"level": "INFO"},
        "uvicorn": {"level": "INFO"},
        "python_multipart": {"level": "ERROR"},  # its warnings quote form fields
    },
}
"""Logging of the whole process: ours, uvicorn's, and warnings of all libraries."""
