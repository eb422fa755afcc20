"""The outcomes of many methods in every episode, as a picture with a pixel for each."""

import base64
from collections.abc import Iterator, Mapping, Sequence
from io import BytesIO

import numpy as np

from reverie_eval.arrays import Array, IntArray
from reverie_eval.errors import naming_missing_parts
from reverie_eval.reporting.drawing import text_across, wide_svg
from reverie_eval.scoring import CORRECT
from reverie_eval.text import count_text

_OPACITIES = (0x50, 0x70, 0x70, 0x70, 0xFF)
OPACITIES = tuple(round(each / 0xFF, 2) for each in _OPACITIES)
"""How opaque the outcomes are drawn, from worst to best: paler where an episode was not solved."""
# The outcomes from worst to best, as in `charts.css`, and the gap between two buildings.
_COLOURS = np.array(
    [
        (0x7D, 0x87, 0x91, _OPACITIES[0]),
        (0xCC, 0x79, 0xA7, _OPACITIES[1]),
        (0xE6, 0x9F, 0x00, _OPACITIES[2]),
        (0x56, 0xB4, 0xE9, _OPACITIES[3]),
        (0x00, 0x9E, 0x73, _OPACITIES[4]),
        (0, 0, 0, 0),
    ],
    dtype=np.uint8,
)
_BETWEEN = len(_COLOURS) - 1
# Pixels, as high as a method's name in `style.css`.
_ROW = 17
# Percent: the gap between two buildings (of the number of episodes), and the width that a
# building's name needs.
_GAP, _BUILDING = 0.4, 12.0


def outcome_matrix(outcome: IntArray, scans: Sequence[str]) -> str:
    """Draw a row for each method and a column for each episode.

    Episodes are grouped by building, the one that most are solved in at the right; within it, what
    most methods solve is at the right.

    Parameters
    ----------
    outcome : int array of shape (n_methods, n_episodes)
        Indices into ``OUTCOMES``; the first method is at the top.
    scans : sequence of str
        The building of each episode.

    Returns
    -------
    str
        SVG around a picture with a pixel for each outcome: 3,521 episodes of 54 methods take about
        60 kB, as elements they would take megabytes.

    Raises
    ------
    MissingPartError
        If Pillow is not installed.
    """
    solved = (outcome == CORRECT).sum(axis=0)
    columns, buildings = _arranged(solved, np.asarray(scans))
    height = _ROW * len(outcome)
    picture = f'height="{height}" preserveAspectRatio="none" href="{_picture(outcome, columns)}"'
    shapes = [
        # Not smoothed: colours that run into each other would be outcomes that there are not.
        f'<image width="100%" image-rendering="pixelated" {picture}/>',
        *_named(buildings, len(columns), height + 14),
    ]
    title = f"Outcomes of {count_text(len(outcome), 'method')} in {outcome.shape[1]:,} episodes"
    return wide_svg(title, height + 18, shapes)


def _arranged(solved: IntArray, scan: Array) -> tuple[IntArray, Mapping[str, tuple[int, int]]]:
    """Return the episode of each column, -1 between buildings, and the columns of each building."""
    by_ease = sorted(np.unique(scan).tolist(), key=lambda each: solved[scan == each].mean())
    gap = np.full(int(np.ceil(_GAP / 100 * len(solved))), -1)
    columns: list[IntArray] = []
    buildings, count = {}, 0
    for name in by_ease:
        rows = np.flatnonzero(scan == name)
        columns += [rows[np.argsort(solved[rows], kind="stable")], gap]
        buildings[name] = count, count + len(rows)
        count += len(rows) + len(gap)
    return np.concatenate(columns[:-1]), buildings


def _picture(outcome: IntArray, columns: IntArray) -> str:
    with naming_missing_parts():
        from PIL import Image

    shown = np.where(columns < 0, _BETWEEN, outcome[:, columns])
    written = BytesIO()
    Image.fromarray(_COLOURS[shown], "RGBA").save(written, "WEBP", lossless=True, method=6)
    return f"data:image/webp;base64,{base64.b64encode(written.getvalue()).decode()}"


def _named(buildings: Mapping[str, tuple[int, int]], count: int, y: float) -> Iterator[str]:
    """Name the buildings below the picture whose columns have room for it."""
    scale = 100 / count
    for name, (first, last) in buildings.items():
        if scale * (last - first) >= _BUILDING:
            yield text_across(scale * (first + last) / 2, y, name, "middle", "column")
