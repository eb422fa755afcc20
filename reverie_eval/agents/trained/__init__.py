"""The paper's agents, trained on names instead of pictures: what the extra ``agents`` needs.

A model only scores actions or objects. What is observed becomes numbers in ``_coding``; training
(``_training``) walks the episodes of ``_world`` in batches, for the losses in ``_losses``. A
trained agent (``_agent``) walks those of a run, greedily or by the queue of FAST. The networks of
the papers are in ``navigators`` and ``pointers``.
"""

from reverie_eval.agents.trained._agent import MODEL, POINTER, find_trained
from reverie_eval.agents.trained._model_file import Epoch, read_model_card
from reverie_eval.agents.trained._recipes import RECIPES, Recipe, find_recipe
from reverie_eval.agents.trained._training import TrainingPlan, train

__all__ = [
    "MODEL",
    "POINTER",
    "RECIPES",
    "Epoch",
    "Recipe",
    "TrainingPlan",
    "find_recipe",
    "find_trained",
    "read_model_card",
    "train",
]
