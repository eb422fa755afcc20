"""Sending messages to the organiser: by SMTP, and to a webhook as JSON."""

import hashlib
import hmac
from collections.abc import Callable, Iterator, Mapping, Sequence
from email.message import EmailMessage
from email.utils import format_datetime, make_msgid
from typing import Any

import httpx
import msgspec

from reverie_eval.server.audit.transactions import Clock, utc_now
from reverie_eval.server.messages.queue import claim, is_any_due, settle, unsent_errors
from reverie_eval.server.messages.smtp import SECONDS_TO_SEND, DeliveryError, send_letter
from reverie_eval.server.settings import Mail, Settings, Webhook
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.tables import Message
from reverie_eval.text import count_text

SIGNATURE = "X-Reverie-Signature"
"""The header with the HMAC-SHA256 of the body, under the webhook's secret."""

_UNKNOWN_SENDER = frozenset({401, 403})
"""Statuses of a webhook that does not accept the signature, or wants one."""

Send = Callable[[Sequence[Message]], None]


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
        host = webhook.url.host
        try:
            reply = httpx.post(
                str(webhook.url), content=body, headers=headers, timeout=SECONDS_TO_SEND
            )
        except httpx.HTTPError as error:
            raise DeliveryError(f"webhook.url: {host} cannot be reached: {error}") from None
        if reply.status_code in _UNKNOWN_SENDER:
            raise DeliveryError(
                f"webhook.secret: {host} replied with status {reply.status_code}; does it know the "
                "same secret?"
            )
        if not reply.is_success:
            raise DeliveryError(f"webhook.url: {host} replied with status {reply.status_code}")
