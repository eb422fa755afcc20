"""Take the picture of a leaderboard that README and the site show, with Chromium.

``.venv/bin/python -m docs.pictures.leaderboard docs/pictures/leaderboard.png``. The methods are
mixtures of two sample files on the demo world; the picture has no data of REVERIE.
"""

import io
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

from PIL import Image

from fixtures.servers import make_folder
from reverie_eval_cli.main import main
from tests.support.browser import UNLIMITED, browsing, chromium_path
from tests.support.serving import running

SAMPLES = Path(__file__).parents[2] / "fixtures" / "submissions"
METHODS = {
    "Looks Twice": ("Blue Team", 1.0),
    "Panorama Transformer": ("Navigators", 0.85),
    "Object Memory": ("Blue Team", 0.8),
    "Map and Ask": ("Lab of Rooms", 0.55),
    "Sequence Baseline": ("Navigators", 0.3),
    "Random Turns": ("Lab of Rooms", 0.0),
}
"""The team of each method, and the share of episodes that it answers as the good sample does."""
SIZE = {"width": 1180, "height": 900}
COLOURS = 128
"""Enough for text and charts, in a quarter of the bytes."""


def records(share: float, name: str) -> Iterator[object]:
    """Mix the good and the mediocre sample."""
    luck = Random(name)
    samples = [json.loads((SAMPLES / f"{kind}.json").read_text()) for kind in ("mediocre", "good")]
    return (pair[luck.random() < share] for pair in zip(*samples, strict=True))


def furnish(folder: Path) -> None:
    """Submit and publish the methods."""
    server = str(folder)
    for team in sorted({team for team, _ in METHODS.values()}):
        main(["server", "team", "add", server, team])
        main(["server", "person", "add", server, f"Of {team}", "--team", team])
    for day, (method, (team, share)) in enumerate(METHODS.items(), start=1):
        file = folder.with_name(f"{day}.json")
        file.write_text(json.dumps(list(records(share, method))))
        who = ["--team", team, "--person", f"Of {team}", "--received", f"2026-06-0{day}T12:00:00Z"]
        where = ["server", "submit", server, str(file), "--split", "val_unseen"]
        main([*where, *who, "--method", method, "--publish"])


def picture() -> Image.Image:
    """Show the leaderboard of val_unseen."""
    chromium = chromium_path()
    if chromium is None:
        raise SystemExit("there is no Chromium here; install Debian's package chromium")
    with TemporaryDirectory() as temporary, browsing(chromium) as browser:
        folder = Path(temporary, "server")
        make_folder(folder)
        furnish(folder)
        with running(folder, **UNLIMITED) as (_, url):
            page = browser.new_context(viewport=SIZE).new_page()
            page.goto(f"{url}/splits/val_unseen", wait_until="networkidle")
            taken = Image.open(io.BytesIO(page.locator("table").first.screenshot()))
    return taken.convert("RGB").quantize(COLOURS)


if __name__ == "__main__":
    picture().save(sys.argv[1], optimize=True)
