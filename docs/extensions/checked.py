"""Checks of the built site: links lead somewhere, and nothing is asked of another host.

Sphinx itself checks links between pages that Markdown writes; this also sees what directives, the
theme and notebooks write, as a browser would. Each fault is a warning, and `scripts/docs` makes
warnings errors.
"""

from collections.abc import Iterator, Mapping
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from sphinx.application import Sphinx
from sphinx.util.logging import getLogger

_LOADED = {"script": "src", "img": "src", "iframe": "src", "source": "src", "link": "href"}
"""What a browser fetches by itself."""


class Page(HTMLParser):
    """The links and the anchors of a page."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.anchors = {"", "top"}
        self.links: set[str] = set()
        self.loaded: set[str] = set()
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what an element is called, leads to and loads."""
        given = dict(attrs)
        self.anchors |= {given[name] or "" for name in ("id", "name") if name in given}
        for target in (given.get(_LOADED.get(tag, "")), given.get("href")):
            if target:
                self.links.add(target)
        if given.get(_LOADED.get(tag, "")):
            self.loaded.add(given[_LOADED[tag]] or "")


def faults(site: Path) -> Iterator[str]:
    """Return what is wrong with the links of a site, a sentence each."""
    pages = {path: Page(path.read_text(encoding="utf-8")) for path in site.rglob("*.html")}
    for path, page in sorted(pages.items()):
        here = path.relative_to(site)
        for link in sorted(page.links):
            address = urlsplit(link)
            if address.scheme == "data":
                continue
            if address.scheme or address.netloc:
                if link in page.loaded:
                    yield f"{here} loads {link} from another host"
                continue
            target = (path.parent / unquote(address.path)).resolve() if address.path else path
            if address.path.startswith("/"):
                yield f"{here} links to {link}, which depends on where the site is"
            elif not target.exists():
                yield f"{here} links to {link}, which does not exist"
            elif target in pages and unquote(address.fragment) not in pages[target].anchors:
                yield f"{here} links to {link}, whose anchor does not exist"


def _check(app: Sphinx, failure: Exception | None) -> None:
    if failure is None:
        for fault in faults(Path(app.outdir).resolve()):
            getLogger(__name__).warning(fault, type="links")


def setup(app: Sphinx) -> Mapping[str, Any]:
    """Check the site when it is built."""
    app.connect("build-finished", _check, priority=999)  # after others have written their files
    return {"parallel_read_safe": True, "parallel_write_safe": True}
