"""What replies cost, by a table that the user gives."""

from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

from typing_extensions import Self

from reverie_eval.agents.chat.errors import CostLimitError
from reverie_eval.errors import ReverieEvalError
from reverie_eval.files import read_toml
from reverie_eval.logs import Usage
from reverie_eval.text import first_few

_CLASSES = ("input", "cached", "output")
# Prices are those of a million tokens.
_UNIT = 1e-6


@dataclass(frozen=True)
class Prices:
    """What tokens of a model cost, in US dollars for a million of them."""

    date: str
    """The day on which these were the prices."""
    input: float
    """Tokens that are sent, and not cached."""
    cached: float
    """Tokens that are sent, and that the endpoint had in its cache."""
    output: float
    """Tokens that come back, those of reasoning included."""

    @classmethod
    def read(cls, file: Path, model: str) -> Self:
        """Read the prices of a model.

        Raises
        ------
        ReverieEvalError
            If the file is not such a table, or has no prices of the model.
        """
        table = read_toml(file)
        day, row = table.pop("date", None), table.get(model)
        if not isinstance(day, date):
            raise ReverieEvalError(f"{file} has no date; add the day of the prices: 2026-11-26")
        if not isinstance(row, dict):
            listed = f", but for {first_few(table)}" if table else ""
            raise ReverieEvalError(f"{file} has no prices for {model!r}{listed}")
        wrong = [name for name in _CLASSES if not _is_price(row.get(name))]
        if wrong:
            raise ReverieEvalError(
                f"{file}, {model!r}: {', '.join(wrong)} should be US dollars for a million tokens, "
                "0 if they are free"
            )
        return cls(str(day), *(float(row[name]) for name in _CLASSES))

    def cost(self, usage: Usage) -> float | None:
        """Return US dollars; None if the number of tokens is unknown, unless all are free."""
        sent, back = usage.input_tokens, usage.output_tokens
        if sent is None or back is None:
            return None if self.input or self.cached or self.output else 0.0
        cached = usage.cached_tokens or 0
        each = (sent - cached) * self.input + cached * self.cached + back * self.output
        return each * _UNIT


@dataclass(frozen=True)
class Budget:
    """What may be paid for replies.

    Parameters
    ----------
    prices : Prices, optional
    most : float, optional
        US dollars.

    Raises
    ------
    ReverieEvalError
        If there is a limit, and there are no prices.
    """

    prices: Prices | None
    most: float | None

    def __post_init__(self) -> None:
        if self.most is not None and self.prices is None:
            raise ReverieEvalError(
                "a limit of the cost needs prices: give a file of them (--prices)"
            )

    def cost(self, usage: Usage) -> float | None:
        """Return what a reply cost; None if that is unknown."""
        return None if self.prices is None else self.prices.cost(usage)

    def check(self, paid: float | None) -> None:
        """Raise CostLimitError if another reply may not be paid for."""
        if self.most is not None and paid is None:
            raise CostLimitError("the cost of earlier replies is unknown, and there is a limit")
        if self.most is not None and paid is not None and paid >= self.most:
            raise CostLimitError(
                f"the limit of ${self.most:g} is reached; the same command goes on with a "
                "higher one"
            )


def _is_price(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value < 1e9
