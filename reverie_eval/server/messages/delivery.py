"""Sending messages to the organiser: by SMTP, and to a webhook as JSON.

What fails is said with the setting to look at.
"""

import asyncio
import hashlib
import hmac
import smtplib
import ssl
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from email.message import EmailMessage
from email.utils import format_datetime, make_msgid
from functools import partial
from socket import SHUT_RDWR, gaierror
from threading import Event, Timer
from typing import Any

import httpx
import msgspec

from reverie_eval.errors import ReverieEvalError
from reverie_eval.server.audit.transactions import Clock, utc_now
from reverie_eval.server.messages.queue import claim, is_any_due, settle, unsent_errors
from reverie_eval.server.settings import Mail, Settings, Webhook
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.tables import Message
from reverie_eval.text import count_text

SECONDS_TO_SEND = 10
"""How long each step may take, such as to connect."""
SECONDS_TO_REPLY = 30
"""How long a webhook may take in all, and a mail server for each reply: one that sends it byte by
byte may need forever."""

SIGNATURE = "X-Reverie-Signature"
"""The header with the HMAC-SHA256 of the body, under the webhook's secret."""

_TLS, _STARTTLS = 'use "tls", usually on port 465', 'use "starttls", usually on port 587'
_UNKNOWN_SENDER = frozenset({401, 403})
"""Statuses of a webhook that does not accept the signature, or wants one."""

Send = Callable[[Sequence[Message]], None]


class DeliveryError(ReverieEvalError):
    """A message cannot be sent."""


def senders(settings: Settings) -> Mapping[str, Send]:
    """Return the function that sends messages through each channel."""
    found: dict[str, Send] = {}
    if settings.mail is not None:
        mail = settings.mail
        found["mail"] = lambda messages: _send_mail(settings, mail, messages)
    if settings.webhook is not None:
        webhook = settings.webhook
        found["webhook"] = lambda messages: _post(settings, webhook, messages)
    return found


def send_test(settings: Settings) -> Iterator[tuple[str, str]]:
    """Send a test message by each channel; yield the channel and an error, empty if it was sent."""
    now = utc_now()
    for name, send in senders(settings).items():
        text = "This is a test; the server can send you messages."
        message = Message(id=0, channel=name, event="test", text=text, path="/", created_at=now)
        yield name, _error_of(send, [message])


def deliver(database: Database, settings: Settings, channel: str, clock: Clock) -> None:
    """Send all messages that are due through a channel.

    Raises DeliveryError while messages wait that could not be sent before.
    """
    with database.reading() as session:
        is_due = is_any_due(session, clock(), channel)
    if is_due:
        with database.writing() as session:
            claimed = claim(session, clock(), channel)
        send = senders(settings)[channel]
        for messages in _parcels(channel, claimed):
            error = _error_of(send, messages)
            with database.writing() as session:
                settle(session, messages, clock(), error)
    with database.reading() as session:
        failed = unsent_errors(session, channel)
    if failed:
        waiting = count_text(len(failed), "message")
        kind = failed[-1].partition(":")[0]
        raise DeliveryError(f"{waiting} could not be sent yet ({kind}); test it: `server notify`")


def _parcels(channel: str, messages: Sequence[Message]) -> Sequence[Sequence[Message]]:
    """Group messages as they are sent: all in one mail, or one by one."""
    if channel == "mail":
        return [messages] if messages else []
    return [[message] for message in messages]


def _error_of(send: Send, messages: Sequence[Message]) -> str:
    try:
        send(messages)
    except (DeliveryError, ValueError) as error:  # the latter: text that a header cannot contain
        return " ".join(str(error).split())
    return ""


def _send_mail(settings: Settings, mail: Mail, messages: Sequence[Message]) -> None:
    is_one = len(messages) == 1
    subject = messages[0].text if is_one else count_text(len(messages), "message")
    letter = EmailMessage()
    letter["Subject"] = f"[{settings.title}] {subject}"
    letter["From"] = mail.sender
    letter["To"] = ", ".join(mail.recipients)
    letter["Date"] = format_datetime(utc_now())
    letter["Message-ID"] = make_msgid(domain=mail.sender.rpartition("@")[2])
    letter["Auto-Submitted"] = "auto-generated"
    letter.set_content("\n\n".join(_paragraph(settings, message) for message in messages))
    send_letter(mail, lambda: settings.mail_password, letter)


def send_letter(mail: Mail, password: Callable[[], str], letter: EmailMessage) -> None:
    """Send a letter.

    Raises
    ------
    DeliveryError
        Naming the setting that is wrong, as far as the mail server's reply tells.
    """
    context = ssl.create_default_context()
    with _blaming(mail, _why_not_connected):
        connect: Callable[..., smtplib.SMTP] = _Punctual
        if mail.security == "tls":
            connect = partial(_PunctualOverTls, context=context)
        smtp = connect(mail.host, mail.port, timeout=SECONDS_TO_SEND)
    with closing(smtp):
        if mail.security == "starttls":
            with _blaming(mail, _why_not_encrypted):
                smtp.starttls(context=context)
        if mail.user:
            with _blaming(mail, _why_not_logged_in):
                smtp.login(mail.user, password())
        with _blaming(mail, _why_not_taken):
            smtp.send_message(letter)
        with suppress(OSError):  # the letter is taken, whatever the reply
            smtp.quit()


class _LateError(smtplib.SMTPException):
    """A reply did not end in time."""


class _Punctual(smtplib.SMTP):
    """A connection to a mail server that is closed if a reply does not end in time."""

    def getreply(self) -> tuple[int, bytes]:
        """Return the next reply; raise _LateError if it takes longer than SECONDS_TO_REPLY."""
        is_late = Event()

        def hang_up() -> None:
            is_late.set()
            if (connection := self.sock) is not None:
                with suppress(OSError):  # the other side may have done so
                    connection.shutdown(SHUT_RDWR)

        timer = Timer(SECONDS_TO_REPLY, hang_up)
        timer.daemon = True  # as the thread of the job: the end of the server waits for neither
        timer.start()
        try:
            return super().getreply()
        finally:
            timer.cancel()
            if is_late.is_set():  # what had come until then may look like a reply
                self.close()
                raise _LateError


class _PunctualOverTls(_Punctual, smtplib.SMTP_SSL):
    """A connection that begins with TLS, and is closed if a reply does not end in time."""


@contextmanager
def _blaming(mail: Mail, why: Callable[[Mail, Exception], str]) -> Iterator[None]:
    """Turn errors of a step into ones that name a setting."""
    try:
        yield
    except _LateError:
        raise DeliveryError(f"mail.host: {_unpunctual(mail.host)}") from None
    except (OSError, ValueError) as error:  # smtplib's and TLS's are OSErrors
        reply = error.smtp_error if isinstance(error, smtplib.SMTPResponseException) else error
        text = reply.decode(errors="replace") if isinstance(reply, bytes) else str(reply)
        said = " ".join(text.split()) or type(error).__name__
        raise DeliveryError(f"{why(mail, error)}: {said}") from None


def _why_not_connected(mail: Mail, error: Exception) -> str:
    where = f"{mail.host} port {mail.port}"
    match error:
        case gaierror():
            return f"mail.host: there is no host {mail.host!r}"
        case ssl.SSLCertVerificationError():
            return _untrusted(mail)
        case ssl.SSLError():
            return f'mail.security: is "tls", but {where} does not begin with TLS; {_STARTTLS}'
        case smtplib.SMTPServerDisconnected() if mail.security != "tls":
            return (
                f'mail.security: is "{mail.security}", but {where} waits in silence, as ports do '
                f"that begin with TLS; {_TLS}"
            )
        case smtplib.SMTPException():
            return f"mail.host, mail.port: {where} is not a mail server, or takes no mail now"
        case _:
            return f"mail.host, mail.port: {where} cannot be reached"


def _why_not_encrypted(mail: Mail, error: Exception) -> str:
    if isinstance(error, ssl.SSLCertVerificationError):
        return _untrusted(mail)
    return (
        f'mail.security: is "starttls", but {mail.host} port {mail.port} does not offer it; '
        f'{_TLS}, or "none" for a mail server on this machine'
    )


def _why_not_logged_in(mail: Mail, error: Exception) -> str:
    match error:
        case smtplib.SMTPAuthenticationError():
            return f"mail.user, mail.password: {mail.host} refused the login of {mail.user!r}"
        case smtplib.SMTPNotSupportedError() if mail.security == "none":
            return f'mail.security: is "none", but {mail.host} takes no login without encryption'
        case smtplib.SMTPNotSupportedError():
            return f"mail.user: {mail.host} lets nobody log in; remove mail.user"
        case smtplib.SMTPException():
            return f"mail.user: {mail.host} did not accept a login"
        case _:
            return "mail.password_file: the file cannot be read"


def _why_not_taken(mail: Mail, error: Exception) -> str:
    match error:
        case smtplib.SMTPSenderRefused(smtp_code=530):
            return f"mail.user: {mail.host} wants a login; set mail.user and mail.password"
        case smtplib.SMTPSenderRefused():
            return f"mail.sender: {mail.host} refused {mail.sender}"
        case smtplib.SMTPRecipientsRefused():
            return f"mail.recipients: {mail.host} refused all of them"
        case _:
            return f"mail.host: {mail.host} did not take the letter"


def _untrusted(mail: Mail) -> str:
    return (
        f"mail.host: the certificate of {mail.host!r} is not trusted for this name; give the name "
        "in the certificate, or name the certificate of its issuer in SSL_CERT_FILE"
    )


def _unpunctual(host: object) -> str:
    return f"{host} did not reply within {count_text(SECONDS_TO_REPLY, 'second')}"


def _paragraph(settings: Settings, message: Message) -> str:
    when = f"{message.created_at:%Y-%m-%d %H:%M} UTC"
    return f"{message.text}\n{when}, {settings.public_address}{message.path}"


def _post(settings: Settings, webhook: Webhook, messages: Sequence[Message]) -> None:
    for message in messages:
        content: dict[str, Any] = {
            "id": message.id,
            "event": message.event,
            "text": message.text,
            "url": f"{settings.public_address}{message.path}",
            "at": message.created_at.isoformat(),
            "server": settings.title,
        }
        body = msgspec.json.encode(content)
        headers = {"Content-Type": "application/json"}
        if webhook.secret:
            digest = hmac.new(webhook.secret.encode(), body, hashlib.sha256).hexdigest()
            headers[SIGNATURE] = f"sha256={digest}"
        try:
            asyncio.run(_post_one(webhook, body, headers))
        except TimeoutError:
            raise DeliveryError(f"webhook.url: {_unpunctual(webhook.url.host)}") from None
        except httpx.RemoteProtocolError as error:
            raise DeliveryError(
                f"webhook.url: {webhook.url.host} does not answer as a web server does: {error}"
            ) from None
        except httpx.HTTPError as error:
            raise DeliveryError(
                f"webhook.url: {webhook.url.host} cannot be reached: {error}"
            ) from None


async def _post_one(webhook: Webhook, body: bytes, headers: Mapping[str, str]) -> None:
    async with (
        asyncio.timeout(SECONDS_TO_REPLY),
        httpx.AsyncClient(timeout=SECONDS_TO_SEND) as client,
        # The body of the reply is not read: it may be large, or never end.
        client.stream("POST", str(webhook.url), content=body, headers=headers) as reply,
    ):
        _check_reply(webhook, reply)


def _check_reply(webhook: Webhook, reply: httpx.Response) -> None:
    host, status = webhook.url.host, reply.status_code
    if status in _UNKNOWN_SENDER:
        raise DeliveryError(
            f"webhook.secret: {host} replied with status {status}; does it know the same secret?"
        )
    if reply.has_redirect_location:
        raise DeliveryError(
            f"webhook.url: {host} replied with status {status}, which redirects to "
            f"{reply.headers['Location']}; redirects are not followed: give the new address"
        )
    if not reply.is_success:
        raise DeliveryError(f"webhook.url: {host} replied with status {status}")
