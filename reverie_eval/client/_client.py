"""A client of an evaluation server: what a participant does, as methods."""

import gzip
import secrets
from collections.abc import Sequence
from typing import Self, TypeVar
from urllib.parse import quote

import httpx
from pydantic import BaseModel, TypeAdapter, ValidationError

from reverie_eval.client._errors import NotAServerError, ServiceError, UnreachableError
from reverie_eval.client._sending import (
    Call,
    Notice,
    Progress,
    Sender,
    another_version,
    check_private,
    server_url,
)
from reverie_eval.metrics import PRIMARY_METRIC
from reverie_eval.schemas.service import (
    Accepted,
    Checked,
    Invitation,
    Leaderboard,
    Me,
    Method,
    ServerReport,
    SplitReport,
    SubmissionChange,
    SubmissionReport,
    Welcome,
)
from reverie_eval.submissions import Source, read_bytes

T = TypeVar("T")
M = TypeVar("M", bound=BaseModel)

_SPLITS = TypeAdapter(list[SplitReport])
_JSON = {"Content-Type": "application/json"}
_GZIP = {"Content-Type": "application/gzip"}


class Client:
    """Talks to one evaluation server.

    What is sent is sent again if the connection drops or the server is busy: up to five times, as
    soon as the server asks for it or within some 15 seconds, and to the same effect as once. A
    server that says nothing is given up after three minutes. Every method raises
    :class:`ServiceError` if there is no reply to go on with: :class:`UnreachableError`,
    :class:`NotAServerError`, :class:`RefusedError` (:class:`QuotaSpentError`).

    Parameters
    ----------
    url : str
        Where the server is: ``https://reverie.example.org``.
    token : str, optional
        Who is calling; splits, leaderboards and the key are for everybody.
    notice : function, optional
        Called with a line of text when something is tried again.
    plain_http : bool
        Whether ``http://`` may lead to another machine, where others on the way can read the token
        and change what is said.

    Raises
    ------
    ServiceError
        If the URL or the token is none, the connection would not be private, or the environment
        names a proxy or certificates that cannot be used.

    Examples
    --------
    ::

        with Client("https://reverie.example.org", token) as client:
            accepted = client.submit("test", "submit.json", Method(name="Ours"))
            print(accepted.submission.report.scores, accepted.quota.remaining)
    """

    def __init__(
        self,
        url: str,
        token: str | None = None,
        notice: Notice | None = None,
        *,
        plain_http: bool = False,
    ) -> None:
        self.url = server_url(url)
        if not plain_http:
            check_private(self.url)
        self._sender = Sender(self.url, _checked(token), notice)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the connection."""
        self._sender.close()

    def server(self) -> ServerReport:
        """Return what the server is, and what its organiser has to say to everybody."""
        return self._model(ServerReport, Call("GET", "/server"))

    def splits(self) -> Sequence[SplitReport]:
        """Return the splits that submissions are taken for, with one's quota if signed in."""
        return self._read(_SPLITS, Call("GET", "/splits"))

    def me(self) -> Me:
        """Return whose token this is."""
        return self._model(Me, Call("GET", "/me"))

    def key(self) -> str:
        """Return the Ed25519 public key that receipts are checked with, in PEM form."""
        key = self._sender.send(Call("GET", "/key")).text
        if not key.startswith("-----BEGIN PUBLIC KEY-----"):
            raise NotAServerError(f"{self.url} is no evaluation server: it publishes no key")
        return key

    def leaderboard(self, split: str, metric: str = PRIMARY_METRIC) -> Leaderboard:
        """Return what was published for a split, ranked by a metric.

        Parameters
        ----------
        split : str
            ``test``.
        metric : str
            A key of ``CATALOGUE``, one of which more or less is better.
        """
        path = f"/splits/{_quoted(split)}/leaderboard"
        return self._model(Leaderboard, Call("GET", path, query={"metric": metric}))

    def leaderboard_csv(self, split: str, metric: str = PRIMARY_METRIC) -> str:
        """Return the same as CSV: a row per result, a column per metric."""
        path = f"/splits/{_quoted(split)}/leaderboard.csv"
        response = self._sender.send(Call("GET", path, query={"metric": metric}))
        if "csv" not in _media_type(response):
            raise NotAServerError(f"{self.url} is no evaluation server")
        return response.text

    def validate(self, split: str, submission: Source) -> Checked:
        """Let the server check a submission; nothing is spent or kept.

        Parameters
        ----------
        split : str
            What it is for.
        submission : path, bytes or open file
            The result file, plain, gzipped or alone in a zip archive.

        Raises
        ------
        SubmissionError
            Listing everything that is wrong with it.
        """
        path, body = f"/splits/{_quoted(split)}/validate", _packed(read_bytes(submission))
        return self._model(Checked, Call("POST", path, body=body, headers=_GZIP))

    def submit(
        self, split: str, submission: Source, method: Method, progress: Progress | None = None
    ) -> Accepted:
        """Have a submission scored.

        It is counted once, however often the connection drops on the way and back, and however
        often the same file is submitted.

        Parameters
        ----------
        split : str
            What it is for.
        submission : path, bytes or open file
            The result file, plain, gzipped or alone in a zip archive.
        method : Method
            What is said of the method.
        progress : function, optional
            Called with the number of bytes sent and of all.

        Returns
        -------
        Accepted
            The submission with its scores (percent, metres) and its receipt, and the quota.

        Raises
        ------
        SubmissionError
            Listing everything that is wrong with it; nothing was spent.
        QuotaSpentError
            If nothing is left of the quota; ``document.quota`` tells when something is.
        """
        path = f"/splits/{_quoted(split)}/submissions"
        form = _form(read_bytes(submission), method)
        key = {"Idempotency-Key": secrets.token_hex(16)}
        headers = {"Content-Type": form.headers["Content-Type"], **key}
        call = Call("POST", path, body=form.read(), headers=headers, progress=progress)
        try:
            return self._model(Accepted, call)
        except UnreachableError as error:
            again = "send it again: it is counted once, whatever became of it"
            raise UnreachableError(f"{error}; {again}") from error

    def change(self, submission_id: str, change: SubmissionChange) -> SubmissionReport:
        """Publish or withdraw a submission, or change what is said of its method.

        What the change does not name stays: ``SubmissionChange(published=True)``.
        """
        body = change.model_dump_json(exclude_unset=True).encode()
        path = f"/submissions/{_quoted(submission_id)}"
        return self._model(SubmissionReport, Call("PATCH", path, body=body, headers=_JSON))

    def accept(self, invitation: str) -> Welcome:
        """Turn an invitation into a token, which is shown this once.

        An invitation is used up by this: it is not sent again if the reply is lost.
        """
        body = Invitation(invitation=invitation).model_dump_json().encode()
        call = Call("POST", "/tokens", body=body, headers=_JSON, is_repeatable=False)
        try:
            return self._model(Welcome, call)
        except UnreachableError as error:
            again = "try again; if the invitation is refused then, ask the organiser for another"
            raise UnreachableError(f"{error}; {again}") from error

    def _model(self, model: type[M], call: Call) -> M:
        return self._read(TypeAdapter(model), call)

    def _read(self, adapter: TypeAdapter[T], call: Call) -> T:
        response = self._sender.send(call)
        try:
            # A server that is newer than this may tell more.
            return adapter.validate_json(response.content, extra="ignore")
        except ValidationError:
            if "json" not in _media_type(response):
                raise NotAServerError(f"{self.url} is no evaluation server") from None
            raise another_version(self.url) from None


def _checked(token: str | None) -> str | None:
    """Refuse what no header can carry, without showing it."""
    if token is not None and not (token.isascii() and token.isprintable() and token.strip()):
        raise ServiceError("the token is none: a token is one line of letters and digits")
    return token


def _packed(content: bytes) -> bytes:
    return gzip.compress(content, compresslevel=6, mtime=0)


def _form(content: bytes, method: Method) -> httpx.Request:
    """Lay out a form; a URL would be too short for some descriptions."""
    fields = method.model_dump(mode="json", exclude_none=True, exclude_unset=True)
    said = {name: value if isinstance(value, str) else str(value) for name, value in fields.items()}
    files = {"file": ("submission.json.gz", _packed(content), "application/gzip")}
    return httpx.Request("POST", "http://form", data=said, files=files)


def _media_type(response: httpx.Response) -> str:
    declared: str = response.headers.get("content-type", "")
    return declared.partition(";")[0]


def _quoted(name: str) -> str:
    return quote(name, safe="")
