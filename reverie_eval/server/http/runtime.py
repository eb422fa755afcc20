"""The state of one running application: admission of uploads, metrics, health."""

from dataclasses import dataclass
from typing import Annotated, Self

from fastapi import Depends, Request

from reverie_eval.server.http.admission import Admission
from reverie_eval.server.http.health import Health
from reverie_eval.server.http.metrics import Metrics
from reverie_eval.server.state import ServerState


@dataclass(frozen=True)
class RuntimeState:
    """Admission, metrics and health checks of an application."""

    admission: Admission
    metrics: Metrics
    health: Health

    @classmethod
    def of(cls, server: ServerState) -> Self:
        """Create them for a server."""
        limits = server.settings.limits
        admission = Admission(
            limits.uploads_at_once, limits.uploads_waiting, limits.seconds_for_body
        )
        metrics = Metrics(server.boards, lambda: admission.waiting)
        return cls(admission, metrics, Health(server))


async def runtime_of(request: Request) -> RuntimeState:
    """Return the state of the application that answers a request."""
    runtime: RuntimeState = request.app.state.runtime
    return runtime


Runtime = Annotated[RuntimeState, Depends(runtime_of)]
