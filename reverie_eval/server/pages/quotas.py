"""Each split for one person: whether it takes submissions, and what is left of the quota."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from reverie_eval.schemas.service import QuotaReport
from reverie_eval.server.service.boards import Board
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.tables import Person


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


def split_quotas(server: ServerState, person: Person) -> Sequence[SplitQuota]:
    """Return what every split has for somebody."""
    return [_split_quota(server, board, person) for board in server.boards.values()]


def _split_quota(server: ServerState, board: Board, person: Person) -> SplitQuota:
    now, phases = server.clock(), board.split.phases
    coming = [phase.opens for phase in phases if phase.opens and phase.opens > now]
    ending = [phase.closes for phase in phases if phase.is_open(now)]
    closing = [closes for closes in ending if closes is not None]
    return SplitQuota(
        board=board,
        quota=server.intake.quota(person, board.name),
        is_open=board.is_open(now),
        opens_at=min(coming, default=None),
        closes_at=max(closing) if closing and len(closing) == len(ending) else None,
    )
