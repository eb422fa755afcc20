"""The requests of a remote worker to EvalAI.

References
----------
EvalAI 0f0403929, ``apps/jobs/views.py``; bodies are forms, as EvalAI-Starters'
``remote_challenge_evaluation`` sends them.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from http import HTTPStatus
from typing import Any, Literal, Self, TypeVar

import httpx
from pydantic import BaseModel, ConfigDict, PositiveInt, TypeAdapter, ValidationError

from reverie_eval.client.sending import USER_AGENT, http_client, reason_of, retry_after_of
from reverie_eval.errors import Problem, ReverieEvalError, SubmissionError
from reverie_eval.server.settings import EvalAI
from reverie_eval.text import printable

M = TypeVar("M", bound=BaseModel)

_OVER = frozenset({"finished", "failed", "cancelled", "archived"})
_REFUSED = frozenset({HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN})
_BUSY = frozenset({HTTPStatus.REQUEST_TIMEOUT, HTTPStatus.TOO_MANY_REQUESTS})
_GONE = frozenset({HTTPStatus.NOT_FOUND, HTTPStatus.GONE})
_LONGEST_QUOTE = 500
"""Characters that are quoted of a reply."""


class EvalAIError(ReverieEvalError):
    """EvalAI refuses the token."""


class MismatchError(EvalAIError):
    """The settings here do not match the challenge on EvalAI."""


class UnavailableError(ReverieEvalError):
    """EvalAI does not answer as expected; it may do so later."""

    def __init__(self, message: str, retry_after: float | None = None) -> None:
        self.retry_after = retry_after
        """Seconds to wait, if EvalAI asks for a pause."""
        super().__init__(message)


class _Reply(BaseModel):
    """A reply of EvalAI, which may have further fields."""

    model_config = ConfigDict(frozen=True, extra="ignore")


class Message(_Reply):
    """The next message of the queue; without a handle, the queue was empty."""

    body: Any = None
    receipt_handle: str | None = None

    @property
    def submission(self) -> int | None:
        """The number of the submission that waits; None if the body does not have it."""
        if isinstance(self.body, Mapping):
            with suppress(ValidationError):
                number: int = TypeAdapter(PositiveInt).validate_python(
                    self.body.get("submission_pk")
                )
                return number
        return None


class EvalAISubmission(_Reply):
    """A submission at EvalAI."""

    id: int
    challenge_phase: int
    status: str
    input_file: str | None = None
    ignore_submission: bool = False
    """Whether it was deleted."""

    @property
    def is_over(self) -> bool:
        """Whether nothing more is to be reported about it."""
        return self.status in _OVER or self.ignore_submission


@dataclass(frozen=True)
class End:
    """The outcome of a submission."""

    submission_status: Literal["FINISHED", "FAILED"]
    stdout: str = ""
    """Shown to the participant."""
    stderr: str = ""
    """Shown to the participant, too."""
    result: str = ""
    """JSON: the values of the leaderboard's labels."""
    metadata: str = ""
    """JSON, shown to hosts only."""


class EvalAIClient:
    """Talks to EvalAI about one challenge; nothing is sent twice.

    Parameters
    ----------
    settings : EvalAI
        Settings of the challenge.
    token : str
        A token of one of its hosts.

    Raises
    ------
    ServiceError
        If the environment's proxies or certificates cannot be used.
    EvalAIError
        If a header cannot contain the token. All methods: if EvalAI refuses it.
    MismatchError
        All methods: if EvalAI refuses the request for another reason.
    UnavailableError
        All methods: if there is no reply, or it is not EvalAI's.
    """

    def __init__(self, settings: EvalAI, token: str) -> None:
        self.settings = settings
        if not (token.isascii() and token.isprintable() and token.strip()):
            raise EvalAIError(
                "there is no usable token for EvalAI; set REVERIE_EVAL_EVALAI__TOKEN, or "
                "evalai.token_file to a file with the token that your profile at EvalAI shows"
            )
        # Set for each request, not for the client: the store that has the files must not see it.
        self._headers = {"Authorization": f"Bearer {token}"}
        self._url = str(settings.url).rstrip("/")
        self._http = http_client(self._url, USER_AGENT)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._http.close()

    def receive(self) -> Message | None:
        """Take a message from the queue, hidden from others for some time; None if it is empty.

        Unless it is removed, it comes again: from EvalAI's queues, after 30 seconds.
        """
        message = self._read(Message, self._ask("GET", f"challenge/queues/{self.settings.queue}/"))
        return message if message.receipt_handle else None

    def remove(self, message: Message) -> None:
        """Remove a message from the queue for good."""
        handle = str(message.receipt_handle)
        self._ask("POST", f"queues/{self.settings.queue}/", receipt_handle=handle)

    def submission(self, number: int) -> EvalAISubmission | None:
        """Look a submission up; None if it does not exist."""
        reply = self._request("GET", f"submission/{number}")
        # Only if EvalAI says so: a proxy's 404 must not cost a submission.
        if reply.status_code == HTTPStatus.NOT_FOUND and "does not exist" in _quote(reply):
            return None
        return self._read(EvalAISubmission, self._content(reply))

    def report_running(self, submission: EvalAISubmission) -> None:
        """Report that a submission is being scored."""
        self._update("PATCH", submission, submission_status="RUNNING")

    def report_end(self, submission: EvalAISubmission, end: End) -> None:
        """Report how a submission has ended."""
        phase = str(submission.challenge_phase)
        self._update("PUT", submission, challenge_phase=phase, **asdict(end))

    def _update(self, method: str, submission: EvalAISubmission, **form: str) -> None:
        path = f"challenge/{self.settings.challenge}/update_submission/"
        self._ask(method, path, submission=str(submission.id), **form)

    def download(self, submission: EvalAISubmission, most_bytes: int) -> bytes:
        """Fetch a submission's file, without the token because it may be in any store.

        Raises
        ------
        SubmissionError
            If it does not exist, or is larger than allowed.
        """
        content = bytearray()
        try:
            with self._http.stream(
                "GET", submission.input_file or "", follow_redirects=True
            ) as reply:
                if reply.status_code in _GONE:
                    raise _rejected("missing-file", "EvalAI does not have it; submit it again")
                if not reply.is_success:
                    # Not the participant's fault: a proxy or the store has a problem.
                    raise UnavailableError(f"{_host(reply)} answered {_status(reply)} for a file")
                for piece in reply.iter_raw():
                    content += piece
                    if len(content) > most_bytes:
                        limit = f"is larger than {most_bytes >> 20} MiB; send it gzipped"
                        raise _rejected("too-large", limit)
        except (httpx.UnsupportedProtocol, httpx.InvalidURL):
            raise _rejected("missing-file", "EvalAI does not have it; submit it again") from None
        except httpx.RequestError as error:
            raise UnavailableError(f"a file cannot be fetched: {reason_of(error)}") from error
        return bytes(content)

    def _ask(self, method: str, path: str, **form: str) -> Any:
        return self._content(self._request(method, path, **form))

    def _request(self, method: str, path: str, **form: str) -> httpx.Response:
        try:
            return self._http.request(
                method, f"{self._url}/api/jobs/{path}", data=form or None, headers=self._headers
            )
        except httpx.RequestError as error:
            raise UnavailableError(f"{self._url}: {reason_of(error)}") from error

    def _content(self, reply: httpx.Response) -> Any:
        """Return the JSON of a successful reply."""
        if reply.is_success:
            try:
                return reply.json()
            except ValueError:
                raise self._strange() from None
        said = f"{_host(reply)} answered {_status(reply)}{_quote(reply)}"
        if reply.status_code in _REFUSED:
            raise EvalAIError(
                f"{said}; check that the token is still valid (your profile at EvalAI makes "
                f"others), and that it is of a host of challenge {self.settings.challenge}"
            )
        if reply.is_server_error or reply.status_code in _BUSY:
            raise UnavailableError(said, retry_after_of(reply))
        raise MismatchError(said)

    def _read(self, model: type[M], content: Any) -> M:
        try:
            return model.model_validate(content)
        except ValidationError:
            raise self._strange() from None

    def _strange(self) -> UnavailableError:
        return UnavailableError(f"{self._url} does not answer as EvalAI does")


def _rejected(code: str, message: str) -> SubmissionError:
    return SubmissionError([Problem(code, "file", message)])


def _host(reply: httpx.Response) -> str:
    """Return the host that replied; the rest of a file's URL may be what gives access to it."""
    return reply.url.host


def _status(reply: httpx.Response) -> str:
    return printable(f"{reply.status_code} {reply.reason_phrase}".rstrip())


def _quote(reply: httpx.Response) -> str:
    """Quote the reason that EvalAI, or its Django REST framework, gives."""
    try:
        document = reply.json()
    except ValueError:
        return ""
    fields = document if isinstance(document, Mapping) else {}
    reason = fields.get("error") or fields.get("detail") or document
    return f": {printable(str(reason))[:_LONGEST_QUOTE]}"
