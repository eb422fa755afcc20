"""Draw what links to a server show, ``preview.png`` of the static files, with matplotlib.

``.venv/bin/python docs/pictures/link_preview.py reverie_eval/server/pages/static/preview.png``. The
episode is one of the demo world, on the package's own map; the picture has no data of REVERIE.
"""

import sys
from pathlib import Path
from textwrap import wrap

import matplotlib as mpl
from matplotlib.figure import Figure

from reverie_eval import evaluate
from reverie_eval.reporting.drawing import INK
from reverie_eval.reporting.figures import STYLE, draw_map
from reverie_eval.reporting.maps import EpisodeMap

EPISODE = "1196_0_0"
SUBMISSION = Path(__file__).parents[2] / "fixtures" / "submissions" / "good.json"
WIDTH, HEIGHT, DOTS = 12.0, 6.3, 100
"""Inches, and dots per inch: 1200 x 630 pixels, as sites that show links expect."""
LEFT, TOP = 0.05, 0.9


def picture() -> Figure:
    """Draw the instruction on the left and its path on the right."""
    episode = evaluate(SUBMISSION, split="val_unseen").episode(EPISODE)
    figure = Figure(figsize=(WIDTH, HEIGHT), dpi=DOTS, facecolor="white")
    axes = figure.add_axes((0.5, 0.08, 0.47, 0.84))
    draw_map(EpisodeMap.of({"": episode}).without_routes(), axes)
    axes.set_title("", loc="left")
    legend = axes.get_legend()
    if legend is not None:
        legend.remove()
    text = {"x": LEFT, "va": "top", "color": INK}
    figure.text(y=TOP, s="REVERIE", fontsize=46, fontweight="bold", **text)
    figure.text(y=0.75, s="leaderboards and evaluation", fontsize=20, **text)
    quoted = "\n".join(wrap(f"\u201c{episode.instruction}\u201d", 30))
    figure.text(y=0.56, s=quoted, fontsize=24, style="italic", linespacing=1.4, **text)
    return figure


if __name__ == "__main__":
    with mpl.rc_context(dict(STYLE)):
        picture().savefig(sys.argv[1], dpi=DOTS, metadata={"Software": "matplotlib"})
