"""Errors of a model's endpoint; ``reverie_eval.runner.TREATMENTS`` says what a run does about each.

ReverieEvalError
    EndpointError           the endpoint refused the request, or cannot be used
        BusyError           what a later attempt may overcome
        CostLimitError      the next reply may cost more than was allowed
    ModelError              the model replied, and there is no action in it
        RefusalError        it refused
        CutReplyError       its reply was cut off where the number of tokens ended
        WrongActionError    its reply has no action that can be done, also after the repair
        LongPromptError     the messages are longer than the model can read
"""

from reverie_eval.errors import ReverieEvalError


class EndpointError(ReverieEvalError):
    """The endpoint refused the request, or cannot be used."""


class BusyError(EndpointError):
    """A failure that a later attempt may overcome."""

    def __init__(self, message: str, retry_after: float | None = None) -> None:
        self.retry_after = retry_after
        """Seconds, if the endpoint asks for a pause."""
        super().__init__(message)


class CostLimitError(EndpointError):
    """What was allowed to be paid has been paid."""


class ModelError(ReverieEvalError):
    """The model replied, and there is no action in it: the agent ends where it is."""


class RefusalError(ModelError):
    """The model, or a filter in front of it, refused to reply."""


class CutReplyError(ModelError):
    """The reply was cut off where the allowed number of tokens ended."""


class WrongActionError(ModelError):
    """The reply has no action that can be done, also after it was said why."""


class LongPromptError(ModelError):
    """The messages are longer than the model can read."""
