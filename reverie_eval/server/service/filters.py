"""Parts of a board: by what is said of methods, by date, by text."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date

from reverie_eval.server.service.leaderboard import Ranking
from reverie_eval.server.service.standings import Row


@dataclass(frozen=True, slots=True)
class Filter:
    """Which rows are shown; ranks stay those of the whole board."""

    flags: Mapping[str, bool]
    """What must be said of a method; a flag that is not in it may be either."""
    since: date | None = None
    until: date | None = None
    """Days in UTC, both included."""
    text: str = ""
    """In the name of the method or the team, whatever the case."""

    def of(self, rows: Sequence[Row], ranking: Ranking) -> Sequence[Row]:
        """Return the rows of a ranking that are shown."""
        return rows if self == Filter({}) else [row for row in rows if self._admits(row, ranking)]

    def _admits(self, row: Row, ranking: Ranking) -> bool:
        method, day = row.entry.method, row.entry.published_at.date()
        wanted = self.text.casefold()
        return (
            all(bool(method.get(flag)) == asked for flag, asked in self.flags.items())
            and (self.since is None or self.since <= day)
            and (self.until is None or day <= self.until)
            and (
                wanted in method["name"].casefold() or wanted in ranking.team(row.entry).casefold()
            )
        )
