"""What holds of every page in a real browser, whoever looks, on whatever screen."""

from typing import Any

import pytest

from tests.support.browser import DESKTOP, NARROW, PHONE, OpenPage, serious_violations
from tests.support.demo_site import Site
from tests.support.page_routes import EXAMPLES, Example

KILOBYTE = 1000
MOST_KILOBYTES = 300
"""Of a page with all it asks for, unpacked."""

TOO_WIDE = """width => [...document.querySelectorAll("body *")]
    .filter(each => each.getBoundingClientRect().right > width + 0.5)
    .filter(each => !each.closest(".scroll, pre, svg, .unseen, .skip"))
    .map(each => each.outerHTML.slice(0, 90))"""
"""What reaches over the edge, besides what scrolls in a box of its own."""

every_page = pytest.mark.parametrize("example", EXAMPLES, ids=[each.name for each in EXAMPLES])


@every_page
def test_nobody_is_kept_out(example: Example, site: Site, open_page: OpenPage) -> None:
    """In light and dark, on a desk and on a phone."""
    page = open_page(site, example.path(site), example.who)
    found = {}
    for size in (DESKTOP, PHONE):
        for scheme in ("light", "dark"):
            page.set_viewport_size({"width": size[0], "height": size[1]})
            page.emulate_media(color_scheme=scheme)
            found[size, scheme] = serious_violations(page)
    assert not any(found.values()), found


@every_page
def test_the_page_never_scrolls_sideways(example: Example, site: Site, open_page: OpenPage) -> None:
    page = open_page(site, example.path(site), example.who, NARROW)
    page.wait_for_load_state("networkidle")
    assert page.evaluate("document.documentElement.scrollWidth") == NARROW[0]
    assert page.evaluate(TOO_WIDE, NARROW[0]) == []


@every_page
def test_nothing_moves_for_whoever_wants_stillness(
    example: Example, site: Site, open_page: OpenPage
) -> None:
    page = open_page(site, example.path(site), example.who, reduced_motion="reduce")
    moving = "document.getAnimations().map(each => each.constructor.name)"
    smooth = "getComputedStyle(document.documentElement).scrollBehavior"
    assert page.evaluate(moving) == []
    assert page.evaluate(smooth) == "auto"


@every_page
def test_it_is_light(example: Example, site: Site, open_page: OpenPage) -> None:
    page = open_page(site, "/sign-in", example.who)
    unpacked: list[int] = []

    def add(received: dict[str, Any]) -> None:
        unpacked.append(received["dataLength"])

    wire = page.context.new_cdp_session(page)
    wire.send("Network.enable")
    wire.send("Network.setCacheDisabled", {"cacheDisabled": True})
    wire.on("Network.dataReceived", add)
    page.goto(example.path(site), wait_until="networkidle")
    needed = page.evaluate("performance.getEntriesByType('resource').map(it => it.decodedBodySize)")
    assert sum(unpacked) >= sum(needed) > 0
    assert sum(unpacked) < MOST_KILOBYTES * KILOBYTE
