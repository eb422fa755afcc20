"""What the words after ``reverie-eval score`` say, for each of its ways."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from reverie_eval import Evaluator, GroundTruth
from reverie_eval.reporting.tables import FORMATS, Printout
from reverie_eval.scoring import Clustering
from reverie_eval.submissions import find_files, find_runs
from reverie_eval_cli.options import ALL_PROTOCOLS, ScoringOptions
from reverie_eval_cli.output import show_printout


@dataclass(frozen=True)
class Wanted:
    """What the words after ``score`` say."""

    submissions: Sequence[str]
    scoring: ScoringOptions
    episodes_from: Path | None
    diagnosed: bool
    ci: bool
    cluster: Clustering | None
    confidence: float | None
    select: str | None
    curve: str | None
    watch: bool
    jobs: int | None
    layout: str
    output: str | None
    episodes: str | None
    run: Path | None

    @property
    def given(self) -> Iterator[str]:
        """The given options that only some of the ways take."""
        values = {
            "--diagnose": self.diagnosed,
            "--ci": self.ci,
            "--cluster": self.cluster,
            "--confidence": self.confidence,
            "--episodes": self.episodes,
            "--format": self.layout != FORMATS[0],
            "--output": self.output,
            "--run": self.run,
            "--select": self.select,
            "--curve": self.curve,
            f"--protocol {ALL_PROTOCOLS}": self.scoring.protocol == ALL_PROTOCOLS,
        }
        return (option for option, value in values.items() if value)

    # Read once: ways that need both truth and evaluator share it.
    @cached_property
    def truth(self) -> GroundTruth:
        """The ground truth of the chosen episodes."""
        return self.scoring.find(self.episodes_from)

    @cached_property
    def evaluator(self) -> Evaluator:
        """What scores by the chosen protocol."""
        return self.scoring.evaluator(self.truth)

    @property
    def file(self) -> str | None:
        """The only file that is to be scored; None if there are several, or runs of a method."""
        # A folder or a pattern is a ranking even if it has one file, so that its output has one
        # form.
        first, *others = self.submissions
        is_one = not others and not find_runs(first) and find_files([first]) == [first]
        return first if is_one else None

    def show(self, printout: Printout) -> None:
        """Print a result in the chosen format."""
        show_printout(printout, self.layout, self.output)
