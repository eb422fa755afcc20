"""The analysis of scores, and evidence about submissions."""

from reverie_eval.analysis._against import Against, DifferenceOfMeans, against, check_scored_alike
from reverie_eval.analysis._breakdown import (
    GROUPINGS,
    Grouped,
    Grouping,
    GroupingKey,
    breakdown,
    find_grouping,
)
from reverie_eval.analysis._comparison import (
    ComparedSubmissionsError,
    Comparison,
    compare,
)
from reverie_eval.analysis._costs import (
    BudgetCurve,
    CostDifference,
    Front,
    FrontPoint,
    is_on_front,
    logged,
    success_within,
)
from reverie_eval.analysis._differences import (
    BEST,
    SMALLEST_SHOWN_P,
    Difference,
    check_comparable,
    p_text,
)
from reverie_eval.analysis._episodes import (
    Episode,
    Gallery,
    PredictedBox,
    VisibleObject,
    episode,
    episodes_won,
    gallery,
    near_misses,
    with_different_routes,
)
from reverie_eval.analysis._evidence import (
    FEWEST_FILES,
    HONEST_SPREAD,
    SAMPLED_EPISODES,
    ChangeSpread,
    most_similar,
    nearest_earlier,
    spread_of_changes,
)
from reverie_eval.analysis._plans import Plan, plan
from reverie_eval.analysis._ranks import Ranks, covariance_of_means, leaders, rank_intervals
from reverie_eval.analysis._runs import RunIntervals, Runs
from reverie_eval.analysis._sweeps import SPLIT_FIELD, Sweep, check_curve, sweep, sweep_files
from reverie_eval.analysis._walks import WalkOutcomes

__all__ = [
    "BEST",
    "FEWEST_FILES",
    "GROUPINGS",
    "HONEST_SPREAD",
    "SAMPLED_EPISODES",
    "SMALLEST_SHOWN_P",
    "SPLIT_FIELD",
    "Against",
    "BudgetCurve",
    "ChangeSpread",
    "ComparedSubmissionsError",
    "Comparison",
    "CostDifference",
    "Difference",
    "DifferenceOfMeans",
    "Episode",
    "Front",
    "FrontPoint",
    "Gallery",
    "Grouped",
    "Grouping",
    "GroupingKey",
    "Plan",
    "PredictedBox",
    "Ranks",
    "RunIntervals",
    "Runs",
    "Sweep",
    "VisibleObject",
    "WalkOutcomes",
    "against",
    "breakdown",
    "check_comparable",
    "check_curve",
    "check_scored_alike",
    "compare",
    "covariance_of_means",
    "episode",
    "episodes_won",
    "find_grouping",
    "gallery",
    "is_on_front",
    "leaders",
    "logged",
    "most_similar",
    "near_misses",
    "nearest_earlier",
    "p_text",
    "plan",
    "rank_intervals",
    "spread_of_changes",
    "success_within",
    "sweep",
    "sweep_files",
    "with_different_routes",
]
