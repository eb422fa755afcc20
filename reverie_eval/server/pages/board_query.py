"""What of a board is shown, and how: all of it is in the address, which so is a permalink."""

from datetime import date
from typing import Annotated, Any, Literal
from urllib.parse import urlencode

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from reverie_eval.metrics import CATALOGUE, PRIMARY_METRIC, Metric
from reverie_eval.reporting._leaderboard import METHOD_FLAGS
from reverie_eval.server.service.filters import Filter
from reverie_eval.server.service.leaderboard import SORTABLE

Asked = Literal["", "with", "without"]


def _known(key: str) -> str:
    if key not in CATALOGUE:
        raise ValueError(f"there is no such metric; choose one of: {', '.join(CATALOGUE)}")
    return key


MetricKey = Annotated[str, AfterValidator(_known)]
Day = Annotated[date | None, BeforeValidator(lambda value: value or None)]


class BoardQuery(BaseModel):
    """The query of a board's address; what is empty is not asked for, as forms send it."""

    model_config = ConfigDict(frozen=True)

    metric: MetricKey = PRIMARY_METRIC
    extra_data: Asked = ""
    pre_exploration: Asked = ""
    ground_truth_objects: Asked = ""
    ensemble: Asked = ""
    since: Day = None
    until: Day = None
    text: Annotated[str, Field(max_length=100)] = ""
    columns: Literal["", "all"] = ""
    x: MetricKey = "path_length"
    y: MetricKey = "success"
    page: Annotated[int, Field(ge=1, le=100_000)] = 1

    @property
    def ranked_by(self) -> str:
        """What ranks are by: the metric, or the primary one where neither direction is better."""
        return self.metric if self.metric in SORTABLE else PRIMARY_METRIC

    @property
    def shown(self) -> Filter:
        """Which rows are shown."""
        flags = {
            flag: getattr(self, flag) == "with" for flag in METHOD_FLAGS if getattr(self, flag)
        }
        return Filter(flags, self.since, self.until, self.text.strip())

    @property
    def is_filtered(self) -> bool:
        """Whether rows may be left out."""
        return self.shown != Filter({})

    def link(self, **changes: Any) -> str:
        """Return the address's query with some of it changed, the defaults left out."""
        changed = type(self).model_validate(self.model_dump() | changes)
        said = changed.model_dump(mode="json", exclude_defaults=True)
        return f"?{urlencode(said)}"

    @property
    def unfiltered(self) -> str:
        """Return the address's query with every row shown, from the first page on."""
        kept = self.model_dump(include={"metric", "columns", "x", "y"})
        return type(self).model_validate(kept).link()

    def direction(self, metric: Metric) -> Literal["ascending", "descending"]:
        """Return the order of the column that the board is sorted by: best first, or least."""
        return "descending" if metric.better == "higher" else "ascending"
