"""Reading: from whatever a participant hands over to predictions, or every problem with its place.

``sources`` gets the bytes, ``official`` decodes the form that nearly all files have straight into
columns, ``document`` and ``records`` read everything else value by value and say what is wrong.
"""

from reverie_eval.reading.predictions import NO_BOXES, BoxAnswers, Predictions, Submission
from reverie_eval.reading.read import read_predictions, read_text
from reverie_eval.reading.sources import called

__all__ = [
    "NO_BOXES",
    "BoxAnswers",
    "Predictions",
    "Submission",
    "called",
    "read_predictions",
    "read_text",
]
