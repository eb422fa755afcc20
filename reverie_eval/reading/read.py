"""Read a submission, whatever it comes in."""

from collections.abc import Sequence

from reverie_eval.reading.document import parse_document
from reverie_eval.reading.official import decode_official
from reverie_eval.reading.predictions import Predictions, Submission
from reverie_eval.reading.records import read_records
from reverie_eval.reading.sources import read_bytes


def read_predictions(submission: Submission) -> Predictions:
    """Read a submission in the official result format.

    Raises
    ------
    SubmissionError
        If it is no list of records at all. Everything smaller is in the result's ``problems``.
    OSError
        If the file cannot be read.
    """
    if isinstance(submission, Sequence) and not isinstance(submission, str | bytes):
        return read_records(submission)
    content = read_bytes(submission)
    return decode_official(content) or read_records(parse_document(content))
