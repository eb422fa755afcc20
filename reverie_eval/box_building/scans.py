"""Which scans there is a building for, and camera poses in it."""

from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from reverie_eval.errors import DatasetError, Problem
from reverie_eval.ground_truth.dataset import connectivity_file, connectivity_files, explain
from reverie_eval.schemas.dataset import CONNECTIVITY, Viewpoint
from reverie_eval.wording import counted, some

_HOUSE = ".house"
_A_HOUSE = f"SCAN{_HOUSE}"
_POSES = connectivity_file(Path(), "SCAN").name
"""What files of any scan are called."""


@dataclass(frozen=True, slots=True)
class Scan:
    """A scan's files."""

    scan_id: str
    house: Path
    connectivity: Path


@dataclass(frozen=True, slots=True)
class FoundScans:
    """Scans whose files are all there, and those with files of one kind only."""

    complete: tuple[Scan, ...]
    without_house: tuple[str, ...]
    without_connectivity: tuple[str, ...]

    def notes(self) -> list[str]:
        """Say which scans were left out, and why."""
        left_out = {
            "no .house file": self.without_house,
            "no connectivity file": self.without_connectivity,
        }
        return [
            f"{reason} for {counted(len(scans), 'scan')}, left out: {some(scans)}"
            for reason, scans in left_out.items()
            if scans
        ]


def find_scans(houses: Path, connectivity: Path, wanted: Iterable[str] | None = None) -> FoundScans:
    """Find the files of scans.

    Parameters
    ----------
    houses : Path
        A folder with ``{scan}.house`` at any depth, as Matterport lays them out.
    connectivity : Path
        The folder of ``{scan}_connectivity.json`` files.
    wanted : iterable of str, optional
        The scans that are meant: all of their files have to be there.

    Raises
    ------
    DatasetError
        Naming everything that is missing, or there twice.
    """
    _demand_folders(houses, connectivity)
    house_files = sorted(houses.rglob(f"*{_HOUSE}"))
    by_scan = {path.stem: path for path in house_files}
    posed = connectivity_files(connectivity)
    scans = sorted(by_scan.keys() | posed.keys() if wanted is None else set(wanted))
    found = FoundScans(
        complete=tuple(
            Scan(scan, by_scan[scan], posed[scan])
            for scan in scans
            if scan in by_scan and scan in posed
        ),
        without_house=tuple(scan for scan in scans if scan not in by_scan),
        without_connectivity=tuple(scan for scan in scans if scan not in posed),
    )
    problems = _twice([path for path in house_files if path.stem in scans])
    if wanted is not None or not found.complete:
        problems += _missing("missing-house", houses, _A_HOUSE, found.without_house)
        problems += _missing("missing-scan", connectivity, _POSES, found.without_connectivity)
    if not scans:
        no_house = f"no {_A_HOUSE} at any depth of this folder"
        problems.append(Problem("missing-house", str(houses), no_house))
        problems.append(Problem("missing-scan", str(connectivity), f"no {_POSES} in this folder"))
    if problems:
        raise DatasetError(problems)
    return found


def read_poses(connectivity: Path) -> list[Viewpoint]:
    """Read the included viewpoints of a connectivity file.

    Raises
    ------
    DatasetError
        If the file does not have the published form, or gives a viewpoint twice.
    """
    try:
        viewpoints = CONNECTIVITY.validate_json(connectivity.read_bytes())
    except ValidationError as error:
        problem = Problem("malformed-file", str(connectivity), explain(error))
        raise DatasetError([problem]) from error
    included = [viewpoint for viewpoint in viewpoints if viewpoint.included]
    counts = Counter(viewpoint.image_id for viewpoint in included)
    repeated = [viewpoint_id for viewpoint_id, count in counts.items() if count > 1]
    if repeated:
        message = f"{counted(len(repeated), 'viewpoint')} given more than once: {some(repeated)}"
        raise DatasetError([Problem("duplicate-viewpoint", str(connectivity), message)])
    return included


def _demand_folders(*folders: Path) -> None:
    problems = [
        Problem("missing-input", str(folder), "there is no such folder")
        for folder in folders
        if not folder.is_dir()
    ]
    if problems:
        raise DatasetError(problems)


def _missing(code: str, folder: Path, file: str, scans: Collection[str]) -> list[Problem]:
    if not scans:
        return []
    message = f"no {file} for {counted(len(scans), 'scan')}: {some(scans)}"
    return [Problem(code, str(folder), message)]


def _twice(houses: Iterable[Path]) -> list[Problem]:
    first: dict[str, Path] = {}
    return [
        Problem(
            "duplicate-house",
            str(path),
            f"the scan has a file {first[path.stem]} as well; keep one of them",
        )
        for path in houses
        if first.setdefault(path.stem, path) != path
    ]
