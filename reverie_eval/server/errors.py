"""What a request can come to besides success; one module maps them to status codes.

RequestError
    NotSignedInError      there is no such token, or it is not valid any more
    NotAllowedError       somebody else's
    ForgedError           a browser's request without the session's token, perhaps another site's
    NotFoundError         there is no such thing, or it is not the caller's to see
    ConflictError         what is there already stands against it
    NotOpenError          the split takes no submissions now
    QuotaSpentError       nothing is left; says when something is
    TooLargeError         more bytes than the server takes
    TooSlowError          the upload did not arrive in time
    TooManyError          more requests than an address or a token may make
    BusyError             more uploads than the server can hold
    MalformedError        the request, not the submission in it, is wrong
"""

from datetime import timedelta

from reverie_eval.errors import ReverieEvalError
from reverie_eval.server.service.quotas import QuotaState

NO_SUCH_METHOD = "this address is there for other methods; look at Allow"
NO_ROOM = (
    "the server has no room left to keep anything; nothing was spent. Tell the organiser, and send "
    "it again when there is room"
)
FAILED = (
    "the server failed, not your file. Send it again, no file is counted twice; if it fails again, "
    "tell the organiser this request's id: {id}"
)


class RequestError(ReverieEvalError):
    """A request that comes to nothing, and why."""


class NotSignedInError(RequestError):
    """There is no such token, or it is not valid any more."""


class NotAllowedError(RequestError):
    """What was asked for belongs to somebody else."""


class ForgedError(RequestError):
    """A browser's request without the session's token: perhaps another site has made it."""


class NotFoundError(RequestError):
    """There is no such thing, or it is not the caller's to see."""


class ConflictError(RequestError):
    """What is there already stands against it."""


class NotOpenError(RequestError):
    """The split takes no submissions now."""


class QuotaSpentError(RequestError):
    """Nothing is left."""

    def __init__(self, state: QuotaState) -> None:
        self.state = state
        super().__init__(
            f"no submission is left; {_next(state)}. Nothing was scored, and `validate` stays free"
        )


def _next(state: QuotaState) -> str:
    if state.next_at is None:
        return "the organiser's quota allows none"
    whole = state.next_at + timedelta(microseconds=999_999)  # rounded up, not down
    return f"the next is possible from {whole.isoformat(timespec='seconds')}"


class TooLargeError(RequestError):
    """More bytes than the server takes."""


class TooSlowError(RequestError):
    """The upload did not arrive in time."""


class TooManyError(RequestError):
    """More requests than an address or a token may make in a minute."""

    def __init__(self, seconds: int) -> None:
        self.seconds = seconds
        super().__init__(f"too many requests; try again in {seconds} seconds")


class BusyError(RequestError):
    """More uploads have come at once than the server can hold."""

    def __init__(self, seconds: int) -> None:
        self.seconds = seconds
        super().__init__(
            f"too many uploads at once; nothing was spent, send yours again in {seconds} seconds"
        )


class MalformedError(RequestError):
    """The request, not the submission in it, is wrong."""
