"""Whether what is written on drawings of buildings can be read, in a real browser."""

from collections.abc import Sequence
from typing import Literal

import pytest
from playwright.sync_api import Browser

import reverie_eval as rv
from reverie_eval.reporting.answer_svg import answer_svg
from reverie_eval.reporting.answers import AnswerView
from reverie_eval.reporting.building_svg import BUILDING_STYLE, BuildingPicture
from reverie_eval.reporting.map_svg import map_svg
from reverie_eval.reporting.maps import EpisodeMap
from tests.conftest import SAMPLES
from tests.support.browser import new_page

UNREADABLE = """([smallest, contrast]) => {
    const found = [];
    const rgb = colour => colour.match(/[\\d.]+/g).slice(0, 3).map(Number);
    const light = colour => rgb(colour)
        .map(part => part / 255)
        .map(part => part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4)
        .reduce((sum, part, at) => sum + part * [0.2126, 0.7152, 0.0722][at], 0);
    const ratio = (one, other) => {
        const [low, high] = [light(one), light(other)].sort((a, b) => a - b);
        return (high + 0.05) / (low + 0.05);
    };
    const svgOf = each => each.ownerSVGElement;
    // What is under a text: its own halo, or else the first shape there that is filled.
    const ground = (text, look, at) => {
        if (look.stroke !== "none" && parseFloat(look.strokeWidth) >= 3) return look.stroke;
        const fills = document.elementsFromPoint(at.x + at.width / 2, at.y + at.height / 2)
            .filter(each => each !== text && svgOf(each)).map(each => getComputedStyle(each).fill);
        return fills.find(fill => fill !== "none")
            ?? getComputedStyle(document.body).backgroundColor;
    };
    for (const svg of document.querySelectorAll("body > svg")) {
        const page = svg.getBoundingClientRect(), scale = page.width / svg.viewBox.baseVal.width;
        const texts = [...svg.querySelectorAll("text")].map(text => {
            const at = text.getBoundingClientRect(), look = getComputedStyle(text);
            const say = problem => found.push(`${text.textContent}: ${problem}`);
            if (at.left < page.left - 0.5 || at.right > page.right + 0.5) say("cut at a side");
            if (at.top < page.top - 0.5 || at.bottom > page.bottom + 0.5) say("cut");
            const size = parseFloat(look.fontSize) * scale;
            if (size < smallest) say(`${size} px`);
            const seen = ratio(look.fill, ground(text, look, at));
            if (seen < contrast) say(`contrast ${seen.toFixed(2)}`);
            return { name: text.textContent, at };
        });
        texts.forEach((one, index) => texts.slice(index + 1).forEach(other => {
            const { left, right, top, bottom } = other.at;
            const across = Math.min(one.at.right, right) - Math.max(one.at.left, left);
            const down = Math.min(one.at.bottom, bottom) - Math.max(one.at.top, top);
            // Line boxes are taller than letters: what shares less than a quarter is apart.
            if (across > 1 && down > one.at.height / 4) found.push(`${one.name} on ${other.name}`);
        }));
    }
    return [document.querySelectorAll("text").length, found];
}"""
"""Counts the texts of drawings, and says what is wrong with them."""
SMALLEST, CONTRAST = 11, 4.5
"""Pixels, and the ratio of WCAG 2.2's level AA for text."""


def unreadable(
    browser: Browser, drawings: Sequence[str], width: int, scheme: Literal["light", "dark"]
) -> tuple[int, Sequence[str]]:
    """Return how many texts there are on drawings of a width, and what is wrong with them."""
    page = new_page(browser, viewport={"width": width, "height": 900}, color_scheme=scheme)
    ground = ":root { color-scheme: light dark } body { margin: 0; background: Canvas }"
    page.set_content(f"<style>{ground}{BUILDING_STYLE}</style>{''.join(drawings)}")
    # All of it is on the screen, or nothing would be found under a text.
    height = page.evaluate("document.documentElement.scrollHeight")
    page.set_viewport_size({"width": width, "height": height})
    count, found = page.evaluate(UNREADABLE, [SMALLEST, CONTRAST])
    page.close()
    return count, found


@pytest.fixture(scope="module")
def drawings() -> Sequence[str]:
    """Draw the building, the map and the answer of every twelfth episode."""
    scores = rv.evaluate(SAMPLES / "mediocre.json", split="val_unseen")
    drawn = []
    for instr_id in scores.instr_ids[::12]:
        episode = scores.episode(instr_id)
        named = EpisodeMap.of({"Ours": episode, "A baseline": episode})
        drawn.append(BuildingPicture(named, episode.target_object).svg())
        drawn += [map_svg(named), answer_svg(AnswerView.at_stop(episode))]
    return drawn


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [400, 720])
def test_what_is_written_on_drawings_can_be_read(
    width: int, scheme: Literal["light", "dark"], drawings: Sequence[str], browser: Browser
) -> None:
    count, found = unreadable(browser, drawings, width, scheme)
    assert count > 3 * len(drawings)
    assert found == []
