"""An episode's walk through its building as a file that plays: SVG, GIF or MP4."""

import shutil
import subprocess
from collections.abc import Mapping, Sequence
from io import BytesIO
from itertools import repeat
from pathlib import Path

import numpy as np

from reverie_eval.analysis import Episode
from reverie_eval.errors import (
    MissingPartError,
    ProtocolError,
    ReverieEvalError,
    naming_missing_parts,
)
from reverie_eval.files import staged_file
from reverie_eval.progress import Progress, no_progress
from reverie_eval.reporting.building_svg import SECONDS, BuildingPicture
from reverie_eval.reporting.episode_figure import check_episodes, without_variables
from reverie_eval.reporting.maps import EpisodeMap

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
