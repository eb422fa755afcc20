"""Folders that are whole when they appear."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory


@contextmanager
def appearing(folder: Path, *, mode: int = 0o777, last: str = "") -> Iterator[Path]:
    """Lend a folder to fill; what is in it stands in its place when that is done, or never.

    A new folder appears at once. One that is there may be a disk of its own, or where a shell is,
    and stays what it is: it is filled out of sight, and then its parts move up.

    Parameters
    ----------
    folder : Path
        A folder that is not there yet, or empty.
    mode : int
        Who may do what with a new folder, as far as the process leaves it to them.
    last : str
        The name of the part that moves up when all others have: what makes the folder complete.
    """
    place = folder.absolute()
    is_new = not place.exists()
    beside = place.parent if is_new else place
    beside.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=f".{place.name}-", dir=beside) as hidden:
        # One level deeper, because the outer folder is for nobody else's eyes.
        staging = Path(hidden, place.name)
        staging.mkdir(mode)
        yield staging
        if is_new:
            staging.rename(place)
            return
        for part in sorted(staging.iterdir(), key=lambda part: part.name == last):
            part.rename(place / part.name)
