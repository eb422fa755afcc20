"""What scores depend on, and the signature that says so."""

from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from reverie_eval.arrays import Array
from reverie_eval.errors import ProtocolError
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.metrics import Metric
from reverie_eval.scoring._intervals import ClusterIntervals
from reverie_eval.tasks import DEFAULT_TASK, Protocol, Task, find_task
from reverie_eval.text import short_digest
from reverie_eval.version import __version__

if TYPE_CHECKING:
    import pandas as pd

    from reverie_eval.analysis import Against, Gallery, Grouped
    from reverie_eval.schemas.report import RunsReport, ScoreReport

# It begins the part of a signature that names the task.
_TASK = "task:"


@dataclass(frozen=True, eq=False, repr=False)
class Scored(Mapping[str, float]):
    """The scores of a method, of one run or of several, which can be compared with others.

    Keys and their order are those of the CATALOGUE. Fractions are in [0, 1], lengths in metres,
    and nothing is rounded.
    """

    ground_truth: GroundTruth
    protocol: Protocol
    episodes: Mapping[str, Array]
    """One value per episode for each metric, in the order of the ground truth; read-only. Those of
    several runs are means."""
    qualifier: str
    """What the scores depend on besides split, protocol and data: ``track:grounding``."""
    intervals: ClusterIntervals | None
    """Confidence intervals of the metrics, if there are any."""

    @property
    @abstractmethod
    def notes(self) -> Sequence[str]:
        """What a reader of the scores should know, one sentence each."""

    @abstractmethod
    def to_report(self) -> "ScoreReport | RunsReport":
        """Return the report for programs, which ``--format json`` prints."""

    def __iter__(self) -> Iterator[str]:
        return iter(self.episodes)

    def __len__(self) -> int:
        return len(self.episodes)

    @property
    def split(self) -> str:
        """The split that was scored."""
        return self.ground_truth.split

    @property
    def instr_ids(self) -> Sequence[str]:
        """The episodes, in the order of their values in ``episodes``."""
        return self.ground_truth.episodes.instr_ids

    @property
    def signature(self) -> str:
        """Everything that the scores depend on; scores with equal signatures are comparable.

        After sacreBLEU (Post, "A Call for Clarity in Reporting BLEU Scores", WMT 2018).
        """
        return signature_of(self.ground_truth, self.protocol, self.qualifier)

    @property
    def conditions(self) -> Sequence[str]:
        """What the signature says besides the choice of episodes."""
        truth = self.ground_truth
        of = truth.task.name, truth.split, truth.fingerprint
        return *of, self.protocol.name, self.qualifier

    @property
    def headline(self) -> Sequence[Metric]:
        """The scored metrics that every score table shows, in its order."""
        return self.ground_truth.task.headline_metrics(self)

    def breakdown(
        self,
        by: "Grouped | Sequence[Grouped]",
        *,
        intervals: bool = False,
        confidence: float | None = None,
    ) -> "pd.DataFrame":
        """Score each group of episodes separately, as means over the runs if there are several.

        Parameters
        ----------
        by : str, Series, or list of these
            A key of ``GROUPINGS``, or the group of each episode in a Series indexed by instr_id,
            such as a column of :meth:`to_pandas`. Several are combined. Groups of ``language``
            overlap: "all", "en", "en-IN" and so on, each over its instructions. Of several runs,
            an episode in which any of them jumped is among the ``jumps``.
        intervals : bool
            Whether to add the ends of intervals over the targets of each group, in ``spl_low``,
            ``spl_high`` and so on. They are missing if a group has fewer than 5 targets, and take
            runs as they are.
        confidence : float, optional
            Of these intervals, in (0, 1); by default 0.95.

        Returns
        -------
        DataFrame
            A row per group that is not empty, with the number of its episodes and the mean of every
            headline metric, in the metrics' own units, which ``attrs["units"]`` lists by column.

        Raises
        ------
        ProtocolError
            If there is no such grouping, it needs something that the track does not score or the
            task does not have, or a Series has no group for some episodes.
        """
        from reverie_eval.analysis import breakdown

        return breakdown(self, by, intervals=intervals, confidence=confidence)

    def gallery(self) -> "Gallery":
        """Return the failed episodes of each outcome that were closest to being correct.

        Of several runs, first those with this outcome in most of them, each as the first of these
        runs did it.

        Raises
        ------
        ProtocolError
            If the protocol or track defines no outcomes.
        ReverieEvalError
            If the scores have no trajectories.
        """
        from reverie_eval.analysis import gallery

        return gallery(self)

    def against(
        self,
        published: Mapping[str, float] | str,
        n: int | None = None,
        *,
        confidence: float | None = None,
    ) -> "Against":
        """Compare the means with published ones, of which only the number of episodes is known.

        Parameters
        ----------
        published : mapping of str to float, or str
            The means by metric, fractions or metres; or the name of a method among
            :func:`reverie_eval.published_results`.
        n : int, optional
            The number of episodes that they are over, a random part of the split; by default all.
        confidence : float, optional
            Of the intervals, in (0, 1); by default 0.95.

        Raises
        ------
        ProtocolError
            If there is no such metric or method, a value or ``n`` is out of range, or all episodes
            have the same target.
        """
        from reverie_eval.analysis import against

        return against(self, published, n, confidence=confidence)

    def __repr__(self) -> str:
        values = ", ".join(f"{m.heading} {m.display(self[m.key])}" for m in self.headline)
        return f"<{type(self).__name__} {values}; {self.signature}>"


def shared_keys(several: Iterable[Mapping[str, float]]) -> Sequence[str]:
    """Return the metrics that all of some scores have, in the order of the CATALOGUE."""
    first, *others = several
    return [key for key in first if all(key in each for each in others)]


def check_same_signature(several: Iterable[Scored], what: str = "scores") -> None:
    """Raise ProtocolError unless all are of the same episodes under the same protocol."""
    signatures = sorted({each.signature for each in several})
    if len(signatures) > 1:
        raise ProtocolError(f"these {what} are not comparable: {', '.join(signatures)}")


def signature_of(truth: GroundTruth, protocol: Protocol, qualifier: str) -> str:
    """Return the signature of scores under a protocol and a ground truth, with this version."""
    task = truth.header.task
    parts = [
        # REVERIE's signatures do not name it: they are older than the other tasks.
        *([] if task == DEFAULT_TASK else [f"{_TASK}{task}"]),
        f"split:{truth.split}",
        f"protocol:{protocol.name}",
        *([qualifier] if qualifier else []),
        *([f"subset:{truth.subset_digest}"] if truth.subset_digest else []),
        f"data:{short_digest(truth.fingerprint)}",
        f"n:{len(truth.episodes.instr_ids)}",
        f"version:{__version__}",
    ]
    return "|".join(parts)


def task_of(signature: str) -> Task:
    """Return the task that a signature names; REVERIE if it names none.

    Raises
    ------
    ProtocolError
        If the task is not installed.
    """
    first = signature.partition("|")[0]
    is_named = first.startswith(_TASK)
    return find_task(first.removeprefix(_TASK) if is_named else DEFAULT_TASK)
