"""Asking a model, so that no reply is paid for twice and a busy endpoint is tried again."""

import hashlib
import json
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import sleep
from typing import Any, TypeAlias

from reverie_eval.agents.chat._endpoint import Endpoint
from reverie_eval.agents.chat._prices import Budget
from reverie_eval.agents.chat._replies import Replies, Reply
from reverie_eval.agents.chat.errors import BusyError, EndpointError
from reverie_eval.errors import naming_missing_parts

ATTEMPTS = 6
FIRST_PAUSE = 1.0
"""Seconds before the second attempt, doubled before each further one, unless the endpoint says how
long to wait."""

Message: TypeAlias = Mapping[str, Any]
OnPaid: TypeAlias = Callable[[Reply], None]
"""Called with each reply that was paid for and is not in the log of steps."""

_DIGITS = 32
_LOGGER = logging.getLogger(__name__)


class Asker:
    """Asks one model at one endpoint.

    Parameters
    ----------
    endpoint : Endpoint
    model : str
        The model, as it is asked for.
    settings : mapping
        Further fields of each request, such as the temperature.
    folder : Path
        Where replies are kept.
    budget : Budget
        For all replies of the model in the folder.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        model: str,
        settings: Mapping[str, Any],
        folder: Path,
        budget: Budget,
    ) -> None:
        with naming_missing_parts():
            import tenacity  # noqa: F401
        self._endpoint = endpoint
        self._model = model
        self._settings = settings
        self._budget = budget
        self._replies = Replies(folder, model, budget.cost)

    def ask(
        self,
        messages: Sequence[Message],
        response_format: Mapping[str, Any],
        seed: int,
        on_paid: OnPaid,
    ) -> Reply:
        """Return the reply to some messages: that on file, or else the endpoint's.

        Parameters
        ----------
        messages : sequence of Message
        response_format : mapping
            The form of the reply, for endpoints that take it.
        seed : int
            Tells repeated questions from each other. It is not sent.
        on_paid : callable
            Called with each reply that is to be logged, also if it cannot be used.

        Raises
        ------
        EndpointError
            If the endpoint refuses or stays busy, or the money is used up.
        RefusalError, LongPromptError
            If the endpoint says that it will not or cannot reply.
        """
        from tenacity import Retrying, retry_if_exception_type, stop_after_attempt

        content = [self._model, self._settings, messages, seed]
        key = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:_DIGITS]
        if reply := self._replies.find(key):
            if self._replies.is_lost(key):
                on_paid(reply)
            return reply
        attempts = Retrying(
            retry=retry_if_exception_type(BusyError),
            stop=stop_after_attempt(ATTEMPTS),
            wait=_pause,
            before_sleep=_announce,
            sleep=sleep,
            reraise=True,
        )
        body = {"model": self._model, **self._settings, "messages": messages}
        return attempts(self._receive, key, body, response_format, on_paid)

    def _receive(
        self,
        key: str,
        body: Mapping[str, Any],
        response_format: Mapping[str, Any],
        on_paid: OnPaid,
    ) -> Reply:
        self._budget.check(self._replies.cost)
        received = self._endpoint.ask(body, response_format)
        is_same = received.model == (self._replies.model or received.model)
        is_empty = not (received.text or received.refusal) and received.end in {"", "stop"}
        reply = replace(
            received,
            key=key if is_same and not is_empty else "",
            usage=replace(received.usage, money=self._budget.cost(received.usage)),
        )
        self._replies.add(reply)
        on_paid(reply)
        if not is_same:
            raise EndpointError(
                f"the model that replies is {reply.model!r} now, and was {self._replies.model!r}; "
                "for another model, begin a run in a new folder"
            )
        if self._budget.prices and reply.usage.money is None:
            raise EndpointError(
                "the endpoint does not say how many tokens it used, so the cost is unknown; leave "
                "prices out"
            )
        if is_empty:
            raise BusyError("the endpoint sent an empty reply")
        return reply


def _pause(attempt: Any) -> float:
    """Return the seconds to wait after a failed attempt, tenacity's ``RetryCallState``."""
    asked: float | None = attempt.outcome.exception().retry_after
    return FIRST_PAUSE * 2 ** (attempt.attempt_number - 1) if asked is None else asked


def _announce(attempt: Any) -> None:
    reason = attempt.outcome.exception()
    _LOGGER.warning("%s; asking again in %g s", reason, attempt.upcoming_sleep)
