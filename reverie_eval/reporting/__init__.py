"""Scores for people and programs: tables, charts, maps, reports."""

from typing import TYPE_CHECKING, Any

from reverie_eval.reporting.scores import results_table

if TYPE_CHECKING:
    from reverie_eval.reporting.figures import plot_curve
    from reverie_eval.reporting.report import report_html

__all__ = ["plot_curve", "report_html", "results_table"]


def __getattr__(name: str) -> Any:
    """Import figures and the report when they are used: scoring a file does without them."""
    if name == "plot_curve":
        from reverie_eval.reporting.figures import plot_curve

        return plot_curve
    if name == "report_html":
        from reverie_eval.reporting.report import report_html

        return report_html
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
