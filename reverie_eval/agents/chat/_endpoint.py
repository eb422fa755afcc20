"""An OpenAI-compatible endpoint: one request, its reply, and all the ways in which it can fail."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timezone
from functools import cached_property
from typing import TYPE_CHECKING, Any
from weakref import finalize

from reverie_eval.agents.chat.errors import BusyError, EndpointError, LongPromptError, RefusalError
from reverie_eval.errors import ReverieEvalError, naming_missing_parts
from reverie_eval.logs import Usage
from reverie_eval.text import printable, whole_letters

if TYPE_CHECKING:
    import httpx

LONGEST_RETRY_AFTER = 300
"""Seconds; an endpoint that asks for a longer pause ends the run, which can go on later."""

# Statuses, besides those from 500 on, that another attempt may overcome.
_WAIT = frozenset({408, 409, 425, 429})
# Statuses of endpoints that do not know ``response_format``.
_WRONG_FORMAT = frozenset({400, 404, 415, 422, 501})
# What is said, beside OpenAI's code, if messages are longer than a model can read: by vLLM, in two
# ways; by SGLang and Together; by llama.cpp; by Anthropic; by Gemini.
_TOO_LONG = (
    "maximum context length",
    "longer than the maximum model length",
    "longer than the model's context length",
    "exceeds the available context size",
    "prompt is too long",
    "exceeds the maximum number of tokens allowed",
)
# Seconds to wait for a connection.
_CONNECT = 10.0
# Characters of an endpoint's error, which may be a whole page.
_MOST_SHOWN = 300


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """What a model replied to one request: a line of the file of all replies."""

    key: str = ""
    """A digest of model, settings, messages and seed; empty if there is nothing to use again."""
    asked: str
    """The model that was asked for."""
    model: str
    """The model that replied, as the endpoint calls it."""
    text: str
    refusal: str
    """Why the model refused; empty if it did not."""
    end: str
    """Why it ended: ``stop``, ``length`` and so on."""
    usage: Usage
    received: str
    """ISO 8601, in UTC."""


class Endpoint:
    """Where a model is asked.

    Parameters
    ----------
    url : str
        The address to which ``/chat/completions`` is appended: ``http://localhost:11434/v1``.
    key_from : str
        The environment variable with the key; empty if none is needed.
    timeout : float
        Seconds to wait for the next byte of a reply before the request counts as failed.

    Raises
    ------
    ReverieEvalError
        If that is not an address, or there is no such variable.
    MissingPartError
        If httpx is not installed.
    """

    def __init__(self, url: str, key_from: str, timeout: float) -> None:
        with naming_missing_parts():
            from httpx import Timeout

            import reverie_eval.client.sending  # noqa: F401
        self._url = _checked(url)
        self._key = _key_in(key_from)
        self._timeout = Timeout(timeout, connect=_CONNECT)
        self._has_replied = False
        self._takes_format = True

    @cached_property
    def _http(self) -> "httpx.Client":
        from reverie_eval.client.sending import USER_AGENT, http_client

        authorization = {"Authorization": f"Bearer {self._key}"} if self._key else {}
        http = http_client(self._url, {**USER_AGENT, **authorization})
        finalize(self, http.close)  # an agent is not told when it is no longer needed
        return http

    def ask(self, body: Mapping[str, Any], response_format: Mapping[str, Any]) -> Reply:
        """Ask once; without a format of the reply, if the endpoint does not know that.

        Raises
        ------
        EndpointError
            If it refuses; a BusyError if another attempt may help.
        RefusalError, LongPromptError
            If it says that it will not or cannot reply to these messages.
        """
        if self._takes_format:
            response = self._post({**body, "response_format": response_format})
            if response.status_code not in _WRONG_FORMAT:
                return self._reply_in(response, body)
        plain = self._post(body)
        if plain.is_success:
            self._takes_format = False
        return self._reply_in(plain, body)

    def _post(self, body: Mapping[str, Any]) -> "httpx.Response":
        import httpx

        from reverie_eval.client.sending import reason_of

        try:
            url = f"{self._url}/chat/completions"
            response = self._http.post(url, json=body, timeout=self._timeout)
        except httpx.RequestError as error:
            message = f"{self._url}: {reason_of(error)}"
            # Waiting for a mistyped address helps nobody.
            if isinstance(error, httpx.ConnectError) and not self._has_replied:
                raise EndpointError(message) from None
            raise BusyError(message) from None
        self._has_replied = True
        return response

    def _reply_in(self, response: "httpx.Response", body: Mapping[str, Any]) -> Reply:
        try:
            document = response.json()
        except (ValueError, RecursionError):
            document = None
        if not response.is_success or not isinstance(document, dict) or "error" in document:
            raise self._failure(response, document)
        choices = document.get("choices")
        first = choices[0] if isinstance(choices, list) and choices else None
        choice = first if isinstance(first, dict) else {}
        message = choice.get("message")
        if not isinstance(message, dict) or choice.get("finish_reason") == "error":
            raise BusyError(self._about("it sent a reply without a message"))
        return Reply(
            asked=body["model"],
            model=_text(document.get("model")) or body["model"],
            text=_text(message.get("content")),
            refusal=_text(message.get("refusal")),
            end=_text(choice.get("finish_reason")),
            usage=_usage(document.get("usage")),
            received=datetime.now(timezone.utc).isoformat(timespec="seconds"),
        )

    def _failure(self, response: "httpx.Response", document: Any) -> ReverieEvalError:
        """Return the error to raise for a reply that is not one of a model."""
        from reverie_eval.client.sending import retry_after_of

        if response.is_success and (form := _wrong_form(response)):
            return EndpointError(self._about(form))
        code, why = _error_in(document, response.text)
        status = f"{response.status_code} {response.reason_phrase}".rstrip()
        message = self._about(f"it answered {status}: {why}" if why else f"it answered {status}")
        if code == "content_filter":
            return RefusalError(why)
        if code == "context_length_exceeded" or any(words in why for words in _TOO_LONG):
            return LongPromptError(why)
        is_busy = response.status_code >= 500 or response.status_code in _WAIT
        # A proxy's page, or an error that came after the status was sent.
        is_busy = (is_busy or response.is_success) and code != "insufficient_quota"
        pause = retry_after_of(response)
        if is_busy and (pause or 0) <= LONGEST_RETRY_AFTER:
            return BusyError(message, pause)
        return EndpointError(message)

    def _about(self, what: str) -> str:
        said = f"{self._url}: {what}"
        return said.replace(self._key, "...") if self._key else said


def _wrong_form(response: "httpx.Response") -> str:
    """Return what is wrong with the form of all replies of a server, if anything is known to be."""
    kind = response.headers.get("content-type", "")
    if kind.startswith("text/event-stream"):
        return "it sent an event stream; expected one JSON object: switch streaming off"
    if kind.startswith("application/json"):
        try:
            response.content.decode()
        except UnicodeDecodeError:
            return "it sent JSON that is not in UTF-8; switch its encoding to UTF-8"
    return ""


def _checked(url: str) -> str:
    import httpx

    try:
        address = httpx.URL(url.strip())
    except httpx.InvalidURL:
        address = httpx.URL()
    has_more = address.userinfo or address.query or address.fragment
    if address.scheme not in ("http", "https") or not address.host or has_more:
        # Not shown: there may be a key in it.
        raise ReverieEvalError(
            "the endpoint's address should be like https://HOST/v1, without user, key or query"
        )
    return str(address).rstrip("/")


def _key_in(variable: str) -> str:
    if not variable:
        return ""
    key = os.environ.get(variable, "").strip()
    if not (key.isascii() and key.isprintable() and key):
        raise ReverieEvalError(
            f"the environment variable {variable} has no key; set it to the endpoint's key"
        )
    return key


def _error_in(document: Any, text: str) -> tuple[str, str]:
    """Return the code and the message of an error: endpoints have several forms of it."""
    error = document.get("error", document) if isinstance(document, dict) else text
    code = error.get("code") if isinstance(error, dict) else ""
    if isinstance(error, dict):
        error = error.get("message") or error.get("detail") or error
    return _text(code), printable(" ".join(str(error).split()))[:_MOST_SHOWN]


def _usage(usage: Any) -> Usage:
    return Usage(
        input_tokens=_number(usage, "prompt_tokens"),
        cached_tokens=_number(usage, "prompt_tokens_details", "cached_tokens"),
        output_tokens=_number(usage, "completion_tokens"),
        reasoning_tokens=_number(usage, "completion_tokens_details", "reasoning_tokens"),
    )


def _number(of: Any, *names: str) -> int | None:
    for name in names:
        of = of.get(name) if isinstance(of, dict) else None
    return of if isinstance(of, int) and of >= 0 else None


def _text(value: Any) -> str:
    """Return a text; content in parts, as some endpoints send it, is joined."""
    if isinstance(value, list):
        return "".join(_text(part.get("text")) for part in value if isinstance(part, dict))
    return whole_letters(value) if isinstance(value, str) else ""
