"""The documentation site: from each page, a reader finds the other versions, without a server."""

import runpy
import sys
from pathlib import Path
from shutil import copytree
from subprocess import run

import pytest
from playwright.sync_api import Page, expect

from tests.conftest import REPOSITORY
from tests.support.browser import DESKTOP, OF_COLOURS, PHONE, OpenPage, Size, serious_violations
from tests.support.demo_site import Site

DOCS = REPOSITORY / "docs"
INDEX = "# Start\n\n```{toctree}\nguide/old\nguide/new\n```\n"


@pytest.fixture(scope="module")
def versions(tmp_path_factory: pytest.TempPathFactory) -> Site:
    """Build a small site like ours, as three versions; the oldest lacks a page."""
    folder = tmp_path_factory.mktemp("versions")
    source, site = folder / "source", folder / "a site"
    (source / "guide").mkdir(parents=True)
    (source / "index.md").write_text(INDEX)
    (source / "guide" / "old.md").write_text("# Old\n")
    (source / "guide" / "new.md").write_text("# New\n")
    build = [sys.executable, "-m", "sphinx", "--quiet", "--fail-on-warning", f"--conf-dir={DOCS}"]
    run([*build, str(source), str(folder / "built")], check=True)
    for name in ("0.9.0", "0.10.0", "latest"):
        copytree(folder / "built", site / name)
    (site / "0.9.0" / "guide" / "new.html").unlink()
    runpy.run_path(str(DOCS / "versions.py"))["list_versions"](site)
    return Site(site.as_uri(), site, {}, {})


def opened_menu(page: Page, size: Size) -> list[tuple[str, str]]:
    """Open the menu of versions, and return its names and where each leads."""
    if size == PHONE:
        page.locator("label.nav-overlay-icon").click()
    page.get_by_text("Version: ").click()
    links = page.locator("details.versions a")
    expect(links.first).to_be_visible()
    return [(each.inner_text(), each.evaluate("link => link.href")) for each in links.all()]


@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_a_page_leads_to_itself_in_other_versions(
    versions: Site, open_page: OpenPage, size: Size
) -> None:
    page = open_page(versions, f"{versions.url}/0.10.0/guide/new.html?q=x#new", size=size)
    assert opened_menu(page, size) == [
        ("latest", f"{versions.url}/latest/guide/new.html"),
        ("0.10.0", f"{versions.url}/0.10.0/guide/new.html"),
        ("0.9.0", f"{versions.url}/0.9.0/index.html"),  # which has no such page
    ]
    expect(page.locator("details.versions [aria-current]")).to_have_text("0.10.0")
    expect(page.get_by_text("The newest release is")).to_have_count(0)
    assert serious_violations(page, ["target-size", *OF_COLOURS]) == []


@pytest.mark.parametrize(
    ("version", "what"), [("latest", "the version in development"), ("0.9.0", "version 0.9.0")]
)
def test_a_page_of_another_version_names_the_newest_release(
    versions: Site, open_page: OpenPage, version: str, what: str
) -> None:
    page = open_page(versions, f"{versions.url}/{version}/guide/old.html")
    note = page.get_by_text(f"This page is about {what}. The newest release is 0.10.0.")
    note.get_by_role("link").click()
    page.wait_for_url(f"{versions.url}/0.10.0/guide/old.html")


def test_the_site_opens_at_the_newest_release(versions: Site, open_page: OpenPage) -> None:
    page = open_page(versions, f"{versions.url}/index.html")
    page.wait_for_url(f"{versions.url}/0.10.0/index.html")
    expect(page.get_by_role("heading", name="Start")).to_be_visible()


def test_a_version_alone_has_no_menu(versions: Site, open_page: OpenPage, tmp_path: Path) -> None:
    copytree(versions.folder / "0.9.0", tmp_path / "docs")
    site = Site(tmp_path.as_uri(), tmp_path, {}, {})
    page = open_page(site, f"{site.url}/docs/index.html")
    expect(page.get_by_role("heading", name="Start")).to_be_visible()
    expect(page.get_by_text("Version: ")).to_have_count(0)
