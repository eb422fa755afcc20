"""The query of a leaderboard's page: which rows and columns it shows, and in which order."""

from collections.abc import Mapping, Sequence
from datetime import date
from typing import Annotated, Any, Literal, Self
from urllib.parse import urlencode

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PrivateAttr, StringConstraints

from reverie_eval.metrics import Metric
from reverie_eval.reporting.service import METHOD_FLAGS
from reverie_eval.schemas.report import ProblemReport
from reverie_eval.schemas.service import Amount, InputClass, SampleSize
from reverie_eval.server.boards.entries import Entry, Row
from reverie_eval.server.boards.leaderboard import Ranking
from reverie_eval.server.errors import WRONG_FORM, MalformedError
from reverie_eval.server.scoring.boards import Board
from reverie_eval.text import did_you_mean

LONGEST_SOUGHT = 100
"""Characters of a part of a name that a leaderboard is searched for."""

FlagFilter = Literal["", "with", "without", "undeclared"]
_DECLARED: Mapping[FlagFilter, bool | None] = {"with": True, "without": False, "undeclared": None}
MetricKey = Annotated[str, Field(max_length=100)]
"""Whether the leaderboard has the metric is checked by :meth:`BoardQuery.on`."""
EmptyIsNone = BeforeValidator(lambda value: None if value == "" else value)
Day = Annotated[date | None, EmptyIsNone]


class Filter(BaseModel):
    """Which rows are shown; their ranks are those on the whole leaderboard.

    Empty parameters, as forms send them, count as missing.
    """

    model_config = ConfigDict(frozen=True)

    extra_data: FlagFilter = ""
    pre_exploration: FlagFilter = ""
    ground_truth_objects: FlagFilter = ""
    ensemble: FlagFilter = ""
    navigation_only: FlagFilter = ""
    human: FlagFilter = ""
    input_class: InputClass | Literal["", "undeclared"] = ""
    sample_from: Annotated[SampleSize | None, EmptyIsNone] = None
    """The smallest number of episodes that a method was run on; by default on all."""
    money_until: Annotated[Amount | None, EmptyIsNone] = None
    """The highest declared price of an episode, in US dollars."""
    since: Day = None
    until: Day = None
    """Days in UTC; both are included, and so are dated months and years that include such a day."""
    text: Annotated[str, StringConstraints(strip_whitespace=True, max_length=LONGEST_SOUGHT)] = ""
    """Part of the name of the method or the team; case is ignored."""

    @property
    def is_filtered(self) -> bool:
        """Whether rows may be left out."""
        fields = Filter.model_fields.items()
        return any(getattr(self, name) != field.default for name, field in fields)

    def shown(self, rows: Sequence[Row], ranking: Ranking) -> Sequence[Row]:
        """Return the rows of a ranking that match."""
        # Only what is asked for is looked at: there may be 10,000 rows.
        for name, asked in self._declared().items():
            rows = [row for row in rows if row.entry.method.get(name) == asked]
        if self.sample_from is not None:
            sizes = ((row, row.entry.method.get("sample_size")) for row in rows)
            rows = [row for row, size in sizes if size is None or size >= self.sample_from]
        if self.money_until is not None:
            prices = ((row, row.entry.method.get("money_per_episode")) for row in rows)
            rows = [row for row, it in prices if it is not None and it <= self.money_until]
        if self.since is not None or self.until is not None:
            rows = [row for row in rows if self._admits_date(row.entry.date)]
        if self.text:
            rows = [row for row in rows if self._admits_name(row.entry, ranking)]
        return rows

    def _declared(self) -> Mapping[str, bool | str | None]:
        """Return the values that a method has to declare, None for those that it must not."""
        declared: dict[str, bool | str | None] = {
            flag: _DECLARED[asked] for flag in METHOD_FLAGS if (asked := getattr(self, flag))
        }
        if self.input_class:
            is_asked = self.input_class != "undeclared"
            declared["input_class"] = self.input_class if is_asked else None
        return declared

    def _admits_date(self, day: str) -> bool:
        """Whether a day, or any day of a month or a year, is in the filter's period."""
        since, until = (str(each or day)[: len(day)] for each in (self.since, self.until))
        return bool(day) and since <= day <= until

    def _admits_name(self, entry: Entry, ranking: Ranking) -> bool:
        wanted = self.text.casefold()
        return wanted in entry.method["name"].casefold() or wanted in ranking.team(entry).casefold()


class BoardQuery(Filter):
    """The query parameters of a leaderboard."""

    metric: MetricKey = ""
    columns: Literal["", "all"] = ""
    x: MetricKey = ""
    y: MetricKey = ""
    page: Annotated[int, Field(ge=1, le=100_000)] = 1
    _usual: Mapping[str, str] = PrivateAttr(default_factory=dict)
    """The metrics that the leaderboard shows if it is asked for no others."""

    def on(self, board: Board) -> Self:
        """Return the query with a leaderboard's own metrics where it asks for none.

        Raises
        ------
        MalformedError
            If it asks for a metric that the leaderboard's task does not have.
        """
        known, primary = board.task.metrics, board.primary.key
        usual = {"metric": primary, "x": "success", "y": "rgs" if "rgs" in known else primary}
        asked = {name: getattr(self, name) or key for name, key in usual.items()}
        unknown = [
            ProblemReport(
                code="wrong-value",
                where=name,
                message=f"{board.task.title} has no metric {key!r}{did_you_mean(key, known)}",
            )
            for name, key in asked.items()
            if key not in known
        ]
        if unknown:
            raise MalformedError(WRONG_FORM, unknown)
        resolved = self.model_copy(update=asked)
        resolved._usual = usual  # noqa: SLF001  # of this class
        return resolved

    def ranked_by(self, board: Board) -> str:
        """Return the metric of the ranks: the one sorted by, or the primary one if it has none."""
        return self.metric if self.metric in board.sortable else board.primary.key

    def link(self, **changes: Any) -> str:
        """Return the query with some parameters changed, without those at their defaults."""
        changed = type(self).model_validate(self.model_dump() | changes)
        given = changed.model_dump(mode="json", exclude_defaults=True)
        unusual = {name: value for name, value in given.items() if value != self._usual.get(name)}
        return f"?{urlencode(unusual)}"

    @property
    def unfiltered(self) -> str:
        """The query without the filter, for the first page."""
        usual = {name: field.default for name, field in Filter.model_fields.items()}
        return self.link(**usual, page=1)

    def direction(self, metric: Metric) -> Literal["ascending", "descending"]:
        """Return the order of the sorted column: the best or the lowest value first."""
        return "descending" if metric.better == "higher" else "ascending"
