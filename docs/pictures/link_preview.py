"""Take the picture that links to a server show, ``preview.png`` of the static files, with Chromium.

``.venv/bin/python -m docs.pictures.link_preview reverie_eval/server/http/static/preview.png``. It
shows the task: an instruction, the way to its object, and the object. The episode is one of the
demo world, drawn as the pages draw it; the picture has no data of REVERIE.
"""

import io
import re
import sys
from html import escape
from pathlib import Path

from PIL import Image
from playwright.sync_api import ViewportSize

from reverie_eval import evaluate
from reverie_eval.reporting.answer_svg import answer_svg
from reverie_eval.reporting.answers import AnswerView
from reverie_eval.reporting.building_svg import BUILDING_STYLE, BuildingPicture
from reverie_eval.reporting.maps import EpisodeMap
from tests.support.browser import browsing, chromium_path

EPISODE = "1196_0_0"
SUBMISSION = Path(__file__).parents[2] / "fixtures" / "submissions" / "good.json"
SIZE: ViewportSize = {"width": 1200, "height": 630}
"""Pixels, as sites that show links expect."""
COLOURS = 128
STYLE = """
body { margin: 0; height: 630px; padding: 45px 60px; box-sizing: border-box; background: #ffffff;
  color: #16181d; font: 26px/1.3 "DejaVu Sans", system-ui, sans-serif; }
h1 { font-size: 58px; margin: 0; line-height: 1.1; }
p { margin: 6px 0 18px; color: #575d69; }
blockquote { margin: 0 0 20px; font-size: 34px; font-style: italic; }
div { display: grid; grid-template-columns: 1fr 1fr; gap: 40px; height: 300px; }
svg { height: 300px !important; border-radius: 8px; }
.answer-view > g { display: none; }
.answer-view text { font-size: 16px !important; }
"""


def page() -> str:
    """Return the picture as HTML: the task in words, an instruction, its path and its target."""
    episode = evaluate(SUBMISSION, split="val_unseen").episode(EPISODE)
    view = AnswerView.at_stop(episode)
    walk = EpisodeMap.of({"": episode}).along_path()
    path = BuildingPicture(walk, episode.target_object).svg()
    style = f"{BUILDING_STYLE}{STYLE}"
    # Without the panorama below the view, which would be too small to read.
    target = re.sub(r'viewBox="0 0 400 \d+"', 'viewBox="0 0 400 300"', answer_svg(view), count=1)
    return (
        f"<style>{style}</style><h1>REVERIE</h1><p>Find the object that an instruction "
        "describes, in a building never seen before</p><blockquote>"
        f"\u201c{escape(episode.instruction)}\u201d</blockquote><div>{path}{target}</div>"
    )


def main(target: Path) -> None:
    """Write the picture."""
    chromium = chromium_path()
    if chromium is None:
        raise SystemExit("there is no Chromium here; install Debian's package chromium")
    with browsing(chromium) as browser:
        window = browser.new_page(viewport=SIZE)
        window.set_content(page())
        taken = window.screenshot()
    with Image.open(io.BytesIO(taken)) as image:
        image.convert("P", palette=Image.Palette.ADAPTIVE, colors=COLOURS).save(
            target, optimize=True
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
