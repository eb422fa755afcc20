"""Somebody's browser with scripts off: it keeps a cookie, fills in forms and follows redirects."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import unescape

import httpx

from reverie_eval.server.http.callers import COOKIE
from tests.support.serving import GOOD, OPEN, Serving

FIELD = re.compile(r'name="csrf_token" value="([^"]+)"')
PLACE = re.compile(r"/submissions/([0-9a-f]{16})")


def said(reply: httpx.Response) -> str:
    """Return what a page says to whoever reads it: without tags, its white space made even."""
    text = re.sub(r"<(script|style|title)\b.*?</\1>", " ", reply.text, flags=re.DOTALL)
    words = " ".join(unescape(re.sub(r"<[^>]*>", " ", text)).split())
    return re.sub(r" ([.,;:])", r"\1", words)


@dataclass(frozen=True)
class Visitor:
    """Somebody's browser; of nobody, if there is no cookie."""

    server: Serving
    cookie: str = ""

    def get(self, path: str) -> httpx.Response:
        """Look at a page."""
        return self._ask("GET", path)

    def send(
        self,
        path: str,
        fields: Mapping[str, str | Sequence[str]],
        *,
        csrf_token: str | None = None,
        file: bytes | None = None,
        headers: Mapping[str, str] | None = None,
    ) -> httpx.Response:
        """Send a form of ours, with its CSRF token unless another is given."""
        token = self.csrf_token() if csrf_token is None else csrf_token
        files = None if file is None else {"file": ("answers.json", file)}
        data = {"csrf_token": token, **fields}
        return self._ask("POST", path, data=data, files=files, headers=headers or {})

    def upload(self, file: bytes = GOOD, what: str = "score", /, **fields: str) -> httpx.Response:
        """Send the form of /submit."""
        typed = {"split": OPEN, "what": what, "name": "Walker", **fields}
        return self.send("/submit", typed, file=file)

    def csrf_token(self) -> str:
        """Return what our pages put into their forms."""
        found = FIELD.search(self.get("/team").text)
        return found[1] if found else ""

    def _ask(self, method: str, path: str, **content: object) -> httpx.Response:
        given: Mapping[str, str] = content.pop("headers", {})  # type: ignore[assignment]
        headers = {**given, **({"Cookie": f"{COOKIE}={self.cookie}"} if self.cookie else {})}
        reply = self.server.client.request(method, path, headers=headers, **content)  # type: ignore[arg-type]
        self.server.client.cookies.clear()  # what a request carries, the tests say
        return reply


def signed_in(server: Serving, who: str) -> Visitor:
    """Sign somebody in with the form."""
    reply = server.client.post("/sign-in", data={"token": server.tokens[who]})
    assert reply.status_code == 303
    server.client.cookies.clear()
    return Visitor(server, reply.cookies[COOKIE])


def place_of(reply: httpx.Response) -> str:
    """Return the id of the submission that a form has led to."""
    found = PLACE.match(reply.headers["location"])
    assert found
    return found[1]
