"""Draw the picture of the 36 views, ``view-grid.svg`` beside this file, to standard output.

The orange thing is one oriented box in the world, outlined in every view by the package's own
projection, so the picture cannot say something else than the code.
"""

import numpy as np

from reverie_eval.geometry import HEIGHT, N_VIEWS, WIDTH, OrientedBoxes, boxes_in_views

CELL_WIDTH, CELL_HEIGHT, GAP = 64, 48, 6
LEFT, TOP = 92, 62
DETAIL_VIEW, DETAIL_SCALE = 14, 0.55
DETAIL_LEFT, DETAIL_TOP = 92, 272
ROWS = ("up 30°", "level", "down 30°")

THING = OrientedBoxes(
    centre=np.array([[1.9, 1.25, -0.45]]),
    axes=np.array([[[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]]]),
    radii=np.array([[0.45, 0.3, 0.35]]),
)
"""Roughly the size of an armchair, between the headings of views 13 and 15, below eye level."""

STYLE = """
  text { font: 13px system-ui, sans-serif; fill: #334155 }
  .number { font-size: 12px; fill: #64748b }
  .view { fill: #f8fafc; stroke: #94a3b8 }
  .detail { fill: #f8fafc; stroke: #334155; stroke-width: 1.5 }
  .box { fill: #f59e0b; fill-opacity: 0.35; stroke: #d97706; stroke-width: 1.5 }
  .rule { stroke: #64748b; fill: none }
  .strong { font-weight: 600 }
"""


def picture() -> str:
    """Return the picture as SVG."""
    seen = boxes_in_views(np.zeros(3), THING)
    boxes = dict(zip(seen.view.tolist(), seen.box_xywh.tolist(), strict=True))
    parts = [
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 948 560">',
        "<title>The 36 views of a panorama, and a box in one of them</title>",
        f"<style>{STYLE}</style>",
        '<rect width="948" height="560" fill="white"/>',
        *_headings(),
        *(part for view in range(N_VIEWS) for part in _cell(view, boxes.get(view))),
        *_detail(boxes[DETAIL_VIEW]),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _headings() -> list[str]:
    middle = LEFT + 6 * (CELL_WIDTH + GAP)
    columns = [
        _text(_corner(24 + column)[0] + CELL_WIDTH / 2, TOP - 10, f"{30 * column}°")
        for column in range(12)
    ]
    rows = [
        _text(LEFT - 12, _corner(view)[1] + CELL_HEIGHT / 2 + 4, name, anchor="end")
        for view, name in zip((24, 12, 0), ROWS, strict=True)
    ]
    title = "heading: 0° is north (+y), turning right"
    return [_text(middle, 22, title, kind="strong"), *columns, *rows]


def _cell(view: int, box: list[int] | None) -> list[str]:
    x, y = _corner(view)
    parts = [_rectangle(x, y, CELL_WIDTH, CELL_HEIGHT, "view")]
    if box is not None:
        scale = CELL_WIDTH / WIDTH
        left, top, width, height = (scale * side for side in box)
        parts.append(_rectangle(x + left, y + top, width, height, "box"))
    return [*parts, _text(x + 5, y + 14, str(view), anchor="start", kind="number")]


def _corner(view: int) -> tuple[float, float]:
    row, column = divmod(view, 12)
    return LEFT + column * (CELL_WIDTH + GAP), TOP + (2 - row) * (CELL_HEIGHT + GAP)


def _detail(box: list[int]) -> list[str]:
    """Draw one view large, with the numbers of its box."""
    x, y, width, height = (DETAIL_SCALE * side for side in box)
    left, top = DETAIL_LEFT + x, DETAIL_TOP + y
    words = DETAIL_LEFT + DETAIL_SCALE * WIDTH + 36
    lines = (
        (f"view {DETAIL_VIEW}, 640 x 480 pixels", "strong"),
        (f'"predView": {DETAIL_VIEW},', ""),
        (f'"predBox": [{", ".join(map(str, box))}]', ""),
        ("[x, y, width, height], from the upper left corner", ""),
        ("The right edge is x + width, at most 640;", ""),
        ("the lower edge is y + height, at most 480.", ""),
        ("The same object has another box in every view", ""),
        ("that shows it: say which view was drawn in.", ""),
    )
    return [
        _rectangle(DETAIL_LEFT, DETAIL_TOP, DETAIL_SCALE * WIDTH, DETAIL_SCALE * HEIGHT, "detail"),
        _rectangle(left, top, width, height, "box"),
        _line(DETAIL_LEFT, top, left, top),
        _text((DETAIL_LEFT + left) / 2, top - 6, "x"),
        _line(left, DETAIL_TOP, left, top),
        _text(left - 10, (DETAIL_TOP + top) / 2, "y"),
        _text(left + width / 2, top + height + 18, "width"),
        _text(left + width + 10, top + height / 2 + 4, "height", anchor="start"),
        *(
            _text(words, DETAIL_TOP + 30 + 28 * number, line, anchor="start", kind=kind)
            for number, (line, kind) in enumerate(lines)
        ),
    ]


def _rectangle(x: float, y: float, width: float, height: float, kind: str) -> str:
    return f'<rect class="{kind}" x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}"/>'


def _line(x: float, y: float, x_end: float, y_end: float) -> str:
    return f'<path class="rule" stroke-dasharray="4 3" d="M{x:g} {y:g}L{x_end:g} {y_end:g}"/>'


def _text(x: float, y: float, words: str, anchor: str = "middle", kind: str = "") -> str:
    shown = words.replace("&", "&amp;").replace("<", "&lt;")
    return f'<text class="{kind}" x="{x:g}" y="{y:g}" text-anchor="{anchor}">{shown}</text>'


if __name__ == "__main__":
    import sys

    sys.stdout.write(picture())
