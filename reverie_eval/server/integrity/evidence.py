"""Evidence about submissions: numbers and notices for the organiser, not a verdict.

None of it may be in a reply to participants, on a public page, or in an export: anyone who knew
these numbers, or which half of the episodes is secret, could work around them.
"""

import hashlib
import hmac
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from math import inf
from typing import Any, NamedTuple, Self, TypeAlias

import numpy as np
from sqlalchemy import Select, select
from sqlalchemy.orm import Session

from reverie_eval.analysis import (
    SAMPLED_EPISODES,
    gap_between,
    most_similar,
    nearest_earlier,
    spread_of_changes,
)
from reverie_eval.arrays import BoolArray, FloatArray, IntArray, offsets_of, row_of
from reverie_eval.metrics import CATALOGUE
from reverie_eval.schemas.evidence import (
    EvidenceReport,
    GapReport,
    NamedSubmission,
    SameFile,
    SimilarPair,
    SpreadReport,
    SubmissionEvidence,
    TeamEvidence,
    WalkReport,
)
from reverie_eval.scoring import clusters_of, is_goal
from reverie_eval.server.audit.receipts import Signer
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.integrity.traces import Trace, Traces
from reverie_eval.server.scoring.boards import Board, find_board
from reverie_eval.server.scoring.contexts import Scoring
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.tables import Submission, Team

AT_ONCE = 100
"""Submissions that a request reads, at most; the next request continues."""
PAIRS = 10
"""Pairs of teams that are listed, at most."""


_rounded = CATALOGUE["success"].rounded
"""Rounds a mean like scores of private splits: an exact one could reveal single episodes."""


class _Sent(NamedTuple):
    team: str
    id: str
    sha256: str
    received_at: Any
    method: Mapping[str, Any]

    @property
    def named(self) -> NamedSubmission:
        return NamedSubmission(id=self.id, team=self.team, method=self.method["name"])


_Known: TypeAlias = tuple[_Sent, Trace]
_Loaded: TypeAlias = Mapping[str, Trace]
"""By the SHA-256 of the upload."""


class Evidence(NamedTuple):
    """The evidence about a split, and what it was made from."""

    report: EvidenceReport
    read: Mapping[str, bytes]
    """Traces that are not stored yet, by the SHA-256 of the upload."""


@dataclass(frozen=True, slots=True)
class EvidenceService:
    """Gathers the evidence about the submissions to a split."""

    boards: Mapping[str, Board]
    database: Database
    scoring: Scoring
    signer: Signer

    @classmethod
    def of(cls, server: ServerState) -> Self:
        """Return the service of a server."""
        return cls(server.boards, server.database, server.scoring, server.signer)

    def report(self, session: Session, split: str, team: str | None = None) -> Evidence:
        """Report the evidence about a split, after reading some submissions if any are unread.

        If a team is given, the report also covers each of its submissions. What was read has to be
        stored after the session's snapshot, by :meth:`keep`.

        Raises
        ------
        NotFoundError
            If the server has no such split, or the split no submission of this team.
        """
        traces = self._traces(split)
        sent, missing = _sent_and_missing(session, traces, team)
        read = traces.read(missing, AT_ONCE)
        unread = set(missing) - read.contents.keys()
        known = traces.of_each(session, _submissions_to(split), read.contents)
        examined = _Examined.of(traces.board, self.signer)
        report = EvidenceReport(
            split=split,
            submissions=len(sent),
            left=sum(each.sha256 in unread - read.unreadable.keys() for each in sent),
            unreadable={
                each.id: read.unreadable[each.sha256]
                for each in sent
                if each.sha256 in read.unreadable
            },
            same_files=_same_files(sent),
            **examined.compare(
                ((_Sent(*row), trace) for row, trace in known),
                lambda digests: traces.load(session, digests, read.contents),
                team,
            ),
        )
        return Evidence(report, read.contents)

    def keep(self, split: str, read: Mapping[str, bytes]) -> None:
        """Store what was read of submissions to a split, so that it is not read again."""
        self._traces(split).store(read)

    def report_on_all(self, split: str, team: str | None = None) -> EvidenceReport:
        """Do what :meth:`report` does, after reading all submissions; few are in memory at a time.

        What was read is stored as it goes, so the next run continues an interrupted one.
        """
        traces = self._traces(split)
        with self.database.reading() as session:
            _, missing = _sent_and_missing(session, traces, team)
        for first in range(0, len(missing), AT_ONCE):
            batch = missing[first : first + AT_ONCE]
            traces.store(traces.read(batch, AT_ONCE).contents)
        with self.database.reading() as session:
            evidence = self.report(session, split, team)
        self.keep(split, evidence.read)
        return evidence.report

    def _traces(self, split: str) -> Traces:
        return Traces(find_board(self.boards, split), self.database, self.scoring)


def _sent_and_missing(
    session: Session, traces: Traces, team: str | None
) -> tuple[Sequence[_Sent], Sequence[str]]:
    """Return all submissions to a split, and the uploads without a trace.

    Raises NotFoundError if none is of the team.
    """
    split = traces.board.split
    marked = traces.marked(session, _submissions_to(split))
    sent = [(_Sent(*row), is_known) for row, is_known in marked]
    if team is not None and team not in {each.team for each, _ in sent}:
        raise NotFoundError(f"there is no team {team!r} with submissions to {split}")
    missing = dict.fromkeys(each.sha256 for each, is_known in sent if not is_known)
    return [each for each, _ in sent], [*missing]


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


def _same_files(sent: Sequence[_Sent]) -> list[SameFile]:
    by_file = defaultdict(list)
    for each in sent:
        by_file[each.sha256].append(each.named)
    # A team cannot send a file twice.
    return [
        SameFile(sha256=sha256, submissions=found)
        for sha256, found in by_file.items()
        if len(found) > 1
    ]


@dataclass(frozen=True)
class _Examined:
    """The data of a split that the evidence needs."""

    board: Board
    cluster: IntArray
    """Shape (n_episodes,): episodes with the same target."""
    is_open: BoolArray
    """Shape (n_episodes,): whether an episode is not in the secret half."""

    @classmethod
    def of(cls, board: Board, signer: Signer) -> "_Examined":
        """Draw the secret half with a key that only the server has; each target is in one half."""
        cluster = clusters_of(board.truth, "target")
        _, first, index = np.unique(cluster, return_index=True, return_inverse=True)
        key, names = signer.secret_for("secret half"), board.truth.episodes.instr_ids
        digests = (hmac.digest(key, names[row].encode(), hashlib.sha256) for row in first)
        return cls(board, cluster, np.array([digest[0] < 128 for digest in digests])[index])

    def compare(
        self, known: Iterable[_Known], load: Callable[[Collection[str]], _Loaded], team: str | None
    ) -> Mapping[str, Any]:
        """Return the parts of the report that need the files, with one team's in memory at a time.

        ``load`` returns the traces of the most similar ones again.
        """
        episodes = len(self.cluster)
        sample = np.random.default_rng(0).permutation(episodes)[:SAMPLED_EPISODES]
        sampled, teams, history = [], [], []
        sent: list[_Sent] = []
        for name, files in groupby(known, lambda each: each[0].team):
            own, loaded = zip(*files, strict=True)
            sent += own
            codes = np.array([each.codes for each in loaded])
            sampled.append(codes[:, sample])
            nearest, changed = nearest_earlier(codes)
            teams.append(self._team(name, loaded, codes, changed))
            if name == team:
                rows = zip(own, loaded, nearest.tolist(), changed.tolist(), strict=True)
                history = [
                    self._submission(each, one, own[row].id if row >= 0 else None, number)
                    for each, one, row, number in rows
                ]
        sizes = [len(each) for each in sampled]
        group = row_of(offsets_of(np.array(sizes, dtype=np.int64)))
        found = most_similar(np.concatenate(sampled), group, PAIRS) if sampled else None
        pairs = [(sent[pair.first], sent[pair.second]) for pair in (found.pairs if found else ())]
        again = load({each.sha256 for pair in pairs for each in pair}) if pairs else {}
        return {
            "usual_similarity": None if found is None else round(found.median, 4),
            "similar": [_pair(again, *pair) for pair in pairs],
            "teams": sorted(teams, key=lambda each: each.spread.p_value if each.spread else inf),
            "history": history,
        }

    def _team(
        self, name: str, loaded: Sequence[Trace], codes: IntArray, changed: IntArray
    ) -> TeamEvidence:
        spread = spread_of_changes(codes, self.board.truth.episodes.item)
        first, latest = loaded[0], loaded[-1]
        return TeamEvidence(
            team=name,
            submissions=len(loaded),
            median_changed=float(np.median(changed[1:])) if len(changed) > 1 else None,
            spread=spread and SpreadReport(**spread._asdict()),
            gap=self._gap(latest),
            gap_growth=self._gap(latest, first) if len(loaded) > 1 else None,
            jumps=max(each.walks.jumps for each in loaded),
        )

    def _submission(
        self, sent: _Sent, trace: Trace, nearest: str | None, changed: int
    ) -> SubmissionEvidence:
        return SubmissionEvidence(
            **sent.named.model_dump(),
            received_at=sent.received_at,
            nearest=nearest,
            changed=None if nearest is None else changed,
            gap=self._gap(trace),
            walks=self._walks(trace),
        )

    def _gap(self, latest: Trace, first: Trace | None = None) -> GapReport | None:
        """Return the gap of a file, or by how much it exceeds that of the first one."""
        if self.is_open.all() or not self.is_open.any():
            return None
        for metric in ("rgs", "success"):
            values = [each.values(self.board, metric) for each in (latest, first) if each]
            if all(each is not None for each in values):
                gap = gap_between(_difference(values), self.is_open, self.cluster)
                rounded = {name: _rounded(value) for name, value in gap._asdict().items()}
                return GapReport(metric=metric, **rounded)
        return None

    def _walks(self, trace: Trace) -> WalkReport:
        exact = by_chance = None
        success = trace.values(self.board, "success")
        if success is not None and success.any():
            is_success = success > 0
            goal = self.board.truth.require_solution().goal
            exact = _rounded(float((trace.episodes["stop"] == goal)[is_success].mean()))
            by_chance = _rounded(float((1 / self._goals[is_success]).mean()))
        return WalkReport(**trace.walks._asdict(), exact_stops=exact, exact_by_chance=by_chance)

    @cached_property
    def _goals(self) -> IntArray:
        """Shape (n_episodes,): the number of viewpoints at which each episode is a success."""
        truth = self.board.truth
        scan = truth.graph.viewpoint_scan
        own = scan[truth.episodes.start]
        begin, end = np.searchsorted(scan, own), np.searchsorted(scan, own, side="right")
        offsets = offsets_of(end - begin)
        episode = row_of(offsets)
        viewpoint = np.arange(len(episode)) - (offsets[:-1] - begin)[episode]
        return np.bincount(episode, is_goal(self.board.protocol.goal, truth, episode, viewpoint))


def _difference(values: Sequence[FloatArray | None]) -> FloatArray:
    latest, *first = (each for each in values if each is not None)
    return latest - first[0] if first else latest


def _pair(loaded: _Loaded, first: _Sent, second: _Sent) -> SimilarPair:
    one, other = loaded[first.sha256], loaded[second.sha256]
    return SimilarPair(
        first=first.named,
        second=second.named,
        equal=one.equal(other, "answer", "stop"),
        equal_answers=one.equal(other, "answer"),
        equal_stops=one.equal(other, "stop"),
        equal_paths=one.equal(other, "path"),
    )
