"""The style of all figures. matplotlib is imported when a figure is drawn.

A split has the same colour in every figure. All colours are distinguishable with any colour vision;
they are from the palette of Okabe and Ito, "Color Universal Design", 2008.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from reverie_eval.errors import ReverieEvalError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BLUE, ORANGE, GREEN, VERMILION = "#0072B2", "#E69F00", "#009E73", "#D55E00"
GREY, INK = "#B3BAC4", "#333333"
_SPLIT_COLOURS: Mapping[str, str] = MappingProxyType(
    {"train": BLUE, "val_seen": ORANGE, "val_unseen": GREEN, "test": "#CC79A7"}
)
_OTHER_SPLIT = "#56B4E9"
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
        "svg.hashsalt": "reverie-eval",  # the same figure gives the same file
    }
)


def split_colour(split: str) -> str:
    return _SPLIT_COLOURS.get(split, _OTHER_SPLIT)


@contextmanager
def styled_axes(ax: "Axes | None") -> Iterator["Axes"]:
    """Draw on the given Axes in our style, or on new ones of pyplot, which notebooks show."""
    try:
        import matplotlib as mpl
        from matplotlib import pyplot as plt
    except ModuleNotFoundError as error:
        raise ReverieEvalError(
            "figures need matplotlib; install it with: pip install 'reverie-eval[figures]'"
        ) from error
    plt.install_repl_displayhook()  # if first done in the context, leaving it would undo it
    with mpl.rc_context(dict(STYLE)):
        yield plt.subplots(figsize=(7, 4.2), layout="constrained")[1] if ax is None else ax


def use_round_ticks(axes: "Axes") -> None:
    """Mark whole numbers below the axes, in steps of 1, 2, 5, 10, 20, 50 and so on."""
    from matplotlib.ticker import MaxNLocator

    whole = MaxNLocator(integer=True, steps=[1, 2, 5, 10], min_n_ticks=1)
    axes.xaxis.set_major_locator(whole)


def set_heading(axes: "Axes", heading: str) -> None:
    """Set the heading of a figure, on the left above the axes."""
    axes.set_title(heading, loc="left", fontweight="bold", fontsize="medium")
