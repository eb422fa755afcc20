"""The page of one episode: its map, its walks step by step, and the way to the next."""

import json
import re
from html import unescape
from pathlib import Path
from urllib.parse import parse_qsl, urlsplit
from xml.etree import ElementTree as ET

import html5lib
import numpy as np
import pytest
from PIL import Image

import reverie_eval as rv
from reverie_eval.ground_truth import Bundle, pack_texts
from reverie_eval.reporting.skyboxes import PANORAMAS_VARIABLE
from tests.support.episode_pages import drawn, linked, listed, picture, send, visitor, walks
from tests.support.home_world import OTHER_WALKS
from tests.support.serving import (
    OPEN,
    OWNER,
    PRIVATE,
    OpenServer,
    Serving,
    adjusted,
    settings_of,
)
from tests.support.visiting import said, signed_in

MARKUP = '<script>alert("x")</script> & <b>lamp</b>'


def test_next_and_previous_stay_within_what_was_chosen(
    home: Serving, submission: str, other: str
) -> None:
    browser = signed_in(home, OWNER)
    order = listed(browser.get(f"/episodes/{OPEN}?submission={other}&outcome=never reached"))
    assert sorted(order) == ["1_3_0", "2_4_0"]
    query = {"submission": other, "outcome": "never reached"}
    page = browser.get(f"/episodes/{OPEN}/{order[0]}?submission={other}&outcome=never reached")
    following = urlsplit(linked(page, "next"))
    assert (following.path, dict(parse_qsl(str(following.query)))) == (
        f"/episodes/{OPEN}/{order[1]}",
        query,
    )
    assert linked(page, "prev") is None
    assert "1 of 2" in said(page)
    last = browser.get(str(linked(page, "next")))
    assert (linked(last, "next"), "2 of 2" in said(last)) == (None, True)
    assert urlsplit(linked(last, "prev")).path == f"/episodes/{OPEN}/{order[0]}"


def test_from_an_episode_that_was_not_chosen_one_comes_to_the_nearest(
    home: Serving, submission: str
) -> None:
    ids = home.state.boards[OPEN].truth.episodes.instr_ids
    page = signed_in(home, OWNER).get(f"/episodes/{OPEN}/{ids[2]}?text={ids[3]}")
    assert urlsplit(linked(page, "next")).path == f"/episodes/{OPEN}/{ids[3]}"
    assert (linked(page, "prev"), "not in the filtered list" in said(page)) == (None, True)


def test_a_walk_is_drawn_and_told(home: Serving, submission: str) -> None:
    page = signed_in(home, OWNER).get(f"/episodes/{OPEN}/2_4_0?submission={submission}")
    svg, text = picture(page), said(page)
    assert [each.get("data-leg") for each in drawn(svg, "leg")] == ["1", "2"]
    kinds = ("start", "end", "stop", "goal", "viewpoint")
    assert [len(drawn(svg, kind)) for kind in kinds] == [
        1,
        1,
        1,
        2,
        len(svg.findall(".//*[@data-viewpoint]")) - 5,
    ]
    assert drawn(svg, "stop")[0].findtext("title") == "stop of Walker: porch"
    rows = re.findall(r'<tr data-step="\d+" data-facing="\d+">(.*?)</tr>', page.text)
    cells = [
        [unescape(cell) for cell in re.findall(r">([^<>]*)</(?:td|th|code)>", row)] for row in rows
    ]
    assert [[cell for cell in row if cell] for row in cells] == [
        ["0", "porch", "start", "0.0", "4.0", "10.0", "2", "180°"],
        ["1", "room", "goal viewpoint", "4.0", "0.0", "6.0", "2", "0°"],
        ["2", "porch", "stop", "8.0", "4.0", "10.0", "2", "0°"],
    ]
    assert "overshot" in text
    assert "walked 8.0 m, shortest 10.0 m; stopped 10.0 m from the path's end" in text


@pytest.mark.parametrize(
    ("who", "instr_id", "headings"),
    [
        pytest.param(OWNER, "1_3_0", ["Answer: Walker"], id="target visible"),
        pytest.param(OWNER, "2_4_0", ["Answer: Walker", "Where the target is"], id="not visible"),
        pytest.param(None, "2_4_0", ["Where the target is"], id="annotations only"),
    ],
)
def test_the_answer_is_drawn(
    who: str | None, instr_id: str, headings: list[str], home: Serving, submission: str
) -> None:
    query = f"?submission={submission}" if who else ""
    page = visitor(home, who).get(f"/episodes/{OPEN}/{instr_id}{query}")
    html = html5lib.parse(page.text, namespaceHTMLElements=False)
    figures = html.findall(".//div[@class='answers']/figure")
    titles = [title for each in figures for title in each.findall("h2")]
    assert [" ".join("".join(title.itertext()).split()) for title in titles] == headings
    captions = [each.findtext("figcaption") for each in figures]
    assert len(re.findall('<svg class="answer-view', page.text)) == len(headings)
    assert all(captions)


def test_photographs_lie_under_the_boxes_if_the_operator_has_them(
    home: Serving, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    images = tmp_path / "photographs" / "home" / "matterport_skybox_images"
    images.mkdir(parents=True)
    mottled = Image.effect_noise((6 * 128, 128), 60).resize((6 * 512, 512)).convert("RGB")
    mottled.save(images / "room_skybox_small.jpg")
    browser, path = visitor(home, None), f"/episodes/{OPEN}/1_3_0"
    assert "<image " not in browser.get(path).text
    monkeypatch.setenv(PANORAMAS_VARIABLE, str(tmp_path / "photographs"))
    page = browser.get(path)
    assert page.text.count('<image width="400"') == 2  # the view and the panorama
    assert "img-src 'self' data:" in page.headers["content-security-policy"]
    assert len(page.content) < 300_000 / 3  # at most two answers and the target are shown


@pytest.mark.parametrize(
    ("split", "instr_id", "query", "shown"),
    [
        (OPEN, "1_3_0", "viewpoint=room&heading=355", "heading 0°, level. The target is object 3"),
        (OPEN, "1_3_0", "viewpoint=room&heading=90", "visible from here, but not in this view."),
        (OPEN, "1_3_0", "viewpoint=hall&heading=90", "heading 90°, level. 1 object is visible"),
        (OPEN, "1_3_0", "viewpoint=attic&heading=90", "here is no viewpoint"),
        (OPEN, "1_3_9", "viewpoint=hall&heading=90", "here is no episode"),
        (OPEN, "1_3_0", "viewpoint=hall&heading=360", "less than 360"),
        (PRIVATE, "1_3_0", "viewpoint=hall&heading=90", "those of private splits never leave the"),
    ],
)
def test_what_is_seen_on_the_way(
    split: str, instr_id: str, query: str, shown: str, home: Serving
) -> None:
    reply = home.client.get(f"/episodes/{split}/{instr_id}/view?{query}")
    assert shown in reply.text
    if reply.is_success:
        assert reply.headers["content-type"] == "image/svg+xml"
        svg = ET.fromstring(reply.text)  # by itself: it has its style
        assert svg.get("viewBox") == "0 0 400 457"


def test_an_agent_looks_where_its_file_says(home: Serving) -> None:
    turned = json.loads(walks())
    for record in turned:
        record["trajectory"] = [[place, 1.0, 0.0] for place, *_ in record["trajectory"]]
    id_ = send(home, json.dumps(turned).encode())
    page = signed_in(home, OWNER).get(f"/episodes/{OPEN}/2_4_0?submission={id_}")
    assert re.findall(r'data-label="facing">(\d+°)</td></tr>', page.text) == ["57°"] * 3


def test_an_episode_s_metrics_are_yes_or_no(home: Serving, submission: str) -> None:
    page = signed_in(home, OWNER).get(f"/episodes/{OPEN}/1_3_1?submission={submission}")
    rows = dict(
        re.findall(r'<th scope="row" title[^>]*>([^<]*)</th><td class="number">([^<]*)<', page.text)
    )
    assert (rows["SR"], rows["RGS"], rows["SPL %"]) == ("yes", "no", "59.97")


def test_two_walks_on_one_map(home: Serving, submission: str, other: str) -> None:
    page = signed_in(home, OWNER).get(
        f"/episodes/{OPEN}/1_3_0?submission={submission}&other={other}"
    )
    svg = picture(page)
    legs = [(leg.get("data-route"), leg.get("data-leg")) for leg in drawn(svg, "leg")]
    assert legs == [("1", "1"), ("2", "1"), ("2", "2")]
    assert (
        "The agent of Walker makes 1 move; correct. The agent of Other makes 2 moves; never "
        "reached; stopped on level 1, the path ends on level 2." in str(svg.findtext("desc"))
    )
    assert [leg.get("data-levels") for leg in drawn(svg, "leg")] == ["2", "2", "1 2"]


def test_the_same_twice_is_one(home: Serving, submission: str) -> None:
    query = f"submission={submission}&other={submission}"
    page = signed_in(home, OWNER).get(f"/episodes/{OPEN}/1_3_0?{query}")
    assert len(drawn(picture(page), "stop")) == 1


def test_equal_names_are_told_apart(home: Serving, submission: str) -> None:
    again = send(home, walks(OTHER_WALKS))
    page = signed_in(home, OWNER).get(
        f"/episodes/{OPEN}/1_3_0?submission={submission}&other={again}"
    )
    assert f"Walker ({submission})" in said(page)
    assert f"Walker ({again})" in said(page)


@pytest.mark.parametrize("instr_id", ["no-such", "1_3_00", "%00", "1_3_0%20", "..%2fval_seen"])
def test_an_unknown_episode(instr_id: str, home: Serving, submission: str) -> None:
    for query in ("", f"?submission={submission}"):
        reply = signed_in(home, OWNER).get(f"/episodes/{OPEN}/{instr_id}{query}")
        assert (reply.status_code, "<h1>Not found</h1>" in reply.text) == (404, True)


@pytest.mark.parametrize("id_", ["0123456789abcdef", "%00", "'", "../x", "ünknown"])
def test_an_unknown_submission(id_: str, home: Serving) -> None:
    browser = signed_in(home, OWNER)
    for name in ("submission", "other"):
        assert browser.get(f"/episodes/{OPEN}?{name}={id_}").status_code == 404
        assert browser.get(f"/episodes/{OPEN}/1_3_0?{name}={id_}").status_code == 404


def test_what_others_wrote_is_escaped(open_server: OpenServer, folder: Path) -> None:
    """Instruction, category, ids and the method's name, each with markup in it."""
    path = folder / "bundles" / f"{OPEN}.npz"
    bundle = Bundle.load(path)
    truth = rv.GroundTruth.load(path)
    texts = {
        **bundle.texts,
        "instruction": pack_texts([MARKUP] * len(truth.episodes.instr_ids)),
        "target_category": pack_texts([MARKUP] * (len(truth.require_solution().path_offsets) - 1)),
    }
    ids = bundle.arrays["instr_id"].astype("<U99")
    marked = {**bundle.arrays, "instr_id": np.append("<i>é&?#'\"", ids[1:])}
    origin = bundle.header.split, bundle.header.dataset, bundle.header.sources
    Bundle.build(*origin, marked, bundle.other_splits, texts=texts).save(path)
    server = open_server()
    sent = json.loads(server.distinct())
    for record in sent:
        if record["instr_id"] == ids[0]:
            record["instr_id"] = "<i>é&?#'\""
    id_ = send(server, json.dumps(sent).encode(), name=MARKUP)
    browser = signed_in(server, OWNER)
    first = browser.get(f"/episodes/{OPEN}?submission={id_}")
    link = re.search(r'<th scope="row"><a href="([^"]*)">&lt;i&gt;', first.text)
    assert link
    for page in (first, browser.get("/episodes"), browser.get(unescape(link[1]))):
        assert page.status_code == 200
        assert "<script>alert" not in page.text
        assert "<b>lamp" not in page.text
        assert "<i>" not in page.text
        html5lib.HTMLParser(strict=True).parse(page.text)


def test_nothing_is_written_in_the_page_that_styles(
    home: Serving, submission: str, other: str
) -> None:
    page = signed_in(home, OWNER).get(
        f"/episodes/{OPEN}/1_3_0?submission={submission}&other={other}"
    )
    assert not re.search(r"<style|\sstyle=|\son[a-z]+=", page.text)
    sheet = re.search(r'href="(/static/map\.css\?\w+)"', page.text)
    assert sheet
    assert ".episode-map .route-1" in home.client.get(sheet[1]).text


def test_a_protocol_without_outcomes(open_server: OpenServer, folder: Path) -> None:
    """R2R's does not score what is named, so there is nothing to tell apart by."""
    server = open_server(adjusted(settings_of(folder), OPEN, protocol="r2r-style"))
    id_ = send(server, server.distinct())
    browser = signed_in(server, OWNER)
    page = browser.get(f"/episodes/{OPEN}?submission={id_}")
    assert 'id="outcomes"' not in page.text
    assert listed(browser.get(f"/episodes/{OPEN}?submission={id_}&outcome=correct")) == []
    assert browser.get(f"/episodes/{OPEN}/1196_0_0?submission={id_}").status_code == 200
