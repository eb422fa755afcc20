"""An episode as a figure for a paper: legible in print, complete, and the same in every format."""

import re
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from playwright.sync_api import Browser

import reverie_eval as rv
from reverie_eval.analysis import Episode
from reverie_eval.reporting import save_figure
from reverie_eval.reporting.episode_figure import Columns, figure_svg
from tests.conftest import SAMPLES, unavailable
from tests.support.browser import new_page
from tests.support.flat_world import Run
from tests.support.home_world import OTHER_WALKS, WALKS, home_scores

UNREADABLE = """
() => [...document.querySelectorAll('.figure')].flatMap(figure => {
  const perUnit = figure.getBoundingClientRect().width / figure.viewBox.baseVal.width
  const texts = [...figure.querySelectorAll('text')].filter(text => text.checkVisibility())
  const boxes = texts.map(text => text.getBoundingClientRect())
  return texts.flatMap((text, row) => {
    const box = boxes[row], panel = text.ownerSVGElement.getBoundingClientRect()
    const points = 0.75 * perUnit * parseFloat(getComputedStyle(text).fontSize)
    const isCut = box.left < panel.left - 0.5 || box.right > panel.right + 0.5
      || box.top < panel.top - 0.5 || box.bottom > panel.bottom + 0.5
    const over = texts.slice(0, row).filter((_, other) => {
      const its = boxes[other], most = 1.5  // ascenders and descenders do not fill their boxes
      return box.left < its.right && its.left < box.right
        && box.top + most < its.bottom && its.top + most < box.bottom
    })
    return [
      ...(points < 6 ? [`${text.textContent}: ${points} points`] : []),
      ...(isCut ? [`${text.textContent}: cut`] : []),
      ...over.map(other => `${text.textContent} is on ${other.textContent}`),
    ].map(fault => `${figure.querySelector('title').textContent}: ${fault}`)
  })
})
"""


@pytest.fixture(scope="module")
def homes(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, rv.Scores]:
    """Score two submissions in a home of two storeys."""
    walks = {"HAMT": WALKS, "W" * 16: OTHER_WALKS}
    return {
        name: home_scores(tmp_path_factory.mktemp("home"), each) for name, each in walks.items()
    }


def episodes(homes: Mapping[str, rv.Scores], instr_id: str) -> dict[str, Episode]:
    """Return an episode of both submissions."""
    return {name: scores.episode(instr_id) for name, scores in homes.items()}


def texts(svg: str, kind: str) -> list[str | None]:
    """Return the texts of a class in a figure."""
    found = ET.fromstring(svg).iter("{http://www.w3.org/2000/svg}text")
    return [each.text for each in found if kind in each.get("class", "").split()]


@pytest.mark.parametrize(
    ("names", "instr_id", "panels"),
    [
        pytest.param([""], "1_3_0", ["Map, level 2 of 2", "View from the stop"], id="right"),
        pytest.param(
            [""],
            "2_4_1",
            ["Map, level 2 of 2", "View from the stop", "View from the end of the annotated path"],
            id="target not in view",
        ),
        pytest.param(
            ["A", "B"],
            "1_3_0",
            ["Map, levels 1 and 2 of 2", "A: view from the stop", "B: view from the stop"],
            id="one of two sees the target",
        ),
    ],
)
def test_the_parts_of_a_figure(
    names: list[str], instr_id: str, panels: list[str], homes: Mapping[str, rv.Scores]
) -> None:
    shown = dict(zip(names, episodes(homes, instr_id).values(), strict=False))
    assert texts(figure_svg(shown, 2, legend=True), "panel") == panels


def test_a_legend_can_be_left_out(homes: Mapping[str, rv.Scores]) -> None:
    shown = episodes(homes, "1_3_0")
    assert "HAMT: route and stop" in texts(figure_svg(shown, 1, legend=True), "meaning")
    assert texts(figure_svg(shown, 1, legend=False), "meaning") == []


def test_a_figure_needs_no_style_of_a_page(homes: Mapping[str, rv.Scores]) -> None:
    svg = figure_svg(episodes(homes, "1_3_0"), 1, legend=True)
    assert re.findall(r"var\(|--|@media", svg) == []


@pytest.mark.browser
def test_everything_can_be_read_in_print(homes: Mapping[str, rv.Scores], browser: Browser) -> None:
    demo = rv.evaluate(SAMPLES / "drawn.json", split="val_unseen")
    shown = [
        *(episodes(homes, instr_id) for instr_id in ("1_3_0", "1_3_1", "2_4_0", "2_4_1")),
        *({"": demo.episode(instr_id)} for instr_id in demo.instr_ids[::7]),
    ]
    columns: list[Columns] = [1, 2]
    figures = [figure_svg(each, number, legend=True) for each in shown for number in columns]
    page = new_page(browser)
    page.set_content("".join(figures))
    assert page.evaluate(UNREADABLE) == []
    page.close()


@pytest.mark.parametrize(("columns", "points"), [("1", 237.6), ("2", 496.8)])
def test_formats(columns: str, points: float, run: Run, tmp_path: Path) -> None:
    from PIL import Image

    try:
        import vl_convert  # noqa: F401
    except ModuleNotFoundError:
        unavailable("vl-convert is not installed")
    begin = ["figure", str(SAMPLES / "good.json"), "1196_0_0", "--split", "val_unseen"]
    for suffix in ("svg", "pdf", "png"):
        file = tmp_path / f"figure.{suffix}"
        assert run(*begin, "-o", str(file), "--columns", columns) == (0, "", "")
    assert f'width="{points / 72:.1f}in"' in (tmp_path / "figure.svg").read_text()
    pdf = (tmp_path / "figure.pdf").read_bytes()
    assert f"/MediaBox [0 0 {points} ".encode() in pdf
    assert b"/FontFile2" in pdf
    image = Image.open(BytesIO((tmp_path / "figure.png").read_bytes()))
    assert image.width == pytest.approx(points / 72 * 300, abs=1)


def test_two_methods_by_command(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "both.svg"
    named = [f"{name}={SAMPLES / file}.json" for name, file in (("A", "good"), ("B", "mediocre"))]
    words = ["1196_0_0", "--split", "val_unseen", "--no-legend", "-o", str(file)]
    assert run("figure", *named, *words) == (0, "", "")
    assert texts(file.read_text(), "panel")[1:3] == [
        "A: view from the stop",
        "B: view from the stop",
    ]


@pytest.mark.parametrize(
    ("files", "output", "said"),
    [
        (["good"], "x.jpg", "x.jpg: expected a name that ends in .svg, .pdf or .png"),
        (["good", "mediocre", "drawn"], "x.svg", "a figure shows one or two submissions, got 3"),
        (["A=good", "mediocre"], "x.svg", "one file has a name and another has none"),
        (["A=good", "A=mediocre"], "x.svg", "two methods are named A; give each a name of its own"),
        ([f"{'m' * 40}=good"], "x.svg", f"the name {'m' * 40} is too long for a figure"),
        ([], "x.svg", "name a submission and an episode of it, got 1196_0_0 alone"),
        (["A=good,mediocre"], "x.svg", "A: a figure shows one file of each method, got 2"),
    ],
)
def test_figures_that_cannot_be_drawn(
    files: list[str],
    output: str,
    said: str,
    run: Run,
    tmp_path: Path,
) -> None:
    words = [re.sub("(good|mediocre|drawn)", rf"{SAMPLES}/\1.json", file) for file in files]
    ended = run("figure", *words, "1196_0_0", "--split", "val_unseen", "-o", str(tmp_path / output))
    assert (ended.status, ended.out, list(tmp_path.iterdir())) == (2, "", [])
    assert said in ended.err


def test_different_episodes_are_not_one_figure(
    homes: Mapping[str, rv.Scores], tmp_path: Path
) -> None:
    first, other = homes.values()
    shown = {"a": first.episode("1_3_0"), "b": other.episode("1_3_1")}
    with pytest.raises(rv.ReverieEvalError, match="one episode, got 1_3_0 and 1_3_1"):
        save_figure(shown, tmp_path / "x.svg")
    first.episode("1_3_0").save(tmp_path / "x.svg", columns=1, legend=False)
    assert (tmp_path / "x.svg").exists()
