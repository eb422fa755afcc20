"""The client of an evaluation server: a method for each thing a participant can do."""

import gzip
import secrets
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import TypeVar
from urllib.parse import parse_qsl, quote, urlsplit

import httpx
from pydantic import TypeAdapter, ValidationError
from typing_extensions import Self

from reverie_eval.client.sending import (
    Call,
    NotAServerError,
    Notice,
    Sender,
    ServiceError,
    TransferProgress,
    UnreachableError,
    check_private,
    incompatible_version,
    server_url,
)
from reverie_eval.schemas.service import (
    Accepted,
    Checked,
    Invitation,
    KeyReport,
    Leaderboard,
    Me,
    Method,
    ScoredSubmission,
    ServerReport,
    SplitReport,
    SubmissionChange,
    Welcome,
)
from reverie_eval.submissions import Source, read_bytes

T = TypeVar("T")

_quote = partial(quote, safe="")
_JSON = {"Content-Type": "application/json"}
_GZIP = {"Content-Type": "application/gzip"}
# Submissions that are fetched at a time.
_PAGE = 100


class Client:
    """Talks to one evaluation server.

    A request is sent again if the connection drops or the server is busy: up to five times, at the
    time that the server asks for or else within about 15 seconds, with the same effect as sending
    it once. After three minutes the client gives up. Every method raises a :class:`ServiceError` if
    the request fails: :class:`UnreachableError`, :class:`NotAServerError` or :class:`RefusedError`
    (:class:`QuotaSpentError`).

    Parameters
    ----------
    url : str
        The address of the server: ``https://reverie.example.org``.
    token : str, optional
        Identifies the caller; not needed for splits, leaderboards and the public key.
    notice : function, optional
        Called with a line of text before a request is sent again.
    plain_http : bool
        Allow ``http://`` to another machine, although others on the network can then read the
        token and change the data.

    Raises
    ------
    ServiceError
        If the URL or the token is invalid, the connection would not be encrypted, or the
        environment sets a proxy or certificates that cannot be used.

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
        if token is not None and not (token.isascii() and token.isprintable() and token.strip()):
            # No header can carry it, and no message may show it.
            raise ServiceError("invalid token: a token is one line of letters and digits")
        self._sender = Sender(self.url, token, notice)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection."""
        self._sender.close()

    def server(self) -> ServerReport:
        """Return the description of the server, with the organiser's announcement."""
        return self._send(ServerReport, Call("GET", "/server"))

    def splits(self) -> Sequence[SplitReport]:
        """Return the splits that accept submissions, with the quota of a caller with a token."""
        return self._send(list[SplitReport], Call("GET", "/splits"))

    def me(self) -> Me:
        """Return the person that the token belongs to."""
        return self._send(Me, Call("GET", "/me"))

    def key(self) -> str:
        """Return the Ed25519 public key in use, in PEM form."""
        key = self._sender.send(Call("GET", "/key")).text
        if not key.startswith("-----BEGIN PUBLIC KEY-----"):
            raise NotAServerError(f"{self.url} is not an evaluation server: it publishes no key")
        return key

    def keys(self) -> Sequence[KeyReport]:
        """Return all keys that the server has signed receipts with, the earliest first."""
        return self._send(list[KeyReport], Call("GET", "/keys"))

    def leaderboard(self, split: str, metric: str | None = None, *, board: str = "") -> Leaderboard:
        """Return the published submissions of a split, ranked by a metric.

        Parameters
        ----------
        split : str
            ``test``.
        metric : str, optional
            A key of ``CATALOGUE`` whose metric has a direction; by default the leaderboard's
            primary one.
        board : str, optional
            A leaderboard of the split besides the main one, by its name.
        """
        route = f"{_leaderboards(split, board)}/leaderboard"
        return self._send(Leaderboard, Call("GET", route, query=_by(metric)))

    def leaderboard_csv(self, split: str, metric: str | None = None, *, board: str = "") -> str:
        """Return the leaderboard as CSV: a row per submission, a column per metric."""
        route = f"{_leaderboards(split, board)}/leaderboard.csv"
        response = self._sender.send(Call("GET", route, query=_by(metric)))
        if "csv" not in _media_type(response):
            raise NotAServerError(f"{self.url} is not an evaluation server")
        return response.text

    def validate(self, split: str, submission: Source) -> Checked:
        """Let the server check a submission without using up quota or storing anything.

        Parameters
        ----------
        split : str
            The split that the submission is for.
        submission : path, bytes or open file
            The result file, plain, gzipped or alone in a zip archive.

        Raises
        ------
        SubmissionError
            With every problem found in it.
        """
        route, body = f"/splits/{_quote(split)}/validate", _compress(read_bytes(submission))
        return self._send(Checked, Call("POST", route, body=body, headers=_GZIP))

    def submit(
        self,
        split: str,
        submission: Source,
        method: Method,
        progress: TransferProgress | None = None,
    ) -> Accepted:
        """Send a submission and return its scores.

        It counts once, however often the connection drops and however often the same file is
        submitted.

        Parameters
        ----------
        split : str
            The split that the submission is for.
        submission : path, bytes or open file
            The result file, plain, gzipped or alone in a zip archive.
        method : Method
            The description of the method.
        progress : function, optional
            Called with the number of bytes sent so far and in total.

        Returns
        -------
        Accepted
            The submission with its scores (percent, metres) and receipt, and the quota left.

        Raises
        ------
        SubmissionError
            With every problem found in it; no quota was used.
        QuotaSpentError
            If the quota is used up; ``document.quota`` says when it resets.
        """
        route = f"/splits/{_quote(split)}/submissions"
        fields = method.model_dump(mode="json", exclude_none=True, exclude_unset=True)
        data = {name: str(value) for name, value in fields.items()}
        content = _compress(read_bytes(submission))
        files = {"file": ("submission.json.gz", content, "application/gzip")}
        # A form, because some descriptions are too long for a URL.
        form = httpx.Request("POST", "http://form", data=data, files=files)
        key = {"Idempotency-Key": secrets.token_hex(16)}
        headers = {"Content-Type": form.headers["Content-Type"], **key}
        call = Call("POST", route, body=form.read(), headers=headers, progress=progress)
        try:
            return self._send(Accepted, call)
        except UnreachableError as error:
            remedy = "send it again: it counts once, even if it arrived this time"
            raise UnreachableError(f"{error}; {remedy}") from error

    def submissions(self) -> Iterator[ScoredSubmission]:
        """Iterate over the submissions of the caller's team, the newest first.

        An organiser gets those of all teams. They are fetched page by page.
        """
        query: Mapping[str, str] | None = {"limit": str(_PAGE)}
        while query is not None:
            response = self._sender.send(Call("GET", "/submissions", query=query))
            yield from self._read(list[ScoredSubmission], response)
            following = response.links.get("next")
            query = following and dict(parse_qsl(urlsplit(following["url"]).query))

    def change(self, submission_id: str, change: SubmissionChange) -> ScoredSubmission:
        """Publish or withdraw a submission, or change the description of its method.

        Fields that are not set stay as they are: ``SubmissionChange(published=True)``.
        """
        body = change.model_dump_json(exclude_unset=True).encode()
        route = f"/submissions/{_quote(submission_id)}"
        return self._send(ScoredSubmission, Call("PATCH", route, body=body, headers=_JSON))

    def accept(self, invitation: str) -> Welcome:
        """Exchange an invitation for a token, which is shown only once.

        This uses up the invitation, so it is not sent again if the reply is lost.
        """
        body = Invitation(invitation=invitation).model_dump_json().encode()
        call = Call("POST", "/tokens", body=body, headers=_JSON, is_repeatable=False)
        try:
            return self._send(Welcome, call)
        except UnreachableError as error:
            remedy = "try again; if the invitation is then refused, ask the organiser for another"
            raise UnreachableError(f"{error}; {remedy}") from error

    def _send(self, model: type[T], call: Call) -> T:
        return self._read(model, self._sender.send(call))

    def _read(self, model: type[T], response: httpx.Response) -> T:
        try:
            # A newer server may send more fields.
            return TypeAdapter(model).validate_json(response.content, extra="ignore")
        except ValidationError:
            if "json" not in _media_type(response):
                raise NotAServerError(f"{self.url} is not an evaluation server") from None
            raise incompatible_version(self.url) from None


def _leaderboards(split: str, board: str) -> str:
    """Return where the server has a split's main leaderboard, or another one."""
    return f"/splits/{_quote(split)}" + (f"/boards/{_quote(board)}" if board else "")


def _by(metric: str | None) -> Mapping[str, str]:
    """Return the query for a leaderboard's metric; without one, the server chooses."""
    return {} if metric is None else {"metric": metric}


def _compress(content: bytes) -> bytes:
    return gzip.compress(content, compresslevel=6, mtime=0)


def _media_type(response: httpx.Response) -> str:
    declared: str = response.headers.get("content-type", "")
    return declared.partition(";")[0]
