"""An episode as a figure for print, or as a file in which the walk plays.

A figure has the map, and what the agents saw where they answered. It is one SVG, in the sizes of a
journal's columns. PDF and PNG are made from it.
"""

import re
import shutil
import subprocess
from collections.abc import Callable, Iterator, Mapping, Sequence
from html import escape
from io import BytesIO
from itertools import repeat
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from reverie_eval.analysis import Episode
from reverie_eval.errors import (
    MissingPartError,
    ProtocolError,
    ReverieEvalError,
    naming_missing_parts,
)
from reverie_eval.files import staged_file
from reverie_eval.processes import Progress, no_progress
from reverie_eval.reporting.answer_svg import answer_class, answer_shapes
from reverie_eval.reporting.answers import AnswerView
from reverie_eval.reporting.building_svg import BUILDING_STYLE, SECONDS, BuildingPicture
from reverie_eval.reporting.drawing import text_at
from reverie_eval.reporting.figures import check_figure_name
from reverie_eval.reporting.map_layout import WIDTH
from reverie_eval.reporting.map_marks import sign_shapes
from reverie_eval.reporting.map_svg import map_shapes
from reverie_eval.reporting.maps import EpisodeMap
from reverie_eval.reporting.resources import text_of

Columns = Literal[1, 2]
"""The columns of a page that a figure takes up."""
# A third route would hide the others.
_MOST_EPISODES = 2
# The width of one and of two columns, in inches, in IEEE's and ACM's styles.
_INCHES: Mapping[Columns, float] = {1: 3.3, 2: 6.9}
_PIXELS_PER_INCH = 300
# In units of the page: a panel is as wide as a map.
_GAP, _HEADING, _LINE, _SIGN = 16.0, 19.0, 19.0, 46.0
_WIDEST_NAME = 200.0
# Letters of DejaVu Sans by their widths, in units of the page at the size of the key. It stands in
# for Arial on most Linux systems without that, and none of the others is wider.
_WIDTHS = (("ijlI'|.,:; ", 4.1), ("frt()[]/-", 5.0), ("wABCDEGHKNOPQRSUVXY", 9.9), ("mMW%@", 12))


class _Panel(NamedTuple):
    """A part of a figure, as wide as a map."""

    heading: str
    kind: str
    """The class of its shapes."""
    shapes: str
    height: float


def save_figure(
    episodes: Mapping[str, Episode],
    file: str | Path,
    columns: Columns = 2,
    *,
    legend: bool = True,
) -> None:
    """Write an episode as a figure for a paper: its map, and what the agents saw at the end.

    Fonts are embedded in PDF; PNG has 300 pixels per inch.

    Parameters
    ----------
    episodes : mapping of Episode
        The same episode of one or two submissions, by their names; a single name may be empty.
    file : str or Path
        A file whose name ends in .svg, .pdf or .png.
    columns : {1, 2}
        The width: one or two columns of a page, 3.3 or 6.9 inches. In one column, the map is above
        the pictures.
    legend : bool
        Whether the signs of the map are explained.

    Raises
    ------
    ProtocolError
        If the file's name has another ending, there are more than two submissions, a name is too
        long, or the episodes differ.
    ReverieEvalError
        If vl-convert is not installed, for PDF and PNG.
    """
    target = Path(file)
    check_figure_name(target)
    convert = str.encode if target.suffix == ".svg" else _converter(target.suffix)
    data = convert(figure_svg(episodes, columns, legend=legend))
    with staged_file(target) as staged:
        staged.write(data)


def figure_svg(episodes: Mapping[str, Episode], columns: Columns, *, legend: bool) -> str:
    """Draw the figure that :func:`save_figure` writes."""
    check_episodes(episodes)
    episode_map = EpisodeMap.of(episodes)
    panels = list(_panels(episodes, episode_map))
    width = columns * WIDTH + (columns - 1) * _GAP
    shapes, bottom = [], -_GAP
    for first in range(0, len(panels), columns):
        row = panels[first : first + columns]
        top = bottom + _GAP
        shapes += [_at(panel, (WIDTH + _GAP) * i, top) for i, panel in enumerate(row)]
        bottom = top + _HEADING + max(panel.height for panel in row)
    if legend:
        # Beside the last picture if there is room, or else below.
        is_beside = len(panels) % columns != 0
        left, top = (WIDTH + _GAP, top + _HEADING) if is_beside else (0.0, bottom + _GAP)
        lines = _key_lines(episode_map, width - left)
        shapes += [_key_line(line, left, top + _LINE * i) for i, line in enumerate(lines)]
        bottom = max(bottom, top + _LINE * len(lines))
    inches = _INCHES[columns]
    style = without_variables(BUILDING_STYLE + text_of("figure.css"))
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" role="img" class="figure" '
        f'width="{inches}in" height="{inches * bottom / width:.3f}in" '
        f'viewBox="0 0 {width:g} {bottom:g}">'
        f"<title>{escape(f'Episode {episode_map.instr_id}')}</title>"
        f"<desc>{escape(episode_map.description)}</desc><style>{style}</style>"
        f'<rect class="paper" width="{width:g}" height="{bottom:g}"/>'
        f"{''.join(shapes)}</svg>"
    )


def check_episodes(episodes: Mapping[str, Episode]) -> None:
    """Raise ProtocolError unless it is one episode, of one or two submissions."""
    if not 1 <= len(episodes) <= _MOST_EPISODES:
        raise ProtocolError(f"a figure shows one or two submissions, got {len(episodes)}")
    if len(instr_ids := {each.instr_id for each in episodes.values()}) > 1:
        raise ProtocolError(f"a figure shows one episode, got {' and '.join(sorted(instr_ids))}")
    for name in episodes:
        if _width(name) > _WIDEST_NAME:
            raise ProtocolError(f"the name {name} is too long for a figure; give a shorter one")


def _converter(suffix: str) -> Callable[[str], bytes]:
    """Return what makes PDF or PNG of a figure."""
    with naming_missing_parts():
        import vl_convert

    def convert(svg: str) -> bytes:
        # To vl-convert, a unit is a point and an inch has 96 units.
        in_points = re.sub(r'="([\d.]+)in"', lambda it: f'="{72 * float(it[1]):.2f}"', svg, count=2)
        if suffix == ".pdf":
            return vl_convert.svg_to_pdf(in_points)
        return vl_convert.svg_to_png(in_points, ppi=_PIXELS_PER_INCH)

    return convert


def _panels(episodes: Mapping[str, Episode], episode_map: EpisodeMap) -> Iterator[_Panel]:
    yield _Panel(f"Map, {episode_map.storeys}", *map_shapes(episode_map))
    views = [(name, AnswerView.at_stop(episode)) for name, episode in episodes.items()]
    if not any(shown.shows_target for _, shown in views):
        first, *_ = episodes.values()
        views += [("", at_end)] if (at_end := AnswerView.at_path_end(first)) else []
    for number, (name, shown) in enumerate(views, 1):
        view = f"{name}: view" if name else "View"
        shapes, height = answer_shapes(shown)
        yield _Panel(f"{view} from {shown.where}", answer_class(shapes, number), shapes, height)


def _at(panel: _Panel, x: float, y: float) -> str:
    heading = text_at(x, y + 13, panel.heading, 'class="panel"')
    size = f'width="{WIDTH}" height="{panel.height:.1f}"'
    return (
        f'{heading}<svg x="{x:g}" y="{y + _HEADING:g}" {size}>'
        f'<g class="{panel.kind}">{panel.shapes}</g></svg>'
        f'<rect class="border" x="{x:g}" y="{y + _HEADING:g}" {size}/>'
    )


def _key_lines(episode_map: EpisodeMap, width: float) -> Sequence[Sequence[tuple[str, str, float]]]:
    """Break the key into lines of signs, meanings and positions."""
    lines: list[list[tuple[str, str, float]]] = [[]]
    x = 0.0
    for sign in episode_map.signs:
        if sign.kind == "elsewhere":  # left out by the style sheet
            continue
        needed = _SIGN + _width(sign.meaning)
        if lines[-1] and x + needed > width:
            lines.append([])
            x = 0.0
        lines[-1].append((sign_shapes(sign), sign.meaning, x))
        x += needed + _GAP
    return lines


def _key_line(line: Sequence[tuple[str, str, float]], left: float, top: float) -> str:
    return "".join(
        f'<g class="episode-map" transform="translate({left + x:.1f} {top:.1f})">{sign}'
        + text_at(_SIGN, 12, meaning, 'class="meaning"')
        + "</g>"
        for sign, meaning, x in line
    )


def _width(text: str) -> float:
    """Return about how wide a text of the key is, in units of the page; never less than it is."""
    widths = {letter: width for letters, width in _WIDTHS for letter in letters}
    return sum(widths.get(letter, 7.7 if letter.isascii() else 12.0) for letter in text)


def without_variables(style: str) -> str:
    """Write a style sheet without variables and queries, which only browsers know."""
    style = re.sub(r"@media[^{]*\{([^{}]*\{[^{}]*\})*\s*\}", "", style)
    variable = re.compile(r"(--[\w-]+):\s*([^;]+);\s*")
    values = dict(variable.findall(style))
    return re.sub(r"var\((--[\w-]+)\)", lambda it: values[it[1]], variable.sub("", style))


# Files that play: the walk through its building as SVG, GIF or MP4.

_SUFFIXES = (".svg", ".gif", ".mp4")
# Pictures in a second; the part of the time that the agents walk, as in `building.css`; pixels to a
# unit of the page.
_RATE, _WALKING, _PIXELS = 10, 0.85, 2


def check_animation_name(file: Path) -> None:
    """Raise ProtocolError if a name does not end in .svg, .gif or .mp4.

    Raise MissingPartError if MP4 is asked for and ffmpeg is not on the path.
    """
    if file.suffix not in _SUFFIXES:
        raise ProtocolError(f"{file}: expected a name that ends in .svg, .gif or .mp4")
    if file.suffix == ".mp4" and shutil.which("ffmpeg") is None:
        raise MissingPartError(f"{file}: MP4 needs the program ffmpeg; install it, or write .gif")


def save_animation(
    episodes: Mapping[str, Episode], file: str | Path, progress: Progress = no_progress
) -> None:
    """Write the walk of one or two submissions through the building of an episode.

    It takes 8 seconds. SVG stands still for readers who do not want motion.

    Parameters
    ----------
    episodes : mapping of Episode
        The same episode of one or two submissions, by their names.
    file : str or Path
        A file whose name ends in .svg, .gif or .mp4.
    progress : callable, optional
        Shows progress; called with the moments of the walk, in [0, 1], a description and their
        number.

    Raises
    ------
    ProtocolError
        If the file's name has another ending, or the episodes differ.
    ReverieEvalError
        If what GIF or MP4 needs is not installed, or ffmpeg fails.
    """
    target = Path(file)
    check_animation_name(target)
    check_episodes(episodes)
    first, *_ = episodes.values()
    picture = BuildingPicture(EpisodeMap.of(episodes), first.target_object)
    if target.suffix == ".svg":
        data = picture.picture(plays=True).encode()
    else:
        data = (_gif if target.suffix == ".gif" else _mp4)(_frames(picture, progress))
    with staged_file(target) as staged:
        staged.write(data)


def _frames(picture: BuildingPicture, progress: Progress) -> Sequence[bytes]:
    """Return PNGs of the walk; the last stands until the end."""
    with naming_missing_parts():
        import vl_convert

    def png(share: float) -> bytes:
        still = without_variables(picture.picture(share=share))
        return vl_convert.svg_to_png(still, scale=_PIXELS)

    count = round(SECONDS * _RATE * _WALKING)
    moments = np.linspace(0, 1, count).tolist()
    walking = [png(share) for share in progress(moments, "Drawing", count)]
    return [*walking, *repeat(walking[-1], SECONDS * _RATE - count)]


def _gif(frames: Sequence[bytes]) -> bytes:
    with naming_missing_parts():
        from PIL import Image

    shown = [Image.open(BytesIO(each)).convert("RGB") for each in frames]
    # With one palette for all, what stands still has the same bytes in each and is left out.
    palette = shown[-1].quantize()
    first, *others = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in shown]
    written = BytesIO()
    first.save(written, "GIF", save_all=True, append_images=others, duration=1000 // _RATE, loop=0)
    return written.getvalue()


def _mp4(frames: Sequence[bytes]) -> bytes:
    # A pipe does not allow the index of a whole MP4 file, which is written last but placed first;
    # each fragment has its own. Sizes must be even.
    command = ["ffmpeg", "-loglevel", "error", "-f", "image2pipe", "-framerate", str(_RATE)]
    command += ["-i", "-", "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p"]
    command += ["-movflags", "frag_keyframe+empty_moov", "-f", "mp4", "-"]
    ended = subprocess.run(  # noqa: S603 (nothing in it comes from outside)
        command, input=b"".join(frames), capture_output=True, check=False
    )
    if ended.returncode:
        told = ended.stderr.decode(errors="replace").strip()
        raise ReverieEvalError(f"ffmpeg failed: {told or f'status {ended.returncode}'}")
    return ended.stdout
