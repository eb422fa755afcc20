"""How figures look: alike, whatever they show. Needs matplotlib.

A split has the same colour in every figure, one that people with any colour vision tell apart.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

_COLOURS: Mapping[str, str] = MappingProxyType(
    {"train": "#0072B2", "val_seen": "#E69F00", "val_unseen": "#009E73", "test": "#CC79A7"}
)
"""From the palette of Okabe and Ito, "Color Universal Design", 2008; so is the next."""
_OTHER_COLOUR = "#56B4E9"
INK = "#333333"
STYLE: Any = MappingProxyType(
    {
        "font.size": 11,
        "figure.constrained_layout.h_pad": 0.06,
        "figure.constrained_layout.w_pad": 0.06,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.edgecolor": INK,
        "axes.labelcolor": INK,
        "xtick.color": INK,
        "ytick.color": INK,
        "text.color": INK,
        "text.parse_math": False,  # a name is shown as it is
        "savefig.dpi": 200,
        "svg.hashsalt": "reverie-eval",  # else no two files would be the same
    }
)


def colour_of(split: str) -> str:
    """Return the colour of a split."""
    return _COLOURS.get(split, _OTHER_COLOUR)


def count_in_round_steps(axes: Axes) -> None:
    """Mark whole numbers below the axes, in steps of 1, 2, 5, 10, 20, 50 and so on."""
    whole = MaxNLocator(integer=True, steps=[1, 2, 5, 10], min_n_ticks=1)
    axes.xaxis.set_major_locator(whole)
