"""What holds of every page in a real browser, whoever looks, on whatever screen."""

from typing import Any

import pytest
from playwright.sync_api import Page

from tests.support.browser import NARROW, OpenPage, barriers
from tests.support.demo_site import Site
from tests.support.page_routes import EXAMPLES, Example

KILOBYTE = 1000
MOST_KILOBYTES = 300
"""Of a page with all it asks for, unpacked."""

MOVING = "document.getAnimations().map(each => each.constructor.name)"
SCROLLS = "getComputedStyle(document.documentElement).scrollBehavior"
"""What people see who want stillness."""

every_page = pytest.mark.parametrize("example", EXAMPLES, ids=[each.name for each in EXAMPLES])


@every_page
def test_a_page_serves_everybody(example: Example, site: Site, open_page: OpenPage) -> None:
    """Each page is loaded once, which takes longer than all that is checked of it."""
    page = open_page(site, "/sign-in", example.who, NARROW, reduced_motion="reduce")
    unpacked = bytes_received(page)
    page.goto(example.path(site))
    assert page.evaluate(MOVING) == []
    assert page.evaluate(SCROLLS) == "auto"
    assert barriers(page) == {}
    page.wait_for_load_state("networkidle")
    needed = page.evaluate("performance.getEntriesByType('resource').map(it => it.decodedBodySize)")
    assert sum(unpacked) >= sum(needed) > 0
    assert sum(unpacked) < MOST_KILOBYTES * KILOBYTE


def bytes_received(page: Page) -> list[int]:
    """Return the sizes of what the page receives from now on, unpacked and not from a cache."""
    unpacked: list[int] = []

    def add(received: dict[str, Any]) -> None:
        unpacked.append(received["dataLength"])

    wire = page.context.new_cdp_session(page)
    wire.send("Network.enable")
    wire.send("Network.setCacheDisabled", {"cacheDisabled": True})
    wire.on("Network.dataReceived", add)
    return unpacked
