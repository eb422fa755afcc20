"""Scores for people and programs: tables, charts, maps, reports.

Code imports the modules by name, so that scoring a file loads neither pydantic nor matplotlib:

====================  ==========================================================
tables                one Table, its formats, and how terminals show it
scores, comparisons   scores, rankings, runs, sweeps and differences in every format
results               methods side by side, as papers show them
service               what an evaluation server replies
datasets              the faults and contents of a dataset
drawing               lines by class, as SVG and with matplotlib
charts, figures       distributions; all figures with matplotlib
history               results over the years, and a rank over time
outcomes              how the walks of many methods end: in every episode, and on plans
episode_figure        an episode for a paper: SVG, PDF, PNG; files in which its walk plays
maps, buildings       an episode from above, as data, and the building around it
map_layout, map_svg   what is on a map and where; maps as SVG, with the signs of map_marks, and
                      what an agent did and said, step by step
floors_svg            a building as stacked floors; building_svg has a walk on them
answers, answer_svg   what is visible where an agent answered; its pictures
skyboxes              photographs for these pictures
report                the HTML report; report_sections has its words and numbers
====================  ==========================================================
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from reverie_eval.reporting.results import results_table

if TYPE_CHECKING:
    from reverie_eval.reporting.episode_figure import save_figure
    from reverie_eval.reporting.figures import plot_budgets, plot_curve
    from reverie_eval.reporting.report import report_html

__all__ = ["plot_budgets", "plot_curve", "report_html", "results_table", "save_figure"]


# Imported when they are used: scoring a file does without them.
_LATE = {
    "plot_budgets": "figures",
    "plot_curve": "figures",
    "report_html": "report",
    "save_figure": "episode_figure",
}


def __getattr__(name: str) -> Any:
    if name in _LATE:
        return getattr(import_module(f"{__name__}.{_LATE[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
