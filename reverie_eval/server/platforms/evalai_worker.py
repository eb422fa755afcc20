"""A remote worker for EvalAI: scores the submissions of a challenge on the organiser's machine.

EvalAI delivers each message of its queue again until it is removed. So the worker first asks for
the state of the submission, and removes the message last: after a crash, a kill or a lost reply at
any step, the message comes again, and the submission is finished once. A submission that a worker
left running is finished by the next worker.
"""

import hashlib
import json
import logging
import logging.config
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from threading import Event
from typing import Any

from reverie_eval.errors import SubmissionError
from reverie_eval.metrics import CATALOGUE
from reverie_eval.server.boards.schedules import Schedules
from reverie_eval.server.operations.checks import opened_server
from reverie_eval.server.operations.logs import LOGGING
from reverie_eval.server.platforms.evalai_api import (
    End,
    EvalAIClient,
    EvalAIError,
    EvalAISubmission,
    MismatchError,
    UnavailableError,
)
from reverie_eval.server.platforms.scores import displayed_scores
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.settings import SETTINGS_FILE, Settings
from reverie_eval.server.state import ServerState
from reverie_eval.submissions import unpack

SECONDS_BETWEEN = 10
"""Seconds between two requests to an empty queue; EvalAI allows 60 requests a minute."""
LONGEST_PAUSE = 60
"""Seconds, at most, until a request is repeated, unless EvalAI asks for more."""
LONGEST_RETRY_AFTER = 600
"""Seconds that EvalAI may ask for, at most."""

_LOGGER = logging.getLogger("reverie_eval.server")
_FAULT = (
    "the evaluation failed, but not because of the file; the organisers can see why, and can run "
    "the submission again"
)


def run_worker(settings: Settings, announce: Callable[[str], None]) -> None:
    """Score submissions until SIGTERM or SIGINT; one that has begun is finished first.

    Parameters
    ----------
    settings : Settings
        Settings of the server, with a challenge on EvalAI.
    announce : callable
        Called with a line about what is scored.

    Raises
    ------
    SettingsError, ReceiptError
        If the server cannot be opened.
    EvalAIError
        If the settings name no challenge, or EvalAI refuses the token or the queue.
    """
    challenge = settings.evalai
    if challenge is None:
        file = settings.folder / SETTINGS_FILE
        raise EvalAIError(f"the settings have no section [evalai]; add it to {file}")
    with (
        EvalAIClient(challenge, settings.evalai_token) as client,
        opened_server(settings) as state,
        _stopping() as stopping,
    ):
        logging.config.dictConfig(LOGGING)
        announce(f"scoring submissions to challenge {challenge.challenge} at {challenge.url}")
        EvalAIWorker(client, state, stopping).run()


@dataclass(frozen=True)
class EvalAIWorker:
    """Scores the submissions in a challenge's queue, one after the other."""

    client: EvalAIClient
    state: ServerState
    stopping: Event = field(default_factory=Event)

    def run(self) -> None:
        """Score submissions until told to stop; if EvalAI does not answer, try again."""
        from tenacity import (
            Retrying,
            retry_if_exception_type,
            sleep_using_event,
            stop_when_event_set,
        )

        trying = Retrying(
            retry=retry_if_exception_type(UnavailableError),
            stop=stop_when_event_set(self.stopping),
            wait=pause_after,
            sleep=sleep_using_event(self.stopping),
            before_sleep=_tell,
            retry_error_callback=lambda _: False,
        )
        while not self.stopping.is_set():
            if not trying(self.take_one):
                self.stopping.wait(SECONDS_BETWEEN)

    def take_one(self) -> bool:
        """Handle a message of the queue; return whether there was one.

        Raises
        ------
        EvalAIError, UnavailableError
            As :class:`EvalAIClient`. Unfinished work continues when the message comes again.
        """
        message = self.client.receive()
        if message is None:
            return False
        try:
            if message.submission is None:
                _LOGGER.warning("message without a submission removed")
            else:
                self._handle(message.submission)
            self.client.remove(message)
        except MismatchError as error:
            fields = {"submission": message.submission, "reason": str(error)}
            _LOGGER.warning("message left in the queue", extra={"fields": fields})
        return True

    def _handle(self, number: int) -> None:
        """Finish a submission, whatever state an earlier worker left it in."""
        submission = self.client.submission(number)
        if submission is None:
            _log("submission does not exist", number)
            return
        if submission.is_over:
            _log("submission already finished", number, status=submission.status)
            return
        board = self._board(submission)
        if submission.status != "running":
            self.client.report_running(submission)
        end = self._evaluate(submission, board)
        latest = self.client.submission(number)
        if latest is None or latest.is_over:  # cancelled meanwhile, or another worker was faster
            _log("submission finished elsewhere", number)
            return
        self.client.report_end(submission, end)
        _log("submission finished", number, status=end.submission_status)

    def _board(self, submission: EvalAISubmission) -> Board:
        split = self.client.settings.phases.get(submission.challenge_phase)
        if split is None:
            raise MismatchError(
                f"it is to phase {submission.challenge_phase}, which the settings do not name in "
                "[evalai.phases]"
            )
        return self.state.board(split)

    def _evaluate(self, submission: EvalAISubmission, board: Board) -> End:
        """Fetch a submission's file and score it; return how it ends."""
        limits = self.state.settings.limits
        with self.state.database.reading() as session:
            schedule = self.state.get(Schedules).of_split(session, board.split).latest
        try:
            packed = self.client.download(submission, limits.upload_mebibytes << 20)
            content = unpack(packed, limits.unpacked_mebibytes << 20)
            return _scored(board, content, is_shown=not schedule.holds_scores_back)
        except SubmissionError as error:
            return End("FAILED", stderr=str(error))
        except UnavailableError:
            raise
        except Exception:
            _LOGGER.exception("submission could not be scored")
            return End("FAILED", stderr=_FAULT)


def _scored(board: Board, content: bytes, *, is_shown: bool) -> End:
    """Score a submission's JSON text; ``is_shown`` says whether participants see the scores now."""
    report = board.scored(content).report
    scores = displayed_scores(report, [metric.key for metric in board.headline])
    result = {
        "split": board.split,
        "show_to_participant": is_shown,
        "accuracies": {CATALOGUE[key].label: value for key, value in scores.items()},
    }
    about = {
        "signature": report.signature,
        "fingerprint": report.fingerprint,
        "sha256": hashlib.sha256(content).hexdigest(),
    }
    return End(
        "FINISHED",
        stdout="\n".join([report.signature, *report.notes]),
        result=json.dumps([result], allow_nan=False),
        metadata=json.dumps(about),
    )


def _log(event: str, submission: int, **fields: str) -> None:
    _LOGGER.info(event, extra={"fields": {"submission": submission, **fields}})


def _tell(attempt: Any) -> None:
    """Log why EvalAI is tried again; ``attempt`` is tenacity's ``RetryCallState``."""
    fields = {"reason": str(attempt.outcome.exception()), "seconds": attempt.upcoming_sleep}
    _LOGGER.warning("retrying EvalAI", extra={"fields": fields})


def pause_after(attempt: Any) -> float:
    """Return the seconds until EvalAI is tried again; ``attempt`` is as for :func:`_tell`."""
    from tenacity import wait_exponential

    asked: float | None = attempt.outcome.exception().retry_after
    if asked is None:
        return wait_exponential(max=LONGEST_PAUSE)(attempt)
    return min(asked, LONGEST_RETRY_AFTER)


@contextmanager
def _stopping() -> Iterator[Event]:
    """Yield an event that the first SIGTERM or SIGINT sets; a second one ends the process."""
    event = Event()
    before: dict[int, Any] = {}

    def stop(*_: object) -> None:
        event.set()
        restore()

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    for number in (signal.SIGTERM, signal.SIGINT):
        before[number] = signal.signal(number, stop)
    try:
        yield event
    finally:
        restore()
