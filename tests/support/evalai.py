"""EvalAI as a remote worker meets it, and workers that are held and killed.

What it accepts, refuses and does half is taken from EvalAI 0f0403929, ``apps/jobs/views.py`` and
``apps/jobs/serializers.py``; the queue is Amazon's SQS with the settings that EvalAI leaves it.
"""

import json
import os
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import count
from pathlib import Path
from typing import Any, Literal, NamedTuple
from urllib.parse import parse_qsl

from reverie_eval.server.platforms.evalai_worker import run_worker
from reverie_eval.server.settings import load_settings
from tests.support import killing
from tests.support.forking import Forked, Surroundings
from tests.support.waiting import PATIENCE

CHALLENGE, QUEUE, TOKEN = 606, "reverie-606-production.fifo", "0123456789abcdef0123456789abcdef"
LABELS = ("TL", "SR", "OSR", "SPL", "RGS", "RGSPL")
OVER = ("finished", "failed", "cancelled")
SECONDS_HIDDEN = 30
"""SQS's default for a message that was received and not deleted."""

Request = Literal["receive", "look up", "report running", "download", "report end", "remove"]
Moment = Literal["arrives", "is answered"]
Fault = Literal["refused", "busy", "hidden", "nonsense", "lost", "half"]
"""What goes wrong with a request: it is not handled (502, 429, or a page of a proxy, with 404 or
200); it is, and the reply is lost; or a result is written and the submission is not."""


class Step(NamedTuple):
    """A moment in the work of a worker."""

    request: Request
    number: int = 1
    """1 for the first request of this kind."""
    when: Moment = "arrives"


class Reply(NamedTuple):
    """What a request is answered with."""

    status: int
    content: bytes
    headers: Mapping[str, str] = {}


@dataclass
class Submission:
    """What somebody submitted."""

    number: int
    phase: int
    content: bytes | None
    """Of its file; None if the store has lost it."""
    status: str = "submitted"
    deleted: bool = False
    stdout: str = ""
    stderr: str = ""
    metadata: str = ""
    shown: Any = None
    """What the participant may download."""
    ends: list[str] = field(default_factory=list)
    """What was reported as its end, each time."""


@dataclass
class Message:
    """A message in the queue."""

    text: str
    hidden_until: float = 0.0
    handles: list[str] = field(default_factory=list)


class Refusal(Exception):  # noqa: N818  # of the emulated server, not of the test
    """A reply that is not a success."""

    def __init__(self, status: int, **document: str) -> None:
        self.status, self.document = status, document


def refusal(status: int, error: str) -> Refusal:
    """Refuse a request as EvalAI's views do."""
    return Refusal(status, error=error)


class EvalAI:
    """The server."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.url = ""
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.phases: dict[int, tuple[str, Sequence[str]]] = {}
        """The split and the leaderboard's labels of each phase."""
        self.submissions: dict[int, Submission] = {}
        self.messages: list[Message] = []
        self.rows: list[tuple[int, str, Mapping[str, float]]] = []
        """The leaderboard: submission, split, values."""
        self.requests: Counter[Request] = Counter()
        self.faults: dict[Request, list[Fault]] = {}
        self.hold: Step | None = None
        """Where a worker is held until it is let go."""
        self.held, self.let_go = threading.Event(), threading.Event()
        self.is_killed = True
        """Whether a worker that is held gets no answer any more."""
        self.while_downloaded: Callable[[], object] = lambda: None
        self.token_seen_by_store = False
        self.now = 0.0
        self._serial = count(1)

    def submit(self, phase: int, content: bytes | None) -> Submission:
        """Submit a file."""
        number = next(self._serial)
        self.submissions[number] = Submission(number, phase, content)
        body = {"challenge_pk": CHALLENGE, "phase_pk": phase, "submission_pk": number}
        self.messages.append(Message(json.dumps(body)))
        return self.submissions[number]

    def let_messages_return(self) -> None:
        """Let time pass until no message is hidden."""
        self.now += SECONDS_HIDDEN + 1

    def handle(self, method: str, path: str, headers: Mapping[str, str], body: bytes) -> Reply:
        """Answer a request, or raise ConnectionError."""
        with self._lock:
            name, action = self._find(method, path)
            self.requests[name] += 1
            step = Step(name, self.requests[name])
            faults = self.faults.get(name, [])
            fault = faults.pop(0) if faults else None
        self._hold(step)
        match fault:
            case "refused":
                return Reply(502, b"<html>Bad gateway</html>")
            case "busy":
                return Reply(429, b'{"detail": "Request was throttled."}', {"Retry-After": "0"})
            case "hidden":
                return Reply(404, b"<html>Not found</html>")
            case "nonsense":
                return Reply(200, b"<html>Please accept our terms</html>")
            case _:
                pass
        if name == "download":
            self.while_downloaded()
        with self._lock:
            try:
                content = action(headers, _form(headers, body), fault)
                reply = Reply(200, content if isinstance(content, bytes) else _json(content))
            except Refusal as refused:
                reply = Reply(refused.status, _json(refused.document))
        self._hold(step._replace(when="is answered"))
        if fault == "lost":
            raise ConnectionError
        return reply

    def _hold(self, step: Step) -> None:
        if step == self.hold:
            self.held.set()
            assert self.let_go.wait(PATIENCE)
            if self.is_killed:
                raise ConnectionError

    def _find(self, method: str, path: str) -> tuple[Request, Callable[..., Any]]:
        match method, path.strip("/").split("/"):
            case "GET", ["api", "jobs", "challenge", "queues", queue]:
                return "receive", self._for_host(lambda *_: self._receive(queue))
            case "POST", ["api", "jobs", "queues", queue]:
                return "remove", self._for_host(lambda form, _: self._remove(queue, form))
            case "GET", ["api", "jobs", "submission", number]:
                return "look up", self._for_host(lambda *_: self._look_up(int(number)))
            case "PATCH", ["api", "jobs", "challenge", challenge, "update_submission"]:
                return "report running", self._for_host(
                    lambda form, _: self._run(int(challenge), form)
                )
            case "PUT", ["api", "jobs", "challenge", challenge, "update_submission"]:
                return "report end", self._for_host(
                    lambda form, fault: self._end(int(challenge), form, fault)
                )
            case "GET", ["media", "submission_files", number, _]:
                return "download", lambda headers, *_: self._download(int(number), headers)
            case unknown:
                raise AssertionError(unknown)

    def _for_host(self, action: Callable[..., Any]) -> Callable[..., Any]:
        def checked(headers: Mapping[str, str], form: Mapping[str, str], fault: object) -> Any:
            if headers.get("Authorization") != f"Bearer {TOKEN}":
                raise Refusal(401, detail="Invalid token")
            return action(form, fault)

        return checked

    def _receive(self, queue: str) -> Any:
        self._check_queue(queue)
        for message in self.messages:
            if message.hidden_until <= self.now:
                message.hidden_until = self.now + SECONDS_HIDDEN
                message.handles.append(f"handle-{next(self._serial)}")
                try:
                    body = json.loads(message.text)
                except ValueError:
                    raise Refusal(500) from None
                return {"body": body, "receipt_handle": message.handles[-1]}
        return {"body": None, "receipt_handle": None}

    def _remove(self, queue: str, form: Mapping[str, str]) -> Any:
        self._check_queue(queue)
        handle = form["receipt_handle"]
        if not handle:
            raise refusal(400, "Please add message receipt handle in the body")
        self.messages = [each for each in self.messages if handle not in each.handles]
        return {"success": f"Message deleted successfully from the queue: {queue}"}

    def _check_queue(self, queue: str) -> None:
        if queue != QUEUE:
            raise refusal(400, f"Challenge with queue name {queue} does not exist")

    def _look_up(self, number: int) -> Any:
        submission = self.submissions.get(number)
        if submission is None:
            raise refusal(404, f"Submission {number} does not exist")
        return {
            "id": number,
            "participant_team_name": "Blue",
            "challenge_phase": submission.phase,
            "status": submission.status,
            "input_file": f"{self.url}/media/submission_files/{number}/file.json",
            "ignore_submission": submission.deleted,
            "job_name": [],
        }

    def _download(self, number: int, headers: Mapping[str, str]) -> bytes:
        self.token_seen_by_store |= "Authorization" in headers
        submission = self.submissions[number]
        if submission.content is None:
            raise Refusal(404)
        return submission.content

    def _run(self, challenge: int, form: Mapping[str, str]) -> Any:
        submission = self._submission(challenge, form)
        status = form.get("submission_status", "").lower()
        if status not in {"queued", "running"}:
            raise refusal(400, "Sorry, submission status is invalid")
        submission.status = status
        return {"id": submission.number, "status": status}

    def _end(self, challenge: int, form: Mapping[str, str], fault: object) -> Any:
        submission = self._submission(challenge, form)
        status = form.get("submission_status", "").lower()
        if status not in OVER:
            raise refusal(400, "Sorry, submission status is invalid")
        shown: list[Any] = []
        if status == "finished":
            try:
                results = json.loads(form.get("result", ""))
            except ValueError as error:
                raise refusal(
                    400, f"`result` key contains invalid data with error {error}."
                ) from None
            for result in results:
                self._write(submission, int(form["challenge_phase"]), result)
                shown += [result["accuracies"]] if result.get("show_to_participant") else []
        if fault == "half":  # the leaderboard is written in a transaction of its own
            raise Refusal(500)
        submission.status = status
        submission.ends.append(status)
        submission.stdout, submission.stderr = form.get("stdout", ""), form.get("stderr", "")
        submission.metadata, submission.shown = form.get("metadata", ""), shown
        return {"success": "Submission result has been successfully updated"}

    def _write(self, submission: Submission, phase: int, result: Mapping[str, Any]) -> None:
        split, labels = self.phases[phase]
        if result["split"] != split:
            raise refusal(
                400,
                f"Challenge Phase Split does not exist with phase_id: {phase} andsplit codename: "
                f"{result['split']}",
            )
        unknown = [label for label in result["accuracies"] if label not in labels]
        if unknown:
            raise refusal(400, f"Following metrics are missing in theleaderboard data: {unknown}")
        if not all(isinstance(value, int | float) for value in result["accuracies"].values()):
            raise refusal(400, "Values for following metrics are not offloat/int")
        # A row that exists is written again.
        self.rows = [row for row in self.rows if row[:2] != (submission.number, split)]
        self.rows.append((submission.number, split, result["accuracies"]))

    def _submission(self, challenge: int, form: Mapping[str, str]) -> Submission:
        if challenge != CHALLENGE:
            raise refusal(400, "Sorry, you are not authorized to make this request!")
        return self.submissions[int(form["submission"])]


def _form(headers: Mapping[str, str], body: bytes) -> Mapping[str, str]:
    if not body:
        return {}
    assert headers["Content-Type"] == "application/x-www-form-urlencoded"
    return dict(parse_qsl(body.decode(), keep_blank_values=True, strict_parsing=True))


def _json(document: Any) -> bytes:
    return json.dumps(document).encode()


@contextmanager
def working(folder: Path, log: Path, step: killing.Step | None = None) -> Iterator[Forked]:
    """Run a worker in a process of its own, which may be killed at a step.

    What it prints and logs goes to a file.
    """
    surroundings = Surroundings(folder, dict(os.environ), log, log)
    with Forked(_work, surroundings, folder, step) as process:
        try:
            yield process
        finally:
            process.kill()


def _work(folder: Path, step: killing.Step | None) -> None:
    if step is not None:
        killing.die_at(step, 1)
    run_worker(load_settings(folder), partial(print, flush=True))


@contextmanager
def serving_evalai() -> Iterator[EvalAI]:
    """Run the server until the end."""
    evalai = EvalAI()

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"
        wbufsize = -1  # a reply in one piece: two would wait for each other's arrival

        def answer(self) -> None:
            body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
            try:
                reply = evalai.handle(self.command, self.path, dict(self.headers), body)
                self.send_response(reply.status)
                for name, value in reply.headers.items():
                    self.send_header(name, value)
                self.send_header("Content-Length", str(len(reply.content)))
                self.end_headers()
                self.wfile.write(reply.content)
            except ConnectionError:
                self.close_connection = True

        do_GET = do_POST = do_PUT = do_PATCH = answer  # noqa: N815  # the library's names

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        server.daemon_threads = True
        evalai.url = f"http://127.0.0.1:{server.server_port}"
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        yield evalai
        server.shutdown()
        thread.join()
