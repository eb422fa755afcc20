"""Following every link of the pages, as a search engine does."""

import re
from collections.abc import Callable, Iterator
from html import unescape
from urllib.parse import parse_qsl, urljoin, urlsplit

import httpx

LINK = re.compile(r'\s(href|src|action|data-source|data-submission)="([^"]*)"')
_NAMED = re.compile(r"[0-9a-f]{16}|\d+_\d+_\d+|(?<=/)\d+(?=/|$)")
_EXAMPLE = "ID"
"""What a script replaces by a submission's id."""


def links_of(html: str) -> Iterator[tuple[str, str]]:
    """Yield the attribute and the address of every link on a page, also those of its forms."""
    yield from ((name, unescape(link)) for name, link in LINK.findall(html))


def crawl(get: Callable[[str], httpx.Response], start: str) -> Iterator[tuple[str, httpx.Response]]:
    """Yield each address of a server that a link or a redirect leads to, with the reply.

    Of pages that differ only in ids or in the values of their query, one is asked for.
    """
    waiting, seen = [start], {_kind(start)}
    while waiting:
        path = waiting.pop()
        reply = get(path)
        yield path, reply
        found = [reply.headers["location"]] if "location" in reply.headers else []
        if reply.headers.get("content-type", "").startswith("text/html"):
            found += [link for _, link in links_of(reply.text)]
        for link in found:
            address = urljoin(path, link).partition("#")[0]
            is_ours = address.startswith("/") and not address.endswith(f"/{_EXAMPLE}")
            if is_ours and _kind(address) not in seen:
                seen.add(_kind(address))
                waiting.append(address)


def _kind(address: str) -> tuple[str, ...]:
    path, query = urlsplit(address).path, urlsplit(address).query
    return _NAMED.sub("ID", path), *sorted(name for name, _ in parse_qsl(query))
