"""Telling the organiser that the server is unhealthy."""

from contextlib import suppress

from sqlalchemy.exc import SQLAlchemyError

from reverie_eval.server.audit.log import SERVER
from reverie_eval.server.errors import RequestError
from reverie_eval.server.messages.outbox import notify_of_fault
from reverie_eval.server.state import ServerState


def tell_fault(server: ServerState, text: str) -> None:
    """Notify the organiser of a fault, unless the fault prevents it, or no channel is set up."""
    if not server.settings.channels:
        return
    with (
        suppress(SQLAlchemyError, RequestError),
        server.transactions.begin(SERVER) as transaction,
    ):
        notify_of_fault(transaction, text)
