"""Evidence about submissions: numbers for the organiser, not a verdict.

They are computed from the uploads, on the server's own machine, and leave it no other way: anyone
who knew these numbers could work around them.
"""

import zlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from math import inf
from typing import Any, NamedTuple, Self, TypeAlias

import numpy as np
from sqlalchemy import Select, select

from reverie_eval import analysis
from reverie_eval.arrays import BoolArray, IntArray, offsets_of, row_of
from reverie_eval.errors import SubmissionError
from reverie_eval.metrics import CATALOGUE, jumps
from reverie_eval.processes import Progress, no_progress
from reverie_eval.schemas import organising as schemas
from reverie_eval.scoring import Lookups, is_goal
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.tables import Submission, Team
from reverie_eval.server.store.uploads import UploadsError, stored_upload
from reverie_eval.submissions import SubmissionColumns

PAIRS = 10
"""Pairs of teams that are listed, at most."""
_MULTIPLIER = np.uint64(0x9E3779B97F4A7C15)
"""An odd number whose bits have no pattern: 2^64 divided by the golden ratio."""

_rounded = CATALOGUE["success"].rounded
"""Rounds a mean like scores of private splits: an exact one could reveal single episodes."""


class _Sent(NamedTuple):
    team: str
    id: str
    sha256: str
    received_at: Any
    method: Mapping[str, Any]

    @property
    def named(self) -> schemas.NamedSubmission:
        return schemas.NamedSubmission(id=self.id, team=self.team, method=self.method["name"])


@dataclass(frozen=True, eq=False)
class Trace:
    """The predictions of an upload, as numbers that are quick to compare."""

    answer: IntArray
    """Shape (n_episodes,): equal if two files predict the same object or box."""
    stop: IntArray
    """Shape (n_episodes,): the viewpoint where the agent stops."""
    path: IntArray
    """Shape (n_episodes,): nearly always different if trajectories are."""
    is_success: BoolArray
    """Shape (n_episodes,): all false if the split does not score success."""
    walks: schemas.WalkReport
    """Without how many stop exactly."""

    @classmethod
    def of(cls, board: Board, content: bytes) -> Self:
        """Compute the trace of a JSON text.

        Raises SubmissionError if it does not fit the split.
        """
        reading = board.read(content)
        aligned = reading.submission
        answer = aligned.predicted_object.copy()
        boxes = aligned.boxes
        drawn = np.column_stack([boxes.xywh, boxes.camera])
        answer[boxes.row] = [zlib.crc32(row.tobytes()) for row in drawn]
        success = board.score(reading).episodes.get("success")
        return cls(
            answer=answer,
            stop=aligned.stop,
            path=_path_codes(aligned),
            is_success=np.zeros(len(answer), dtype=bool) if success is None else success > 0,
            walks=_walks(aligned, board),
        )

    @property
    def codes(self) -> IntArray:
        """Shape (n_episodes,): numbers that are equal if answer and stop are equal."""
        mixed = self.answer.astype(np.uint64) * _MULTIPLIER
        mixed = (mixed ^ self.stop.astype(np.uint64)) * _MULTIPLIER
        return (mixed >> np.uint64(32)).astype(np.uint32)

    def compare(self, first: _Sent, other: "Trace", second: _Sent) -> schemas.SimilarPair:
        """Compare two files in all episodes."""
        equal_answers, equal_stops = self.answer == other.answer, self.stop == other.stop
        return schemas.SimilarPair(
            first=first.named,
            second=second.named,
            equal=(equal_answers & equal_stops).mean(),
            equal_answers=equal_answers.mean(),
            equal_stops=equal_stops.mean(),
            equal_paths=(self.path == other.path).mean(),
        )


Read: TypeAlias = Callable[[_Sent], Trace | None]
"""Reads an upload; returns None if it cannot be read."""


def gather_evidence(
    server: ServerState,
    split: str,
    team: str | None = None,
    progress: Progress = no_progress,
) -> schemas.EvidenceReport:
    """Read all submissions to a split, and report what their files have in common.

    Parameters
    ----------
    server : ServerState
    split : str
    team : str, optional
        A team of which each submission is reported, too.
    progress : callable, optional
        Shows progress; called with items, a description and their number.

    Raises
    ------
    NotFoundError
        If the server has no such split, or the split no submission of this team.
    """
    board = server.board(split)
    with server.database.reading() as session:
        sent = [_Sent(*row) for row in session.execute(_submissions_to(split))]
    if team is not None and team not in {each.team for each in sent}:
        raise NotFoundError(f"there is no team {team!r} with submissions to {split}")
    unreadable: dict[str, str] = {}

    def read(each: _Sent) -> Trace | None:
        try:
            return Trace.of(board, stored_upload(server.uploads, each.sha256))
        except SubmissionError as error:
            unreadable[each.id] = f"rejected: {error.problems[0]}"
        except UploadsError as error:
            unreadable[each.id] = str(error)
        return None

    compared = _compare(board, progress(sent, "uploads", len(sent)), read, team)
    return schemas.EvidenceReport(
        split=split,
        submissions=len(sent),
        unreadable=unreadable,
        same_files=_same_files(sent),
        **compared,
    )


def _submissions_to(split: str) -> Select[*tuple[Any, ...]]:
    """Select all submissions to a split whose files are kept, by team, the earliest first."""
    columns = (
        *(Team.name, Submission.id, Submission.sha256, Submission.received_at),
        Submission.method,
    )
    chosen = (
        select(*columns)
        .join(Team, Submission.team_id == Team.id)
        .where(Submission.split == split, Submission.upload_deleted_at.is_(None))
    )
    return chosen.order_by(Submission.team_id, Submission.received_at, Submission.id)


def _same_files(sent: Sequence[_Sent]) -> list[schemas.SameFile]:
    by_file = defaultdict(list)
    for each in sent:
        by_file[each.sha256].append(each.named)
    # A team cannot send a file twice.
    return [
        schemas.SameFile(sha256=sha256, submissions=found)
        for sha256, found in by_file.items()
        if len(found) > 1
    ]


def _compare(board: Board, sent: Iterable[_Sent], read: Read, team: str | None) -> dict[str, Any]:
    """Return the parts of the report that need the files, with one team's in memory at a time.

    The most similar ones are read again.
    """
    episodes = len(board.truth.episodes.instr_ids)
    sample = np.random.default_rng(0).permutation(episodes)[: analysis.SAMPLED_EPISODES]
    known: list[_Sent] = []
    sampled, teams, history = [], [], []
    for name, files in groupby(sent, lambda each: each.team):
        traced = [(each, trace) for each in files if (trace := read(each)) is not None]
        if not traced:
            continue
        own, traces = zip(*traced, strict=True)
        known += own
        codes = np.array([each.codes for each in traces])
        sampled.append(codes[:, sample])
        nearest, changed = analysis.nearest_earlier(codes)
        teams.append(_of_team(name, board, traces, codes, changed))
        if name == team:
            goals = _count_goals(board)
            rows = zip(own, traces, nearest.tolist(), changed.tolist(), strict=True)
            history = [
                schemas.SubmissionEvidence(
                    **each.named.model_dump(),
                    received_at=each.received_at,
                    nearest=own[row].id if row >= 0 else None,
                    changed=number if row >= 0 else None,
                    walks=_walk_report(board, trace, goals),
                )
                for each, trace, row, number in rows
            ]
    sizes = np.array([len(each) for each in sampled], dtype=np.int64)
    group = row_of(offsets_of(sizes))
    found = analysis.most_similar(np.concatenate(sampled), group, PAIRS) if sampled else None
    similar = []
    for pair in found.pairs if found else ():
        first, second = known[pair.first], known[pair.second]
        one, other = read(first), read(second)
        if one and other:
            similar.append(one.compare(first, other, second))
    return {
        "usual_similarity": None if found is None else round(found.median, 4),
        "similar": similar,
        "teams": sorted(teams, key=lambda each: each.spread.p_value if each.spread else inf),
        "history": history,
    }


def _of_team(
    name: str, board: Board, traces: Sequence[Trace], codes: IntArray, changed: IntArray
) -> schemas.TeamEvidence:
    spread = analysis.spread_of_changes(codes, board.truth.episodes.item)
    return schemas.TeamEvidence(
        team=name,
        submissions=len(traces),
        median_changed=float(np.median(changed[1:])) if len(changed) > 1 else None,
        spread=spread and schemas.SpreadReport(**spread._asdict()),
        jumps=max(each.walks.jumps for each in traces),
    )


def _path_codes(aligned: SubmissionColumns) -> IntArray:
    """Return a number for each trajectory; numbers of different ones nearly always differ."""
    begin = aligned.offsets[:-1]
    step = np.arange(len(aligned.viewpoint)) - begin[row_of(aligned.offsets)]
    mixed = (aligned.viewpoint.astype(np.uint64) + np.uint64(1)) * _MULTIPLIER
    mixed = (mixed ^ (mixed >> np.uint64(29))) * (2 * step.astype(np.uint64) + np.uint64(3))
    return np.add.reduceat(mixed * _MULTIPLIER, begin) >> np.uint64(32)


def _walks(aligned: SubmissionColumns, board: Board) -> schemas.WalkReport:
    lookups, row = Lookups(aligned, board.truth), row_of(aligned.offsets)
    is_jump = lookups.is_jump
    number = jumps(is_jump, aligned.offsets)
    pairs = np.unique(np.column_stack([row, aligned.viewpoint]), axis=0)
    different = np.bincount(pairs[:, 0])
    return schemas.WalkReport(
        jumps=int(number.sum()),
        episodes_with_jumps=int((number > 0).sum()),
        longest_jump=float(lookups.leg_length[is_jump].max(initial=0.0)),
        mean_viewpoints=float(different.mean()),
        most_viewpoints=int(different.max()),
        longest_walk=float(np.bincount(row, lookups.leg_length).max()),
        exact_stops=None,
        exact_by_chance=None,
    )


def _walk_report(board: Board, trace: Trace, goals: IntArray) -> schemas.WalkReport:
    """Report the walks, with how many successful ones stop at the path's end, and by chance."""
    if not trace.is_success.any():
        return trace.walks
    is_exact = trace.stop == board.truth.require_solution().goal
    exact = is_exact[trace.is_success].mean(), (1 / goals[trace.is_success]).mean()
    stops, by_chance = (_rounded(float(each)) for each in exact)
    return trace.walks.model_copy(update={"exact_stops": stops, "exact_by_chance": by_chance})


def _count_goals(board: Board) -> IntArray:
    """Return the number of viewpoints at which each episode is a success: shape (n_episodes,)."""
    truth = board.truth
    scan = truth.graph.viewpoint_scan
    own = scan[truth.episodes.start]
    begin, end = np.searchsorted(scan, own), np.searchsorted(scan, own, side="right")
    offsets = offsets_of(end - begin)
    episode = row_of(offsets)
    viewpoint = np.arange(len(episode)) - (offsets[:-1] - begin)[episode]
    return np.bincount(episode, is_goal(board.protocol.goal, truth, episode, viewpoint))
