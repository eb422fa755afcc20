"""The rows of the paper that can be trained, and how each is."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType
from typing import Any, Literal, get_args

from torch import nn

from reverie_eval.agents.trained._coding import Coder
from reverie_eval.agents.trained._model_file import ModelCard
from reverie_eval.agents.trained.navigators import Follower, Rcm, SelfMonitor, Sizes, SlotInputs
from reverie_eval.agents.trained.pointers import MAttNet, NameRnn, Pointer
from reverie_eval.errors import ReverieEvalError
from reverie_eval.text import did_you_mean

Walk = Literal["greedy", "fast", "likeliest"]
"""Whether an agent takes the best action where it is, or the best one that it knows of by the sum
of the logits along its way (FAST), or by the sum of their log-probabilities."""
WALKS: Sequence[Walk] = get_args(Walk)

# Options that are numbers, and what they are multiples of: both directions of a bidirectional LSTM
# have a half of its size.
_LEAST: Mapping[str, int] = {"size": 2, "epochs": 1}


@dataclass(frozen=True)
class Recipe:
    """How a row of the paper is trained."""

    network: type[Follower | Rcm | SelfMonitor | NameRnn | MAttNet]
    epochs: int
    """At most."""
    learning_rate: float = 1e-3
    student: float = 0.0
    """The share of batches with student forcing."""
    reinforced_from: int | None = None
    """The epoch from which batches with student forcing have the policy gradient instead."""
    inputs: SlotInputs = field(default_factory=SlotInputs)
    """What a navigator is given."""
    erases: bool = False
    """Whether a pointer reads expressions again without their most important word."""
    walk: Walk = "greedy"
    size: int | None = None
    """The size of embeddings and hidden states; None for 64, and hidden states of 128 in
    navigators."""

    @property
    def is_pointer(self) -> bool:
        """Whether it points at objects, and does not go anywhere."""
        return issubclass(self.network, Pointer)

    @property
    def reads_objects(self) -> bool:
        """Whether it looks at names and boxes."""
        return self.is_pointer or self.inputs.names or self.inputs.matches or self.inputs.top

    def with_options(self, options: Mapping[str, Any]) -> "Recipe":
        """Return the recipe with another size or other epochs, or with inputs on or off.

        Raises
        ------
        ReverieEvalError
            If an option does not exist, or its value has the wrong type or is out of range.
        """
        inputs = [] if self.is_pointer else [each.name for each in fields(SlotInputs)]
        known = [*_LEAST, *inputs]
        for name, value in options.items():
            if name not in known:
                raise ReverieEvalError(f"there is no option {name!r}{did_you_mean(name, known)}")
            if name in inputs:
                if type(value) is not bool:
                    raise ReverieEvalError(f"option {name} must be true or false, got {value!r}")
            elif type(value) is not int or value < _LEAST[name] or value % _LEAST[name]:
                kind = "an even number" if name == "size" else "a whole number"
                raise ReverieEvalError(
                    f"option {name} must be {kind}, at least {_LEAST[name]}, got {value!r}"
                )
        own = {name: value for name, value in options.items() if name in _LEAST}
        its = {name: value for name, value in options.items() if name in inputs}
        return replace(self, **own, inputs=replace(self.inputs, **its))

    def build(self, coder: Coder) -> nn.Module:
        """Return a network with random weights."""
        n_words = len(coder.vocabulary.words) + 1
        if issubclass(self.network, Pointer):
            return self.network(Sizes(n_words, self.size or 64, self.size or 64))
        sizes = Sizes(n_words, self.size or 64, self.size or 128)
        return self.network(sizes, self.inputs, len(coder.remembered))


_SELF_MONITOR = Recipe(SelfMonitor, epochs=8, student=0.5)

RECIPES: Mapping[str, Recipe] = MappingProxyType(
    {
        "r2r-tf": Recipe(Follower, epochs=8),
        "r2r-sf": Recipe(Follower, epochs=12, student=0.5),
        "rcm": Recipe(Rcm, epochs=8, student=0.5, reinforced_from=5),
        "self-monitor": _SELF_MONITOR,
        "fast-short": replace(_SELF_MONITOR, walk="fast"),
        "fast-lan-only": replace(
            _SELF_MONITOR, walk="fast", inputs=SlotInputs(names=False, matches=False, memory=False)
        ),
        "interactive": replace(_SELF_MONITOR, walk="fast", inputs=SlotInputs(top=True)),
        "name-rnn": Recipe(NameRnn, epochs=12, learning_rate=3e-3),
        "mattnet": Recipe(MAttNet, epochs=8),
        "cm-erase": Recipe(MAttNet, epochs=8, erases=True),
    }
)
"""The rows of the paper that can be trained, by name: Qi et al., 2020, tables 2 and 3."""


def find_recipe(name: str, options: Mapping[str, Any]) -> Recipe:
    """Return a recipe.

    Raises
    ------
    ReverieEvalError
        If there is no such recipe or option.
    """
    if name not in RECIPES:
        raise ReverieEvalError(f"there is no agent {name!r} to train{did_you_mean(name, RECIPES)}")
    return RECIPES[name].with_options(options)


def recipe_of(card: ModelCard) -> Recipe:
    """Return the recipe of a model."""
    return find_recipe(card.name, card.options)
