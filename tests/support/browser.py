"""A real Chromium before a real server, and an ear on all that the browser complains of."""

import json
import shutil
from asyncio import AbstractEventLoop, get_running_loop
from asyncio.events import _set_running_loop as set_running_loop
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from re import Pattern
from typing import Any, NamedTuple

import pytest
from playwright.sync_api import (
    Browser,
    BrowserContext,
    ConsoleMessage,
    Locator,
    Page,
    Request,
    Response,
    Route,
    expect,
    sync_playwright,
)

from fixtures.servers import make_folder
from tests.conftest import unavailable
from tests.support.demo_site import Site, furnish
from tests.support.serving import OPEN, add_boards, running
from tests.support.sharing import shared_folder
from tests.support.waiting import SELDOM, wait_until

CHROMIUM_NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
"""The first is the same browser without windows; it takes half of the processor time."""
MILLISECONDS = 120_000
"""That a page has for what is waited for."""
expect.set_options(timeout=MILLISECONDS)

FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--js-flags=--single-threaded --no-opt --min-semi-space-size=64 --max-semi-space-size=64",
)
"""Nothing of the browser's own goes out; in a container it has no right to a sandbox. No page lives
as long as it takes to make its scripts fast."""
Size = tuple[int, int]
PHONE, DESKTOP, NARROW, WIDE = (375, 812), (1280, 900), (320, 640), (1920, 1080)
TABLETS = (768, 1024), (1024, 768)
UNLIMITED = {"REVERIE_EVAL_LIMITS__REQUESTS_PER_MINUTE": "1000000"}
_FAULT = 500
_REFUSED = 400


def chromium_path() -> str | None:
    """Return where a Chromium is, if there is any."""
    return next(filter(None, map(shutil.which, CHROMIUM_NAMES)), None)


@contextmanager
def browsing(chromium: str) -> Iterator[Browser]:
    """Run a browser until the end."""
    with sync_playwright() as engine:
        browser = engine.chromium.launch(executable_path=chromium, args=FLAGS)
        yield browser
        browser.close()


@contextmanager
def demo_site(folder: Path) -> Iterator[Site]:
    """Run a server with the demo world's people until the end."""
    make_folder(folder)
    add_boards(folder, OPEN)
    with running(folder, **UNLIMITED) as (_, url):
        yield furnish(url, folder)


@contextmanager
def copied_site(site: Site, folder: Path, **environment: str) -> Iterator[Site]:
    """Run a copy of a server that has stopped until the end."""
    shutil.copytree(site.folder, folder)
    with running(folder, **UNLIMITED, **environment) as (_, url):
        yield replace(site, url=url, folder=folder)


class Ear:
    """Hears what should not happen in a browser."""

    def __init__(self, url: str, context: BrowserContext) -> None:
        self._url = url
        self.complaints: list[str] = []
        context.on("console", self._on_console)
        context.on("weberror", lambda error: self.complaints.append(f"error: {error.error}"))
        context.on("request", self._on_request)
        context.on("response", self._on_response)
        context.on("dialog", lambda dialog: self.complaints.append(f"dialog: {dialog.message}"))

    def _on_console(self, message: ConsoleMessage) -> None:
        # That a page was refused is heard from the reply, where a refusal may be what is expected.
        is_refusal = message.text.startswith("Failed to load resource")
        if message.type in ("error", "warning") and not is_refusal:
            self.complaints.append(f"{message.type}: {message.text}")

    def _on_request(self, request: Request) -> None:
        if not request.url.startswith((f"{self._url}/", "data:", "blob:")):
            self.complaints.append(f"goes elsewhere: {request.url}")

    def _on_response(self, reply: Response) -> None:
        is_asked_for = reply.request.resource_type in ("document", "fetch", "xhr")
        if reply.status >= (_FAULT if is_asked_for else _REFUSED):
            self.complaints.append(f"{reply.status}: {reply.url}")


OpenPage = Callable[..., Page]


def await_chart(page: Page, name: str) -> Locator:
    """Wait until a chart is drawn, and return it."""
    chart = page.locator(f"#{name}")
    expect(chart.locator(".axis-x")).to_have_count(1)
    return chart


@pytest.fixture(scope="session")
def chromium() -> str:
    """Return where a Chromium is."""
    return chromium_path() or unavailable("there is no Chromium here")


@pytest.fixture(scope="session")
def running_browser(chromium: str) -> Iterator[tuple[Browser, AbstractEventLoop]]:
    """Run a browser, whose event loop is at rest but for the modules that use it."""
    with browsing(chromium) as browser:
        loop = get_running_loop()
        yield browser, loop
        set_running_loop(loop)


@pytest.fixture(scope="module")
def browser(running_browser: tuple[Browser, AbstractEventLoop]) -> Iterator[Browser]:
    """Return the browser; its event loop would keep tests of other modules from having theirs."""
    browser, loop = running_browser
    set_running_loop(loop)
    yield browser
    for context in browser.contexts:
        context.close()
    set_running_loop(None)


@pytest.fixture(scope="session")
def stopped_site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    """Furnish a server once, and stop it; tests run copies."""

    def make(folder: Path) -> None:
        with demo_site(folder / "server") as site:
            (folder / "site.json").write_text(json.dumps([site.tokens, [*site.ids.items()]]))

    folder = shared_folder(tmp_path_factory, "stopped_site", make)
    tokens, ids = json.loads((folder / "site.json").read_text())
    return Site("", folder / "server", tokens, {tuple(method): id_ for method, id_ in ids})


@pytest.fixture(scope="session")
def site(stopped_site: Site, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """Run a server that tests look at and do not change."""
    with copied_site(stopped_site, tmp_path_factory.mktemp("site") / "server") as site:
        yield site


@pytest.fixture
def own_site(stopped_site: Site, tmp_path: Path) -> Iterator[Site]:
    """Run a server of this test's own."""
    with copied_site(stopped_site, tmp_path / "server") as site:
        yield site


@pytest.fixture
def open_page(browser: Browser) -> Iterator[OpenPage]:
    """Return what opens a window on a site, as somebody, and fails the test on any complaint."""
    opened: list[tuple[BrowserContext, Ear]] = []

    def open_page(
        site: Site,
        path: str = "/",
        who: str | None = None,
        size: tuple[int, int] = DESKTOP,
        **of: Any,
    ) -> Page:
        context = new_context(browser, site, size, **of)
        opened.append((context, Ear(site.url, context)))
        if who is not None:
            context.request.post("/sign-in", form={"token": site.tokens[who]})
        page = context.new_page()
        page.goto(path)
        return page

    yield open_page
    complaints = [complaint for _, ear in opened for complaint in ear.complaints]
    for context, _ in opened:
        context.close()
    assert complaints == []


def new_page(browser: Browser, **of: Any) -> Page:
    """Open a window that is on no site."""
    page = browser.new_page(**of)
    page.set_default_timeout(MILLISECONDS)
    return page


def new_context(browser: Browser, site: Site, size: Size, **of: Any) -> BrowserContext:
    """Open a window of this width and height, with nothing kept from others."""
    width, height = size
    viewport = {"width": width, "height": height}
    context = browser.new_context(base_url=site.url, viewport=viewport, **of)  # type: ignore[arg-type]
    context.set_default_timeout(MILLISECONDS)
    context.add_init_script(ADD_UP_SHIFTS)
    return context


class Cost(NamedTuple):
    """What a page costs who looks at it."""

    kilobytes: float
    """With all that it asks for, unpacked."""
    requests: int
    shift: float
    """How much of the window moved while the page came, and how far (Cumulative Layout Shift)."""


MOST = Cost(300, 10, 0.02)
"""What any page may cost."""
ADD_UP_SHIFTS = """window.shift = 0;
new PerformanceObserver(list => {
    for (const each of list.getEntries()) if (!each.hadRecentInput) window.shift += each.value;
}).observe({ type: "layout-shift", buffered: true });"""
COST = """() => {
    const all = ["navigation", "resource"].flatMap(kind => performance.getEntriesByType(kind));
    const bytes = all.reduce((sum, { decodedBodySize }) => sum + decodedBodySize, 0);
    return [bytes / 1000, all.length, window.shift];
}"""


def cost_of(page: Page) -> Cost:
    """Measure a page that has come."""
    page.wait_for_load_state("networkidle")
    return Cost(*page.evaluate(COST))


def exceeded(cost: Cost) -> Sequence[str]:
    """Return what a page costs too much of."""
    pairs = zip(Cost._fields, cost, MOST, strict=True)
    return [f"{name}: {found:g} of {most:g}" for name, found, most in pairs if found > most]


def reload_until_ready(page: Page) -> None:
    """Load a page again until the server has computed what it shows, as the page says to do."""

    def is_ready() -> bool:
        if not page.get_by_role("link", name="Reload this page").count():
            return True
        page.reload()
        return False

    wait_until(is_ready, SELDOM)


def show_part(page: Page, path: str, part: str) -> None:
    """Show so much of a page as has arrived, under the policy of all pages."""
    page.unroute_all()
    page.route(f"**{path}", lambda route: route.fulfill(response=route.fetch(), body=part))
    page.goto(path)


class Held:
    """Requests of a page that are held back, as a slow network does, until they are let go."""

    def __init__(self, page: Page, url: str | Pattern[str]) -> None:
        self._page = page
        self._routes: list[Route] = []

        def hold(route: Route) -> None:
            self._routes.append(route)

        page.route(url, hold)

    def first(self) -> Route:
        """Wait for the first one, which is still held."""
        for _ in range(0, MILLISECONDS, 10):
            if self._routes:
                return self._routes.pop(0)
            self._page.wait_for_timeout(10)
        raise AssertionError("nothing is asked for")


def sign_in(page: Page, token: str) -> None:
    """Sign in as people do."""
    page.goto("/sign-in")
    page.get_by_label("Token", exact=True).fill(token)
    page.get_by_role("main").get_by_role("button", name="Sign in", exact=True).click()
    page.wait_for_url(lambda url: "/sign-in" not in url)


TOO_WIDE = """width => [...document.querySelectorAll("body *")]
    .filter(each => each.getBoundingClientRect().right > width + 0.5)
    .filter(each => !each.closest(".scroll, pre, svg, .unseen, .skip"))
    .map(each => each.outerHTML.slice(0, 90))"""
"""What reaches over the edge, besides what scrolls in a box of its own."""
SIDEWAYS = """() => [...document.querySelectorAll(".scroll:has(> table:not(.board))")]
    .filter(each => each.scrollWidth > each.clientWidth)
    .map(each => `${each.scrollWidth - each.clientWidth} px: ${each.outerHTML.slice(0, 150)}`)"""
"""Tables with columns out of sight, besides leaderboards, whose names stay where they are."""
AXE = """rules => axe.run({
    rules: { "target-size": { enabled: true } },
    ...(rules && { runOnly: rules }),
    resultTypes: ["violations"],
    preload: false,
})"""
"""What is in order is not described at length. Nothing is loaded in advance: that is for a rule on
sound that plays by itself, whose findings are moderate."""
PARSE_COLOURS_ONCE = """() => {
    const color = axe.commons.color.Color.prototype, parse = color.parseString, parsed = new Map();
    color.parseString = function (text) {
        if (parsed.has(text)) return Object.assign(this, parsed.get(text));
        const { r, g, b, alpha } = parse.call(this, text);
        parsed.set(text, { r, g, b, alpha });
        return this;
    };
}"""
"""Otherwise axe parses the same few colours again for each text and all that is behind it, which
takes a third of its time."""
WITHOUT_SHADOWS = """() => {
    for (const each of document.querySelectorAll(".scroll")) each.style.background = "none";
}"""
"""Axe says nothing of the contrast of texts above gradients."""
SERIOUS_ALONE = """() => {
    axe._audit.rules = axe._audit.rules.filter(({ impact }) => /serious|critical/.test(impact));
}"""
"""The findings of other rules keep nobody out; they take a fifth of the time."""
OF_COLOURS = ["color-contrast", "link-in-text-block"]
"""The rules whose outcome depends on the colours."""


@cache
def _axe() -> str:
    return files("axe_playwright_python").joinpath("axe.min.js").read_text()


def barriers(page: Page) -> Mapping[str, Sequence[str]]:
    """Return what keeps people out: on a desktop, tablets, a phone, and the narrowest screen.

    No colour depends on the width (``tests/browser/test_styles.py``): light ones are looked at on
    the desktop, dark ones on the phone.
    """
    found: dict[str, list[str]] = {}
    page.set_viewport_size({"width": NARROW[0], "height": NARROW[1]})
    scrolls = page.evaluate("document.documentElement.scrollWidth") > NARROW[0]
    found["too wide"] = ["the page scrolls"] * scrolls + page.evaluate(TOO_WIDE, NARROW[0])
    for width, height in TABLETS:
        page.set_viewport_size({"width": width, "height": height})
        found[f"sideways at {width}"] = page.evaluate(SIDEWAYS)
    for (width, height), scheme in ((DESKTOP, "light"), (PHONE, "dark")):
        page.set_viewport_size({"width": width, "height": height})
        page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
        found[f"sideways at {width}"] = page.evaluate(SIDEWAYS)
        found[f"{width} {scheme}"] = serious_violations(page)
    return {where: what for where, what in found.items() if what}


def serious_violations(page: Page, rules: Sequence[str] | None = None) -> list[str]:
    """Return what axe finds that keeps people out: the rule, and where.

    All rules are checked unless some are given.

    References
    ----------
    axe-core 4.12 (Deque Systems), which comes with the package axe-playwright-python.
    """
    if not page.evaluate("'axe' in window"):
        page.evaluate(_axe())
        page.evaluate(WITHOUT_SHADOWS)
        page.evaluate(PARSE_COLOURS_ONCE)
        page.evaluate(SERIOUS_ALONE)
    found = page.evaluate(AXE, rules)["violations"]
    return [
        f"{each['id']}: {each['help']}: {node['target']} {node.get('failureSummary', '')}"
        for each in found
        for node in each["nodes"]
    ]
