"""Writing submissions: one record a line, which people can read and programs compare."""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from reverie_eval import SubmissionError
from reverie_eval.submissions import source_name


def write_submission(records: Sequence[Mapping[str, Any]], output: str | None) -> None:
    """Write records to a file, or to standard output."""
    import json

    text = "[\n" + ",\n".join(map(json.dumps, records)) + "\n]\n"
    if output:
        Path(output).write_text(text, encoding="utf-8")
    else:
        sys.stdout.write(text)


def rejection(submission: str, error: SubmissionError) -> str:
    """Say what is wrong with which submission."""
    return f"{source_name(submission)}: {error}"
