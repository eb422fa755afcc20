"""Draw the picture of an answer, ``answer.svg`` beside this file, to standard output.

It is an answer by box in the demo world, as docs/how-to/report.md explains.
"""

from dataclasses import replace
from pathlib import Path

import reverie_eval as rv
from reverie_eval.reporting.answer_svg import answer_picture
from reverie_eval.reporting.answers import AnswerView

SAMPLE = Path(__file__).parents[2] / "fixtures" / "submissions" / "drawn.json"
EPISODE = "1196_0_0"
"""The episode whose predicted box has an IoU of 0.25 with the target's."""


def picture() -> str:
    """Draw the answer from where the agent stopped."""
    episode = rv.evaluate(SAMPLE, split="val_unseen").episode(EPISODE)
    # Without the demo world's pictures, as it is with REVERIE's files alone.
    return answer_picture(replace(AnswerView.at_stop(episode), skybox=None)) + "\n"


if __name__ == "__main__":
    import sys

    sys.stdout.write(picture())
