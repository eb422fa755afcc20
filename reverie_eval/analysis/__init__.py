"""The analysis of scores: comparisons, breakdowns, near misses and single episodes."""

from reverie_eval.analysis._breakdown import GROUPINGS, Grouping, breakdown, find_grouping
from reverie_eval.analysis._comparison import (
    SMALLEST_SHOWN_P,
    ComparedSubmissionsError,
    Comparison,
    Difference,
    check_comparable,
    compare,
    p_text,
    score_all,
)
from reverie_eval.analysis._episode import Episode, episode
from reverie_eval.analysis._near_misses import episodes_won, near_misses, with_different_routes

__all__ = [
    "GROUPINGS",
    "SMALLEST_SHOWN_P",
    "ComparedSubmissionsError",
    "Comparison",
    "Difference",
    "Episode",
    "Grouping",
    "breakdown",
    "check_comparable",
    "compare",
    "episode",
    "episodes_won",
    "find_grouping",
    "near_misses",
    "p_text",
    "score_all",
    "with_different_routes",
]
