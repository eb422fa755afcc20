"""Read a submission, whatever it comes in."""

from reverie_eval.reading.document import are_records, parse_document
from reverie_eval.reading.official import convert_official, decode_official
from reverie_eval.reading.predictions import Predictions, Submission
from reverie_eval.reading.records import read_records
from reverie_eval.reading.sources import read_bytes


def read_predictions(submission: Submission, *, answers_only: bool = False) -> Predictions:
    """Read a submission in any form that public codebases write.

    With ``answers_only`` trajectories are not looked at and may be left out.

    Raises
    ------
    SubmissionError
        If it is no list of records at all. Everything smaller is in the result's ``problems``.
    OSError
        If the file cannot be read.
    """
    if are_records(submission):
        predictions = None if answers_only else convert_official(submission)
        return predictions or read_records(submission, answers_only=answers_only)
    return read_text(read_bytes(submission), answers_only=answers_only)


def read_text(content: bytes, *, answers_only: bool = False) -> Predictions:
    """Read a submission's JSON text, which was unpacked already; as :func:`read_predictions`."""
    predictions = None if answers_only else decode_official(content)
    return predictions or read_records(parse_document(content), answers_only=answers_only)
