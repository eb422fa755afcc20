"""Messages to the organiser, by real mail and HTTP servers: sent, late or given up, never lost."""

import hashlib
import hmac
import json
import ssl
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from email import message_from_bytes, policy
from email.message import EmailMessage
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import cycle
from pathlib import Path
from socketserver import BaseRequestHandler, ThreadingTCPServer
from typing import Any

import pytest
from aiosmtpd.controller import Controller
from aiosmtpd.smtp import AuthResult
from sqlalchemy import select

from reverie_eval.schemas.service import Phase
from reverie_eval.server.app import jobs_of
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.messages import delivery
from reverie_eval.server.messages.delivery import SIGNATURE, DeliveryError
from reverie_eval.server.messages.queue import LEASE, PATIENCE, claim, notify
from reverie_eval.server.operations import health
from reverie_eval.server.operations.doctor import examine
from reverie_eval.server.settings import Mail, Settings, SettingsError, Webhook, load_settings
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.tables import Message
from tests.client.test_client_failures import certificate
from tests.support.acting import NOON
from tests.support.flat_world import Run
from tests.support.ports import free_port
from tests.support.serving import (
    OPEN,
    OWNER,
    PRIVATE,
    OpenServer,
    Serving,
    adjusted,
    running,
    settings_of,
    submission_for,
)
from tests.support.waiting import PATIENCE as SECONDS_OF_PATIENCE
from tests.support.waiting import wait_until

SECRET = "of the webhook"
DAYS = timedelta(days=1)
ADDRESS = "https://eval.example.org"
UNTRUSTED = (
    "mail.host: the certificate of '127.0.0.1' is not trusted for this name; give the name in the "
    "certificate, or name the certificate of its issuer in SSL_CERT_FILE: "
)


class Mailbox:
    """Keeps the mails that an SMTP server accepts."""

    def __init__(self) -> None:
        self.mails: list[EmailMessage] = []

    async def handle_DATA(self, _: Any, __: Any, envelope: Any) -> str:  # noqa: N802  # aiosmtpd
        """Accept a mail."""
        mail = message_from_bytes(envelope.content, policy=policy.default)
        assert isinstance(mail, EmailMessage)
        self.mails.append(mail)
        return "250 OK"


@dataclass
class Hook:
    """Keeps the requests that an HTTP server gets, and replies with a status and headers."""

    port: int = 0
    status: int = 204
    headers: Mapping[str, str] = field(default_factory=dict)
    """With a `Content-Length`, the body never comes."""
    requests: list[tuple[Mapping[str, str], bytes]] = field(default_factory=list)

    def events(self) -> list[str]:
        """Return the kinds of events that it was told."""
        return [json.loads(body)["event"] for _, body in self.requests]


@contextmanager
def mail_server(box: Mailbox, port: int | None = None, **about: Any) -> Iterator[int]:
    """Run an SMTP server, which may take its time to start, and give its port."""
    port = port or free_port()
    about |= {"hostname": "127.0.0.1", "port": port, "ready_timeout": SECONDS_OF_PATIENCE}
    server = Controller(box, **about)
    server.start()
    try:
        yield port
    finally:
        server.stop()


@pytest.fixture
def mailbox() -> Iterator[tuple[Mailbox, int]]:
    """Run an SMTP server; give its mailbox and its port."""
    box = Mailbox()
    with mail_server(box) as port:
        yield box, port


@contextmanager
def hooked(reply: Callable[[BaseHTTPRequestHandler, Hook], None]) -> Iterator[Hook]:
    """Run an HTTP server that keeps each request and replies as a function does."""
    kept = Hook()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            kept.requests.append((dict(self.headers), body))
            reply(self, kept)

        def log_message(self, *_: object) -> None:
            """Print nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    kept.port = server.server_port
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield kept
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture
def hook() -> Iterator[Hook]:
    """Run an HTTP server."""

    def reply(request: BaseHTTPRequestHandler, kept: Hook) -> None:
        request.send_response(kept.status)
        for name, value in kept.headers.items():
            request.send_header(name, value)
        request.end_headers()
        if "Content-Length" in kept.headers:
            request.rfile.read(1)  # until the other side hangs up

    with hooked(reply) as kept:
        yield kept


def mail_to(port: int, **others: Any) -> Mail:
    return Mail(
        host="127.0.0.1",
        port=port,
        security="none",
        sender="reverie@lab.example.org",
        recipients=("olga@lab.example.org",),
        **others,
    )


def hook_at(hook: Hook, **others: Any) -> Webhook:
    return Webhook.model_validate(
        {"url": f"http://127.0.0.1:{hook.port}/", "secret": SECRET, **others}
    )


Open = Any


@pytest.fixture
def telling(folder: Path, open_server: OpenServer) -> Open:
    """Return what opens a server that tells the organiser of events."""

    def opened(**channels: Any) -> Serving:
        told = settings_of(folder).model_copy(update={"public_address": ADDRESS, **channels})
        return open_server(told)

    return opened


def deliver_now(server: Serving, **later: float) -> None:
    """Do the jobs of a server once, each after the one before."""
    now = server.clock.now
    server.clock.turn(**later)
    for job in jobs_of(server.state).jobs:
        with suppress(DeliveryError):
            job.work()
    server.clock.now = now


def messages(server: Serving) -> list[Message]:
    with server.state.database.reading() as session:
        return list(session.scalars(select(Message).order_by(Message.id)))


def test_without_channels_nothing_is_written(server: Serving) -> None:
    server.upload(OWNER)
    assert messages(server) == []


def test_an_upload_is_told_by_mail_and_webhook_without_its_scores(
    telling: Open, mailbox: tuple[Mailbox, int], hook: Hook
) -> None:
    box, port = mailbox
    server = telling(mail=mail_to(port), webhook=hook_at(hook))
    accepted = server.upload(OWNER, submission_for(PRIVATE), PRIVATE, name="Wälker").json()
    deliver_now(server)
    deliver_now(server)
    (mail,) = box.mails
    text = f"Blue ({OWNER}) submitted Wälker to {PRIVATE}"
    link = f"{ADDRESS}/submissions/{accepted['submission']['id']}"
    assert mail["Subject"] == f"[{server.state.settings.title}] {text}"
    assert mail["To"] == "olga@lab.example.org"
    assert mail.get_content().splitlines()[:2] == [text, f"2026-03-02 12:00 UTC, {link}"]
    ((headers, body),) = hook.requests
    expected = hmac.new(SECRET.encode(), body, hashlib.sha256).hexdigest()
    assert headers[SIGNATURE] == f"sha256={expected}"
    said = json.loads(body)
    assert (said["event"], said["text"], said["url"]) == ("submission", text, link)
    score = f"{accepted['submission']['report']['scores']['path_length']}"
    assert score not in body.decode() + mail.get_content()


def test_a_repeat_or_a_refused_file_is_not_told(telling: Open, hook: Hook) -> None:
    server = telling(webhook=hook_at(hook))
    for content in (submission_for(OPEN), submission_for(OPEN), b"[]"):
        server.upload(OWNER, content)
    deliver_now(server)
    assert hook.events() == ["submission"]


def test_a_request_to_join_is_told_without_addresses(telling: Open, hook: Hook) -> None:
    server = telling(webhook=hook_at(hook))
    asked = {
        "team": "Green",
        "people": [{"name": "Dora", "email": "dora@example.org"}],
        "institution": "University of Adelaide",
    }
    for _ in range(2):
        assert server.ask(None, "POST", "/join", json=asked).is_success
    deliver_now(server)
    ((_, body),) = hook.requests
    said = json.loads(body)
    assert said["text"] == "1 person of University of Adelaide asked to join as Green"
    assert said["url"] == f"{ADDRESS}/desk/requests"


def test_the_end_of_a_phase_is_told_once(folder: Path, open_server: OpenServer, hook: Hook) -> None:
    phases = (Phase(name="challenge", closes=NOON), Phase(name="old", closes=NOON - DAYS * 2))
    told = settings_of(folder).model_copy(update={"webhook": hook_at(hook)})
    server = open_server(adjusted(told, phases=phases))
    deliver_now(server)  # in the last second of the phase
    assert hook.events() == []
    for _ in range(2):
        server.clock.turn(seconds=1)
        deliver_now(server)
    ((_, body),) = hook.requests
    text = f"the phase challenge of {PRIVATE} ended at 2026-03-02 12:00 UTC"
    assert (json.loads(body)["event"], json.loads(body)["text"]) == ("phase-end", text)


def test_only_the_events_of_a_channel_are_told(telling: Open, hook: Hook) -> None:
    server = telling(webhook=hook_at(hook, events=["join-request"]))
    with server.acting() as transaction:
        notify(transaction, "phase-end", "test ended")
        notify(transaction, "join-request", "Dora wants to join")
    deliver_now(server)
    assert hook.events() == ["join-request"]


def test_a_transaction_that_fails_tells_nothing(telling: Open, hook: Hook) -> None:
    server = telling(webhook=hook_at(hook))
    with server.state.database.trying() as session:
        now, log = server.clock(), server.state.audit_log
        transaction = Transaction(session, "test", now, log, server.state.settings.channels)
        notify(transaction, "phase-end", "test ended")
    assert messages(server) == []


def test_a_dead_channel_is_tried_later_and_given_up_and_delays_no_other(
    telling: Open, hook: Hook
) -> None:
    server = telling(mail=mail_to(1), webhook=hook_at(hook))
    assert server.upload(OWNER).status_code == 201
    for _ in range(40):
        deliver_now(server)
        server.clock.turn(hours=3)
    mail, sent = messages(server)
    assert sent.sent_at is not None
    assert hook.events() == ["submission"]
    assert "Connection refused" in mail.error
    assert mail.given_up_at is not None
    assert timedelta(0) <= PATIENCE - (mail.given_up_at - mail.created_at) < timedelta(hours=10)
    findings = list(examine(server.state.settings.folder))
    (note,) = [finding for finding in findings if finding.check == "messages"]
    assert note.kind == "note"
    assert "1 message to the organiser could not be sent by mail" in note.what


def test_a_webhook_that_refuses_is_asked_again(telling: Open, hook: Hook) -> None:
    server = telling(webhook=hook_at(hook))
    hook.status = 500
    server.upload(OWNER)
    deliver_now(server)
    assert messages(server)[0].error == "webhook.url: 127.0.0.1 replied with status 500"
    hook.status = 200
    deliver_now(server)
    assert len(hook.requests) == 1  # not yet
    deliver_now(server, minutes=1)
    assert messages(server)[0].sent_at is not None


def test_a_digest_is_one_mail_for_each_day(telling: Open, mailbox: tuple[Mailbox, int]) -> None:
    box, port = mailbox
    server = telling(mail=mail_to(port, digest="daily"))
    for _ in range(3):
        server.upload(OWNER, server.distinct())
        server.clock.turn(hours=3)
    deliver_now(server)
    assert box.mails == []
    server.clock.now = datetime(2026, 3, 3, tzinfo=UTC)
    server.upload(OWNER, server.distinct())
    deliver_now(server)
    (mail,) = box.mails
    assert mail["Subject"].endswith("] 3 messages")
    assert mail.get_content().count("submitted") == 3


def test_a_message_is_claimed_by_one_server(database_of_two: Database) -> None:
    now = datetime(2026, 3, 2, 12, tzinfo=UTC)
    with database_of_two.writing() as session:
        assert len(claim(session, now, "mail")) == 1
    with database_of_two.writing() as session:
        assert claim(session, now, "mail") == []
    with database_of_two.writing() as session:  # whose server was killed
        assert [each.attempts for each in claim(session, now + LEASE, "mail")] == [2]


@pytest.fixture
def database_of_two(empty_database: str) -> Iterator[Database]:
    """Return a database with a message, of each kind."""
    database = Database(empty_database)
    database.upgrade()
    now = datetime(2026, 3, 2, 12, tzinfo=UTC)
    told = {"channel": "mail", "event": "submission", "text": "", "path": "/", "error": ""}
    with database.writing() as session:
        session.add(Message(**told, created_at=now, due_at=now, attempts=0))
        session.add(Message(**told, created_at=now, due_at=now + PATIENCE, attempts=0))
    yield database
    database.close()


def test_a_server_that_is_unwell_says_so_once_an_hour(
    telling: Open, hook: Hook, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = telling(webhook=hook_at(hook))
    monkeypatch.setattr(health, "SECONDS_KEPT", 0)
    uploads = server.state.settings.folder / "uploads"
    for _ in range(2):
        uploads.write_text("not a folder")
        assert server.client.get("/healthz").status_code == 503
        assert server.client.get("/healthz").status_code == 503
        uploads.unlink()
        assert server.client.get("/healthz").status_code == 200
    deliver_now(server)
    ((_, body),) = hook.requests
    assert json.loads(body)["text"] == "the server is unhealthy: uploads"


def written(folder: Path, port: int, hook: Hook) -> Path:
    """Write channels into the settings of a folder."""
    file = folder / "reverie-eval.toml"
    file.write_text(
        f"""{file.read_text()}
[mail]
host = "127.0.0.1"
port = {port}
security = "none"
sender = "reverie@lab.example.org"
recipients = ["olga@lab.example.org"]
[webhook]
url = "http://127.0.0.1:{hook.port}/"
"""
    )
    return file


def test_notify_says_whether_the_settings_work(
    folder: Path, mailbox: tuple[Mailbox, int], hook: Hook, run: Run
) -> None:
    assert run("server", "notify", str(folder)).status == 2
    box, port = mailbox
    file = written(folder, port, hook)
    assert run("server", "notify", str(folder)) == (0, "mail: sent\nwebhook: sent\n", "")
    assert "This is a test" in box.mails[0].get_content()
    assert SIGNATURE not in hook.requests[0][0]
    file.write_text(file.read_text().replace('security = "none"', 'user = "reverie"'))
    outcome = run("server", "notify", str(folder))
    assert outcome.status == 1
    assert outcome.out.startswith('mail: mail.security: is "starttls", but 127.0.0.1 port')


def reason(folder: Path, run: Run, **mail: Any) -> str:
    """Set up mail, and return why the test message was not sent."""
    about = {"sender": "a@b.org", "recipients": ["c@d.org"], "host": "127.0.0.1", **mail}
    lines = [f"{name} = {json.dumps(value)}" for name, value in about.items()]
    file = folder / "reverie-eval.toml"
    plain, *_ = file.read_text().partition("\n[mail]")
    file.write_text("\n".join([plain, "[mail]", *lines, ""]))
    outcome = run("server", "notify", str(folder))
    assert outcome.status == 1
    return outcome.out.removeprefix("mail: ")


@pytest.fixture
def tls_port(tmp_path: Path) -> Iterator[int]:
    """Run a mail server that begins with TLS, and has a certificate that nobody signed."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate(tmp_path))
    with mail_server(Mailbox(), ssl_context=context) as port:
        yield port


class Refusing(Mailbox):
    """Refuses senders and recipients by their names, and every login."""

    async def handle_MAIL(self, _: Any, __: Any, envelope: Any, address: str, ___: Any) -> str:  # noqa: N802
        """Refuse a sender."""
        envelope.mail_from = address
        return {"x": "550 no", "y": "530 log in"}.get(address[0], "250 OK")

    async def handle_RCPT(self, *_: Any) -> str:  # noqa: N802
        """Refuse every recipient."""
        return "550 no such user"


@pytest.fixture
def refusing_port() -> Iterator[int]:
    """Run a mail server that refuses everything."""

    def refuse(*_: object) -> AuthResult:
        return AuthResult(success=False, handled=False)

    with mail_server(Refusing(), authenticator=refuse, auth_require_tls=False) as port:
        yield port


@pytest.fixture
def ports(mailbox: tuple[Mailbox, int], tls_port: int, refusing_port: int) -> tuple[int, int, int]:
    """Return the ports of three mail servers."""
    return mailbox[1], tls_port, refusing_port


def test_why_no_mail_is_sent_is_said_by_the_setting(
    folder: Path, ports: tuple[int, int, int], run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    port, tls_port, refusing_port = ports
    closed = free_port()
    plain = {"port": port, "security": "none"}
    refusing = {"port": refusing_port, "security": "none"}
    cases: list[tuple[dict[str, Any], str]] = [
        ({"host": "nowhere.invalid"}, "mail.host: there is no host 'nowhere.invalid'"),
        ({"port": closed}, "mail.host, mail.port: 127.0.0.1 port"),
        ({"port": port}, 'mail.security: is "starttls", but'),
        ({"port": port, "security": "tls"}, 'mail.security: is "tls", but'),
        ({"port": tls_port}, 'mail.security: is "starttls", but'),
        ({"port": tls_port, "security": "none"}, 'mail.security: is "none", but'),
        ({"port": tls_port, "security": "tls"}, UNTRUSTED),
        ({**plain, "user": "reverie"}, 'mail.security: is "none", but'),
        ({**refusing, "user": "reverie"}, "mail.user, mail.password: 127.0.0.1 refused the login"),
        ({**plain, "user": "reverie", "password_file": "none"}, "mail.password_file: "),
        ({**refusing, "sender": "x@b.org"}, "mail.sender: 127.0.0.1 refused x@b.org"),
        ({**refusing, "sender": "y@b.org"}, "mail.user: 127.0.0.1 wants a login"),
        (refusing, "mail.recipients: 127.0.0.1 refused all of them"),
    ]
    for section, expected in cases:
        with monkeypatch.context() as patched:
            patched.setenv("REVERIE_EVAL_MAIL__PASSWORD", "hunter2")
            if section.get("port") == tls_port:  # which waits for the client to begin
                patched.setattr(delivery, "SECONDS_TO_SEND", 1)
            said = reason(folder, run, **section)
        assert said.startswith(expected), said
        assert "hunter2" not in said


def test_why_a_webhook_is_not_told(folder: Path, hook: Hook, run: Run) -> None:
    file = folder / "reverie-eval.toml"
    plain = file.read_text()
    closed = free_port()
    hook.headers = {"Location": "https://new.example.org/"}
    redirects = "which redirects to https://new.example.org/; redirects are not followed"
    for port, status, expected in (
        (hook.port, 401, "webhook.secret: 127.0.0.1 replied with status 401"),
        (hook.port, 404, "webhook.url: 127.0.0.1 replied with status 404"),
        (hook.port, 308, f"webhook.url: 127.0.0.1 replied with status 308, {redirects}"),
        (hook.port, 999999, "webhook.url: 127.0.0.1 does not answer as a web server does"),
        (closed, 0, "webhook.url: 127.0.0.1 cannot be reached"),
    ):
        hook.status = status
        file.write_text(f'{plain}\n[webhook]\nurl = "http://127.0.0.1:{port}/"\n')
        assert run("server", "notify", str(folder)).out.startswith(f"webhook: {expected}")


def test_a_webhook_whose_reply_does_not_end_has_got_the_message(telling: Open, hook: Hook) -> None:
    hook.status, hook.headers = 200, {"Content-Length": "1000"}
    server = telling(webhook=hook_at(hook))
    server.upload(OWNER)
    deliver_now(server)
    (message,) = messages(server)
    assert (message.error, message.sent_at is not None) == ("", True)


@pytest.fixture
def dripping() -> Iterator[Hook]:
    """Run an HTTP server whose replies are headers without an end, byte by byte."""
    is_over = threading.Event()

    def reply(request: BaseHTTPRequestHandler, _: Hook) -> None:
        request.wfile.write(b"HTTP/1.1 200 OK\r\nX-Long: ")
        with suppress(OSError):  # the other side hangs up
            while not is_over.wait(0.01):
                request.wfile.write(b"x")

    with hooked(reply) as kept:
        yield kept
        is_over.set()


def test_a_webhook_whose_headers_do_not_end_is_told_the_next_message_nevertheless(
    telling: Open, dripping: Hook, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(delivery, "SECONDS_TO_REPLY", 1)
    server = telling(webhook=hook_at(dripping))
    for _ in range(2):
        server.upload(OWNER, server.distinct())
    deliver_now(server)
    expected = "webhook.url: 127.0.0.1 did not reply within 1 second"
    assert [each.error for each in messages(server)] == [expected] * 2
    assert dripping.events() == ["submission"] * 2


@pytest.mark.parametrize(
    ("first", "drip"),
    [
        pytest.param(b"220 ", b"x", id="a greeting without an end"),
        pytest.param(b"220-", b"x\r\n220-", id="a greeting of lines without an end"),
        pytest.param(b"220 here\r\n250-", b"x\r\n250-", id="a second reply without an end"),
    ],
)
def test_a_mail_server_whose_reply_does_not_end_holds_up_no_job(
    first: bytes, drip: bytes, telling: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(delivery, "SECONDS_TO_REPLY", 1)
    is_over = threading.Event()

    class Dripping(BaseRequestHandler):
        def handle(self) -> None:
            self.request.sendall(first)
            with suppress(OSError):  # the other side hangs up
                for byte in cycle(drip):
                    if is_over.wait(0.01):
                        break
                    self.request.sendall(bytes([byte]))

    with ThreadingTCPServer(("127.0.0.1", 0), Dripping) as dripping:
        thread = threading.Thread(target=dripping.serve_forever)
        thread.start()
        server = telling(mail=mail_to(dripping.server_address[1]))
        server.upload(OWNER)
        deliver_now(server)
        is_over.set()
        dripping.shutdown()
        thread.join()
    (message,) = messages(server)
    assert message.error == "mail.host: 127.0.0.1 did not reply within 1 second"


def test_the_doctor_tells_of_faults(
    folder: Path, mailbox: tuple[Mailbox, int], hook: Hook, run: Run, server: Serving
) -> None:
    server.upload(OWNER)
    written(folder, mailbox[1], hook)
    for upload in (folder / "uploads").rglob("*.gz"):
        upload.unlink()
    assert run("server", "doctor", str(folder)).status == 1
    (mail, webhook) = messages(server)
    assert {mail.channel, webhook.channel} == {"mail", "webhook"}
    assert mail.text.startswith("server doctor found 1 fault: uploads: ")


def test_a_running_server_sends_by_itself(
    folder: Path, hook: Hook, open_server: OpenServer, mailbox: tuple[Mailbox, int]
) -> None:
    server = open_server(settings_of(folder))
    written(folder, mailbox[1], hook)
    with server.state.database.writing() as session:
        now = datetime.now(UTC)
        told = {"channel": "webhook", "event": "submission", "text": "x", "path": "/"}
        session.add(Message(**told, created_at=now, due_at=now, attempts=0, error=""))
    with running(folder):
        wait_until(lambda: hook.events() == ["submission"])


WRONG: list[tuple[str, str]] = [
    (
        '[mail]\nhost = "x"\nsender = "nobody"\nrecipients = ["a@b.org"]',
        "mail.sender: got 'nobody'",
    ),
    ('[mail]\nhost = "x"\nsender = "a@b.org"\nrecipients = []', "mail.recipients"),
    ('[webhook]\nurl = "ftp://b.org"', "webhook.url"),
    ('[webhook]\nurl = "https://b.org"\nevents = ["lunch"]', "webhook.events.0: got 'lunch'"),
]


@pytest.mark.parametrize(("section", "message"), WRONG)
def test_wrong_settings_are_named(section: str, message: str, folder: Path) -> None:
    file = folder / "reverie-eval.toml"
    file.write_text(f"{file.read_text()}\n{section}\n")
    with pytest.raises(SettingsError) as refused:
        load_settings(folder)
    assert message in str(refused.value)


def test_a_password_comes_from_a_private_file_or_a_variable_and_is_never_shown(
    folder: Path,
    mailbox: tuple[Mailbox, int],
    hook: Hook,
    monkeypatch: pytest.MonkeyPatch,
    run: Run,
) -> None:
    file = written(folder, mailbox[1], hook)
    monkeypatch.setenv("REVERIE_EVAL_MAIL__PASSWORD", "hunter2")
    settings: Settings = load_settings(folder)
    assert settings.mail_password == "hunter2"
    assert "hunter2" not in repr(settings)
    file.write_text(file.read_text().replace("\n[webhook]", '\npassword_file = "pw"\n[webhook]'))
    assert run("server", "doctor", "--quick", str(folder)).status == 1
    (folder / "pw").write_text("from a file\n")
    (folder / "pw").chmod(0o600)
    assert load_settings(folder).mail_password == "from a file"
    assert run("server", "doctor", "--quick", str(folder)).status == 0
    (folder / "pw").chmod(0o644)
    told = run("server", "doctor", "--quick", str(folder)).out
    assert "other users can read" in " ".join(told.split())
