"""Near misses, and episodes that only one of two submissions got right."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from reverie_eval.analysis._episode import Episode, episode
from reverie_eval.arrays import Array
from reverie_eval.scoring import OUTCOMES, Scores

_N_EXAMPLES = 3
"""Episodes of each kind; readers learn more from different routes than from more of them."""


def near_misses(scores: Scores) -> Mapping[str, Sequence[str]]:
    """Choose a few episodes of every failure mode, those closest to being correct first.

    Episodes that never reached the goal are ordered by how close they came to the path's end;
    those that overshot, or predicted the correct object at the wrong stop, by how close to it they
    stopped; those with a wrong object by their box's IoU, then by SPL.

    Returns
    -------
    mapping of lists of str
        Instr_ids by outcome; the same scores give the same episodes.
    """
    outcome = np.array(scores.outcomes)
    chosen = {}
    for failure in [outcome for outcome in OUTCOMES if outcome != "correct"]:
        rows = np.flatnonzero(outcome == failure)
        # lexsort takes the most important key last.
        order = np.lexsort([column[rows] for column in reversed(_distances(scores, failure))])
        ordered = [scores.instr_ids[row] for row in rows[order].tolist()]
        chosen[failure] = with_different_routes(scores, ordered)
    return chosen


@dataclass(frozen=True, eq=False, repr=False)
class Gallery(Mapping[str, Sequence[Episode]]):
    """A few failed episodes by outcome; a notebook shows each with its map and answer."""

    episodes: Mapping[str, Sequence[Episode]]

    def __getitem__(self, outcome: str) -> Sequence[Episode]:
        return self.episodes[outcome]

    def __iter__(self) -> Iterator[str]:
        return iter(self.episodes)

    def __len__(self) -> int:
        return len(self.episodes)

    def _repr_html_(self) -> str:
        """Show near misses in a notebook, each with its map and answer."""
        from reverie_eval.reporting.map_svg import gallery_html

        return gallery_html(self)

    def __repr__(self) -> str:
        counts = ", ".join(f"{len(shown)} {outcome}" for outcome, shown in self.items())
        return f"<Gallery of near misses: {counts}>"


def gallery(scores: Scores) -> Gallery:
    """Return failed episodes that were close to being correct; see :meth:`Scores.gallery`."""
    return Gallery(
        {
            outcome: [episode(scores, instr_id) for instr_id in instr_ids]
            for outcome, instr_ids in near_misses(scores).items()
            if instr_ids
        }
    )


def episodes_won(first: Scores, other: Scores) -> Sequence[str]:
    """List the episodes that only the other submission got right, the largest difference first.

    If one of them has no answers, an episode is right if its agent stopped at the goal.
    """
    shared = [key for key in first if key in other]
    correct = "rgs" if "rgs" in shared else "success"
    better = other.episodes[correct] > first.episodes[correct]
    primary = first.ground_truth.task.primary_metric(shared).key
    change = other.episodes[primary] - first.episodes[primary]
    rows = np.flatnonzero(better)
    ordered = rows[np.argsort(-change[rows], kind="stable")]
    return [first.instr_ids[row] for row in ordered.tolist()]


def with_different_routes(scores: Scores, instr_ids: Sequence[str]) -> Sequence[str]:
    """Return the first few episodes that differ in start or goal."""
    truth = scores.ground_truth
    rows = np.array([truth.episodes.index[instr_id] for instr_id in instr_ids], dtype=int)
    routes = np.column_stack([truth.episodes.start[rows], truth.require_solution().goal[rows]])
    _, first_of_route = np.unique(routes, axis=0, return_index=True)
    # np.unique sorts routes by viewpoint; sorting the indices restores the order of episodes.
    return [instr_ids[index] for index in np.sort(first_of_route)[:_N_EXAMPLES].tolist()]


def _distances(scores: Scores, failure: str) -> Sequence[Array]:
    """Return how far each episode is from being correct, the most important quantity first."""
    episodes = scores.episodes
    if failure == "never reached":
        return [episodes["oracle_error"]]
    if failure == "wrong object":
        overlap = [-episodes["iou"]] if "iou" in episodes else []
        return [*overlap, -episodes["spl"]]
    return [episodes["navigation_error"]]
