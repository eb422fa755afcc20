"""What a dataset is made of, in numbers: its instructions, targets, goals, paths and buildings.

The numbers are those of the REVERIE paper's dataset analysis, for any dataset in the published
layout. Reading the files lives in :mod:`reverie_eval.description.describe`, which is imported only
when asked for.
"""

from reverie_eval.description.dataset import DatasetDescription
from reverie_eval.description.distribution import Distribution
from reverie_eval.description.paper import Comparison
from reverie_eval.description.part import Answers, Part

__all__ = ["Answers", "Comparison", "DatasetDescription", "Distribution", "Part"]
