"""Submissions: from bytes to predictions to aligned columns, or every problem with its location.

There are two readers. The fast one (``_fast``) reads valid files in all common forms straight into
columns. The careful one reads everything else value by value, and explains what is wrong:
``_document`` finds the records, ``_records`` reads them with ``_trajectories`` and ``_answers``.
Both give the same :class:`Predictions`, whose ids ``_alignment`` turns into integers.
"""

from reverie_eval.submissions._alignment import (
    align,
    align_answers_only,
    check_batch,
    check_navigation_only,
)
from reverie_eval.submissions._answers import NO_POINT, official_point
from reverie_eval.submissions._conversion import Conversion, convert
from reverie_eval.submissions._document import are_records
from reverie_eval.submissions._fields import submission_schema
from reverie_eval.submissions._hints import answer_hints, submission_hints
from reverie_eval.submissions._predictions import (
    BoxAnswers,
    Content,
    Predictions,
    Records,
    Submission,
    SubmissionColumns,
)
from reverie_eval.submissions._problems import TOO_MUCH_MEMORY, TOO_MUCH_TIME
from reverie_eval.submissions._records import (
    parse_predictions,
    read_headings,
    read_predictions,
)
from reverie_eval.submissions._sources import (
    MAX_MEBIBYTES_VARIABLE,
    RECEIPT_ENDING,
    Source,
    check_names,
    check_value_count,
    find_fields,
    find_files,
    find_runs,
    has_fields,
    is_pattern,
    read_bytes,
    source_name,
    submission_names,
    unpack,
    watch_files,
)
from reverie_eval.submissions._trajectories import join_items, submission_text

__all__ = [
    "MAX_MEBIBYTES_VARIABLE",
    "NO_POINT",
    "RECEIPT_ENDING",
    "TOO_MUCH_MEMORY",
    "TOO_MUCH_TIME",
    "BoxAnswers",
    "Content",
    "Conversion",
    "Predictions",
    "Records",
    "Source",
    "Submission",
    "SubmissionColumns",
    "align",
    "align_answers_only",
    "answer_hints",
    "are_records",
    "check_batch",
    "check_names",
    "check_navigation_only",
    "check_value_count",
    "convert",
    "find_fields",
    "find_files",
    "find_runs",
    "has_fields",
    "is_pattern",
    "join_items",
    "official_point",
    "parse_predictions",
    "read_bytes",
    "read_headings",
    "read_predictions",
    "source_name",
    "submission_hints",
    "submission_names",
    "submission_schema",
    "submission_text",
    "unpack",
    "watch_files",
]
