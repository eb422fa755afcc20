"""Which errors are worth another attempt, which cut an episode off, and which stop the run.

The table is data: the first class of an error's bases that it names decides. An error that it does
not name stops the run, because nobody knows whether it is the agent's, the endpoint's or ours.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal

Treatment = Literal["retry", "cut_off", "stop"]

TREATMENTS: Mapping[str, Treatment] = MappingProxyType(
    {
        # What the agent did cannot be done where it is: it ends there, without an answer.
        "reverie_eval.errors.ActionError": "cut_off",
        # A language model: it refused, its reply was cut off or has no action also after it was
        # asked again, or it was sent more than it can read. All other errors of its endpoint stop
        # the run, as a wrong key and an unknown model do.
        "reverie_eval.agents.chat.errors.RefusalError": "cut_off",
        "reverie_eval.agents.chat.errors.CutReplyError": "cut_off",
        "reverie_eval.agents.chat.errors.WrongActionError": "cut_off",
        "reverie_eval.agents.chat.errors.LongPromptError": "cut_off",
        "reverie_eval.agents.chat.errors.BusyError": "retry",
        # An agent says so itself.
        "reverie_eval.runner.TransientError": "retry",
        # The network, or the other end.
        "builtins.ConnectionError": "retry",
        "builtins.TimeoutError": "retry",
        "asyncio.exceptions.TimeoutError": "retry",
        "concurrent.futures._base.TimeoutError": "retry",
        "http.client.IncompleteRead": "retry",
        "http.client.RemoteDisconnected": "retry",
        "urllib.error.HTTPError": "stop",  # a kind of URLError: a wrong key will stay wrong
        "urllib.error.URLError": "retry",
        "requests.exceptions.ConnectionError": "retry",
        "requests.exceptions.Timeout": "retry",
        "httpx.TransportError": "retry",
        "aiohttp.client_exceptions.ClientConnectionError": "retry",
        "openai.APIConnectionError": "retry",
        "openai.InternalServerError": "retry",
        "openai.RateLimitError": "retry",
        "anthropic.APIConnectionError": "retry",
        "anthropic.InternalServerError": "retry",
        "anthropic.RateLimitError": "retry",
    }
)

WAITS = (1.0, 4.0, 16.0, 64.0)
"""Seconds before the second attempt, the third and so on; after the last, the episode failed."""

FAILED_IN_A_ROW = 3
"""So many failed episodes without another in between stop the run: an endpoint is gone."""


class TransientError(Exception):
    """For agents to raise: something outside failed, and the episode is worth another attempt."""


TransientError.__module__ = "reverie_eval.runner"


def treatment_of(error: BaseException) -> Treatment:
    """Return what is done about an error."""
    for base in type(error).__mro__:
        name = f"{base.__module__}.{base.__qualname__}"
        if name in TREATMENTS:
            return TREATMENTS[name]
    return "stop"
