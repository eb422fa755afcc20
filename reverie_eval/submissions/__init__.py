"""Submissions: from bytes to predictions to aligned columns, or every problem with its place.

``_sources`` gets the bytes; ``_official`` decodes the form that nearly all files have straight into
columns; ``_document`` and ``_records`` read everything else value by value and explain what is
wrong; ``_alignment`` turns ids into integers.
"""

from reverie_eval.submissions._alignment import AlignedSubmission, align, align_answers_only
from reverie_eval.submissions._conversion import Conversion, convert
from reverie_eval.submissions._hints import answer_hints, submission_hints
from reverie_eval.submissions._official import submission_schema
from reverie_eval.submissions._predictions import NO_BOXES, BoxAnswers, Predictions, Submission
from reverie_eval.submissions._records import parse_predictions, read_predictions
from reverie_eval.submissions._sources import (
    Source,
    check_names,
    read_bytes,
    source_name,
    submission_names,
)

__all__ = [
    "NO_BOXES",
    "AlignedSubmission",
    "BoxAnswers",
    "Conversion",
    "Predictions",
    "Source",
    "Submission",
    "align",
    "align_answers_only",
    "answer_hints",
    "check_names",
    "convert",
    "parse_predictions",
    "read_bytes",
    "read_predictions",
    "source_name",
    "submission_hints",
    "submission_names",
    "submission_schema",
]
