"""The public pages as files, opened in a browser without any server."""

import re
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from urllib.parse import urlsplit
from urllib.request import url2pathname

import pytest
from playwright.sync_api import expect

from reverie_eval.server.platforms.site import export_site
from tests.support.browser import PHONE, OpenPage, await_chart, serious_violations
from tests.support.demo_site import OPEN, Site


@pytest.fixture(scope="module")
def copy(stopped_site: Site, tmp_path_factory: pytest.TempPathFactory) -> Site:
    """Copy the pages of the demo site."""
    folder = tmp_path_factory.mktemp("copy") / "site"
    export_site(stopped_site.folder, folder)
    return replace(stopped_site, url=folder.as_uri())


def test_it_is_sorted_and_drawn_without_a_server(copy: Site, open_page: OpenPage) -> None:
    page = open_page(copy, f"{copy.url}/index.html")
    page.get_by_role("navigation", name="Main").get_by_role("link", name=OPEN).click()
    page.get_by_role("link", name=re.compile("^SPL")).click()
    page.wait_for_url("**metric=spl.html")  # and its style sheet, which hides another such header
    header = page.get_by_role("columnheader", name=re.compile("^SPL"))
    expect(header).to_have_attribute("aria-sort", "descending")
    await_chart(page, "against").locator(".front a").first.click()
    page.wait_for_url(re.compile(r"/submissions/[0-9a-f]{16}\.html$"))
    expect(page.get_by_role("heading", name="Scores")).to_be_visible()


def test_it_is_read_and_sorted_without_scripts(copy: Site, open_page: OpenPage) -> None:
    page = open_page(copy, f"{copy.url}/splits/{OPEN}.html", java_script_enabled=False)
    page.get_by_role("link", name=re.compile("^SR")).click()
    page.wait_for_url("**metric=success.html")
    header = page.get_by_role("columnheader", name=re.compile("^SR"))
    expect(header).to_have_attribute("aria-sort", "descending")


@pytest.fixture
def hosted(copy: Site) -> Iterator[Site]:
    """Serve the copy below a path, as any web host does."""
    folder = Path(url2pathname(urlsplit(copy.url).path))
    handler = partial(SimpleHTTPRequestHandler, directory=folder.parent)
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield replace(copy, url=f"http://127.0.0.1:{server.server_port}/{folder.name}")
        server.shutdown()


@pytest.mark.parametrize("name", ["index.html", "guide/submitting.html"])
def test_nobody_is_kept_out_of_it(name: str, hosted: Site, open_page: OpenPage) -> None:
    page = open_page(hosted, f"{hosted.url}/{name}", size=PHONE)
    assert serious_violations(page) == []
    assert page.evaluate("document.documentElement.scrollWidth") == PHONE[0]
