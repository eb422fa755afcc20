"""Handing a letter to a mail server; what fails is said with the setting to look at."""

import smtplib
import ssl
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from email.message import EmailMessage
from functools import partial
from socket import gaierror

from reverie_eval.errors import ReverieEvalError
from reverie_eval.server.settings import Mail

SECONDS_TO_SEND = 10

_TLS, _STARTTLS = 'use "tls", usually on port 465', 'use "starttls", usually on port 587'


class DeliveryError(ReverieEvalError):
    """A message cannot be sent."""


def send_letter(mail: Mail, password: Callable[[], str], letter: EmailMessage) -> None:
    """Send a letter.

    Raises
    ------
    DeliveryError
        Naming the setting that is wrong, as far as the mail server's reply tells.
    """
    context = ssl.create_default_context()
    with _blaming(mail, _why_not_connected):
        connect: Callable[..., smtplib.SMTP] = smtplib.SMTP
        if mail.security == "tls":
            connect = partial(smtplib.SMTP_SSL, context=context)
        smtp = connect(mail.host, mail.port, timeout=SECONDS_TO_SEND)
    with smtp:
        if mail.security == "starttls":
            with _blaming(mail, _why_not_encrypted):
                smtp.starttls(context=context)
        if mail.user:
            with _blaming(mail, _why_not_logged_in):
                smtp.login(mail.user, password())
        with _blaming(mail, _why_not_taken):
            smtp.send_message(letter)


@contextmanager
def _blaming(mail: Mail, why: Callable[[Mail, Exception], str]) -> Iterator[None]:
    """Turn errors of a step into ones that name a setting."""
    try:
        yield
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
    return f"mail.host: the certificate of {mail.host!r} is not trusted for this name"
