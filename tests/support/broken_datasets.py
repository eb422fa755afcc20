"""The flat as a folder of published files, and ways to spoil it."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.support.flat_world import FLAT, SINK
from tests.support.worlds import SPLIT, write_world

DATA = Path("tasks", "REVERIE", "data")
ANNOTATIONS = DATA / f"REVERIE_{SPLIT}.json"
GRAPH = Path("connectivity", "flat_connectivity.json")
DOOR, HALL = 0, 1
BOX = [1, 2, 30, 40]

Spoil = Callable[[Path], object]


def write_published_flat(folder: Path) -> None:
    """Write the flat with a box file per viewpoint, as the dataset is published."""
    write_world(FLAT, folder)
    one_file = folder / DATA / "BBoxes.json"
    for place, objects in json.loads(one_file.read_text()).items():
        viewpoint_id = place.removeprefix("flat_")
        write_json(boxes_of(folder, viewpoint_id), {viewpoint_id: objects})
    one_file.unlink()


def boxes_of(folder: Path, viewpoint_id: str) -> Path:
    """Return the box file of a viewpoint."""
    return folder / DATA / "BBox" / f"flat_{viewpoint_id}.json"


def write_json(path: Path, content: object) -> None:
    """Write a file and, if need be, its folder."""
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(content))


def edited(path: Path, change: Callable[[Any], object]) -> Spoil:
    """Make what changes the content of a file."""

    def spoil(folder: Path) -> None:
        content = json.loads((folder / path).read_text())
        change(content)
        write_json(folder / path, content)

    return spoil


def graph(change: Callable[[Any], object]) -> Spoil:
    """Change the connectivity file."""
    return edited(GRAPH, change)


def items(change: Callable[[Any], object]) -> Spoil:
    """Change the annotations."""
    return edited(ANNOTATIONS, change)


def listed(at: str = "bath", key: object = SINK, **entry: object) -> Spoil:
    """List an object at a viewpoint, by default the sink where it is listed already."""
    entry = {"visible_pos": [13], "bbox2d": [BOX], **entry}
    path = DATA / "BBox" / f"flat_{at}.json"
    return edited(path, lambda content: content[at].update({str(key): entry}))


def box(*numbers: float) -> Spoil:
    """Put the sink's box elsewhere."""
    return listed(bbox2d=[numbers])


def all_round(key: int) -> Spoil:
    """Show an object in the same place of every view."""
    return listed(key=key, visible_pos=list(range(36)), bbox2d=[BOX] * 36)


def sofas(hidden: int, visible: int) -> Spoil:
    """List sofas at a viewpoint, some of which no view shows."""
    views: list[list[int]] = [[]] * hidden + [[13]] * visible
    return both(
        *(
            listed(key=100 + n, name="sofa", visible_pos=shown, bbox2d=[BOX] * len(shown))
            for n, shown in enumerate(views)
        )
    )


def both(*spoils: Spoil) -> Spoil:
    """Do one after the other."""
    return lambda folder: [spoil(folder) for spoil in spoils]


def no_way(start: int, end: int) -> Spoil:
    """Obstruct the way from one viewpoint to another, not the way back."""
    return graph(lambda places: places[start]["unobstructed"].__setitem__(end, 0))


def empty_boxes(folder: Path) -> None:
    """Remove all box files."""
    for path in (folder / DATA / "BBox").iterdir():
        path.unlink()


def may_stay(folder: Path) -> None:
    """Have every viewpoint unobstructed to itself."""

    def join(places: list[Any]) -> None:
        for row, place in enumerate(places):
            place["unobstructed"][row] = True

    graph(join)(folder)


def shed(folder: Path) -> None:
    """Add a viewpoint that is not included."""

    def add(places: list[Any]) -> None:
        for place in places:
            place["unobstructed"].append(False)
        places.append(
            places[DOOR] | {"image_id": "shed", "included": False, "unobstructed": [False] * 4}
        )

    graph(add)(folder)


def annex(folder: Path) -> None:
    """Add a scan of one viewpoint, which has the id of another."""
    place = json.loads((folder / GRAPH).read_text())[DOOR] | {"unobstructed": [False]}
    write_json(folder / "connectivity" / "annex_connectivity.json", [place])


def file(path: Path, text: str) -> Spoil:
    """Write a file."""
    return lambda folder: (folder / path).write_text(text)


def boxes_at(viewpoint_id: str, text: str) -> Spoil:
    """Write the box file of a viewpoint."""
    return file(DATA / "BBox" / f"flat_{viewpoint_id}.json", text)


def two_splits(folder: Path) -> None:
    """Have the same items in another split."""
    (folder / DATA / "REVERIE_train.json").write_text((folder / ANNOTATIONS).read_text())


def unanswered(content: list[Any]) -> None:
    """Add an item without a target."""
    content.append({key: content[0][key] for key in ("scan", "path", "instructions")} | {"id": "8"})
