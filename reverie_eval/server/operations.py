"""What an application has for its own upkeep: its gate for uploads, its counts, its health."""

from dataclasses import dataclass
from typing import Annotated, Self

from fastapi import Depends, Request

from reverie_eval.server.edge.admission import Admission
from reverie_eval.server.health import Health
from reverie_eval.server.metrics import Metrics
from reverie_eval.server.state import ServerState


@dataclass(frozen=True)
class Operations:
    """One of each for every application."""

    admission: Admission
    metrics: Metrics
    health: Health

    @classmethod
    def of(cls, server: ServerState) -> Self:
        """Make them for a server."""
        limits = server.settings.limits
        admission = Admission(
            limits.uploads_at_once, limits.uploads_waiting, limits.seconds_for_body
        )
        metrics = Metrics(server.boards, lambda: admission.waiting)
        return cls(admission, metrics, Health(server))


def operations_of(request: Request) -> Operations:
    """Return those of the application that answers a request."""
    operations: Operations = request.app.state.operations
    return operations


Upkeep = Annotated[Operations, Depends(operations_of)]
