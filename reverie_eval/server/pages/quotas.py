"""Each split for one person: whether it takes submissions, and what is left of the quota."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from reverie_eval.schemas.service import QuotaReport
from reverie_eval.server.http.callers import Snapshot
from reverie_eval.server.service.boards import Board
from reverie_eval.server.state import ServerState


@dataclass(frozen=True, slots=True)
class SplitQuota:
    """A split, for one person."""

    board: Board
    quota: QuotaReport
    is_open: bool
    opens_at: datetime | None
    """When the next phase begins; None if none will."""
    closes_at: datetime | None
    """When the phase ends that is open now; None if it does not, or none is."""


def split_quotas(server: ServerState, snapshot: Snapshot) -> Sequence[SplitQuota]:
    """Return what every split has for whoever is signed in."""
    quotas = server.intake.quotas(snapshot.session, snapshot.person)
    return [
        _split_quota(board, quotas[name], snapshot.now) for name, board in server.boards.items()
    ]


def _split_quota(board: Board, quota: QuotaReport, now: datetime) -> SplitQuota:
    phases = board.split.phases
    coming = [phase.opens for phase in phases if phase.opens and phase.opens > now]
    ending = [phase.closes for phase in phases if phase.is_open(now)]
    closing = [closes for closes in ending if closes is not None]
    return SplitQuota(
        board=board,
        quota=quota,
        is_open=board.is_open(now),
        opens_at=min(coming, default=None),
        closes_at=max(closing) if closing and len(closing) == len(ending) else None,
    )
