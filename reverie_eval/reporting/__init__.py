"""Scores for people and programs: tables, charts, maps, reports."""

from reverie_eval.reporting._results import results_table

__all__ = ["results_table"]
