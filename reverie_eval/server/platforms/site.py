"""A server's public pages as files that need no server: to publish, to keep, to cite.

The pages are the application's own. It runs on a copy of the rows at one moment, in this process,
and a visitor who is not signed in follows every link from the first page. So the files can contain
only what everybody may see, and a new public page is in them without a change here. Of thousands of
pages of episodes, they have what other pages name, such as near misses, and those of buildings.
"""

import asyncio
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from http import HTTPStatus
from os.path import relpath
from pathlib import Path, PurePosixPath
from urllib.parse import urljoin, urlsplit

import httpx

from reverie_eval.errors import ReverieEvalError
from reverie_eval.files import replacing_folder
from reverie_eval.server.app import create_app, jobs_of
from reverie_eval.server.http.rendering import links_of, with_links
from reverie_eval.server.operations.restore import copied_server
from reverie_eval.server.state import ServerState
from reverie_eval.version import __version__

_SOFTWARE = "reverie-eval"
_ORIGIN = "http://copy.invalid"
"""The address that the application appears to have; the name cannot exist (RFC 6761)."""
_EPISODES = "/episodes/"
_OVERVIEW = re.compile(r"/episodes/[^/?]+(\?scan=[^&]+)?")
"""A split, and a building."""
_EXAMPLE = "/submissions/ID"
"""Not a page: scripts replace the id."""
_PAGE = "text/html"
_SUFFIXES = {_PAGE: ".html", "application/json": ".json", "text/plain": ".txt"}
_COPY = "copy.json"
"""What the folder is a copy of; it marks a folder that a new copy may replace."""
_SENDING_FORM = re.compile(r'<form\b[^>]* method="post"')


@dataclass(frozen=True, slots=True)
class SiteReport:
    """A site that was written."""

    files: int
    size: int
    """Bytes."""
    copied_at: datetime
    address: str
    """The server's address; empty if its settings do not have it."""


def export_site(source: Path, output: Path) -> SiteReport:
    """Write the public pages of a server as files.

    What changes with time, such as phases, scores that are held back and hidden teams, is as it is
    now, or was when the backup was made.

    Parameters
    ----------
    source : Path
        A server's folder, also while it is running, or a backup.
    output : Path
        A folder that does not exist, is empty, or contains an earlier site, which is replaced.

    Raises
    ------
    ReverieEvalError
        If something else is in the output.
    BackupError, SettingsError, ReceiptError
        If the source cannot be opened.
    """
    _check_replaceable(output)
    with copied_server(source) as state, replacing_folder(output) as folder:
        visited = asyncio.run(_visit(state, folder))
        _link_files(visited, state.settings.path_prefix, folder)
        size = sum((folder / each.name).stat().st_size for each in visited.values())
        report = SiteReport(len(visited), size, state.clock(), state.settings.public_address)
        origin = {
            "server": state.settings.title,
            "address": report.address,
            "copied_at": report.copied_at.isoformat(),
            "software": f"{_SOFTWARE} {__version__}",
        }
        (folder / _COPY).write_text(f"{json.dumps(origin, indent=2)}\n", encoding="utf-8")
        return report


def _check_replaceable(output: Path) -> None:
    if output.is_dir() and (not any(output.iterdir()) or _is_copy(output)):
        return
    if output.exists():
        raise ReverieEvalError(
            f"{output} is not an earlier copy, and is not empty; choose a new folder"
        )


def _is_copy(folder: Path) -> bool:
    """Return whether a folder was written by :func:`export_site`."""
    try:
        software: str = json.loads((folder / _COPY).read_bytes())["software"]
        return software.startswith(f"{_SOFTWARE} ")
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return False


@dataclass(frozen=True, slots=True)
class _Visited:
    """A page or a file that was requested and written."""

    url: str
    """Where it was found, after redirects."""
    media_type: str
    name: str
    """The name of the file."""


async def _visit(state: ServerState, folder: Path) -> Mapping[str, _Visited]:
    """Follow all links as a visitor, write the replies, and return what was found by address."""
    app = create_app(state)
    app.state.is_copy = True
    prefix = state.settings.path_prefix
    for job in jobs_of(state).jobs:
        if job.seconds is None:  # what pages do without until it is computed
            job.work()
    waiting = [f"{prefix}/"]
    found: dict[str, _Visited | None] = {prefix + _EXAMPLE: None}
    async with httpx.AsyncClient(
        transport=httpx.ASGITransport(app), base_url=_ORIGIN, follow_redirects=True
    ) as visitor:
        while waiting:
            address = waiting.pop()
            if address in found:
                continue
            reply = await visitor.get(address)
            if reply.status_code == HTTPStatus.NOT_FOUND:  # a result whose file is damaged
                found[address] = None
                continue
            if reply.is_error:
                raise ReverieEvalError(
                    f"the page {address} has an error (status {reply.status_code}); examine the "
                    "data with `reverie-eval server doctor`"
                )
            media_type = reply.headers["content-type"].partition(";")[0]
            is_page = media_type == _PAGE
            if is_page and _SENDING_FORM.search(reply.text):
                found[address] = None
                continue
            visited = _Visited(
                str(reply.url), media_type, _name(address.removeprefix(prefix), media_type)
            )
            found[address] = visited
            file = folder / visited.name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(reply.content)
            links = links_of(reply.text) if is_page else ()
            urls = (_resolved(visited, link) for link in links)
            linked = (_address(url) for url in urls if url.startswith(f"{_ORIGIN}/"))
            waiting += (each for each in linked if _is_followed(address, each, prefix))
    return {address: visited for address, visited in found.items() if visited is not None}


def _is_followed(page: str, link: str, prefix: str) -> bool:
    """Whether a link is in the copy: episodes do not lead to each other."""
    path = link.removeprefix(prefix)
    leads_on = page.startswith(prefix + _EPISODES) and path.startswith(_EPISODES)
    return not leads_on or _OVERVIEW.fullmatch(path) is not None


def _link_files(found: Mapping[str, _Visited], prefix: str, folder: Path) -> None:
    """Let the pages link files instead of addresses."""
    names = {address: visited.name for address, visited in found.items()}
    names[prefix + _EXAMPLE] = _name(_EXAMPLE, _PAGE)
    for visited in found.values():
        if visited.media_type == _PAGE:
            file = folder / visited.name
            html = _relinked(file.read_text(encoding="utf-8"), visited, names)
            file.write_text(html, encoding="utf-8", newline="\n")


def _relinked(html: str, page: _Visited, names: Mapping[str, str]) -> str:
    """Return a page with links between files; those that need the server become plain text."""

    def change(link: str) -> str | None:
        url = _resolved(page, link)
        if link.startswith("#") or not url.startswith(f"{_ORIGIN}/"):
            return link
        file = names.get(_address(url))
        if file is None:
            return None
        fragment = urlsplit(url).fragment
        path = relpath(file, PurePosixPath(page.name).parent)
        return f"{path}#{fragment}" if fragment else path

    return with_links(html, change)


def _resolved(page: _Visited, link: str) -> str:
    """Return where a link on a page leads; ``?`` alone leads to the page without its query."""
    base = page.url.partition("?")[0] if link.startswith("?") else page.url
    return urljoin(base, link)


def _address(url: str) -> str:
    return url.removeprefix(_ORIGIN).partition("#")[0]


def _name(address: str, media_type: str) -> str:
    """Return the file for an address; different addresses have different files.

    >>> _name("/splits/val_unseen?metric=spl&columns=all", "text/html")
    'splits/val_unseen,metric=spl,columns=all.html'
    >>> _name("/", "text/html"), _name("/static/style.css?12ab", "text/css")
    ('index.html', 'static/style,12ab.css')
    """
    path, _, query = address.removeprefix("/").partition("?")
    path = path or "index"
    suffix = _SUFFIXES.get(media_type, PurePosixPath(path).suffix)
    parts = [path.removesuffix(suffix), *(query.split("&") if query else ())]
    return ",".join(re.sub(r"[^\w./=-]", _escaped, part, flags=re.ASCII) for part in parts) + suffix


def _escaped(found: re.Match[str]) -> str:
    return f"~{ord(found[0]):x}"
