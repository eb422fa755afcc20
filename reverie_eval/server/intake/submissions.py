"""Stored submissions: listing, changing, publishing and withdrawing them, and their episodes.

Teams see all of their own submissions; everyone sees published ones.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import lru_cache, partial
from itertools import chain
from typing import Any, Self, cast

from sqlalchemy import Exists, Select, exists, select, tuple_
from sqlalchemy.orm import Session

from reverie_eval.analysis import Comparison
from reverie_eval.reporting.service import METHOD_FLAGS
from reverie_eval.schemas.report import IntervalReport, ScoreReport
from reverie_eval.schemas.service import (
    BoardResult,
    EarlierResult,
    Method,
    MethodChange,
    ScoredSubmission,
    SubmissionChange,
)
from reverie_eval.scoring import Scores
from reverie_eval.server.audit.log import INSPECTED
from reverie_eval.server.audit.transactions import Actor, Transaction, difference
from reverie_eval.server.boards.entries import is_anonymous
from reverie_eval.server.boards.leaderboard import Sums, cluster_sums, store_sums
from reverie_eval.server.boards.reviews import (
    any_submission,
    find_submission,
    is_disqualified,
    standing_reviews,
)
from reverie_eval.server.boards.schedules import View
from reverie_eval.server.errors import ConflictError, MalformedError, NotFoundError
from reverie_eval.server.scoring.boards import Board, find_board
from reverie_eval.server.scoring.contexts import Context, check_signature, score_episodes
from reverie_eval.server.state import Reading, ServerState
from reverie_eval.server.store.database import AT_ONCE
from reverie_eval.server.store.paging import Listed, Page, cut, wrong_cursor
from reverie_eval.server.store.tables import IS_SHOWN, Person, Review, Submission, read_stored
from reverie_eval.server.store.uploads import stored_pieces, stored_upload

RECENT = 8
"""Submissions whose episodes are cached, because people look at one episode after the other."""
_NEWEST_FIRST = (Submission.received_at.desc(), Submission.id.desc())


def list_submissions(
    session: Session, person: Person, page: Page, view: View
) -> Listed[ScoredSubmission]:
    """List the submissions of a person's team, the newest first; the organiser sees all teams'.

    MalformedError if the cursor is invalid.
    """
    rows = _own(person)
    if page.cursor is not None:
        try:
            last = _row_of(session, person, page.cursor)
        except NotFoundError:
            raise wrong_cursor() from None
        place = tuple_(Submission.received_at, Submission.id)
        rows = rows.where(place < tuple_(last.received_at, last.id))
    found = session.scalars(rows.limit(page.limit + 1)).all()
    return cut(found, page, view.report, lambda row: row.id)


def newest_submissions(
    session: Session, person: Person, split: str, limit: int
) -> Sequence[Submission]:
    """Return a team's newest submissions to a split; for the organiser, those of all teams."""
    return session.scalars(_own(person).where(Submission.split == split).limit(limit)).all()


def _own(person: Person) -> Select[Submission]:
    rows = select(Submission).order_by(*_NEWEST_FIRST)
    if not person.is_organiser:
        rows = rows.where(Submission.team_id == person.team_id)
    return rows


def all_submissions(
    session: Session, *, split: str | None, team: str | None
) -> Iterator[Submission]:
    """Yield all submissions, the latest first; only those to a split or of a team, if given."""
    rows = select(Submission).order_by(*_NEWEST_FIRST)
    if split is not None:
        rows = rows.where(Submission.split == split)
    if team is not None:
        rows = rows.where(Submission.team.has(name=team))
    yield from session.scalars(rows.execution_options(yield_per=AT_ONCE))


def submission_of(
    session: Session, person: Person, submission_id: str, view: View
) -> ScoredSubmission:
    """Return a submission of a person's team; the organiser sees all teams'.

    Raises
    ------
    NotFoundError
        If it does not exist or belongs to another team; the error does not reveal which.
    """
    return view.report(_row_of(session, person, submission_id))


def result_on(name: str, submission: ScoredSubmission) -> BoardResult:
    """Return a submission's result on another leaderboard.

    Raises NotFoundError if it has none.
    """
    if name not in submission.boards:
        raise NotFoundError(
            f"{submission.id} has no result on a leaderboard {name!r}; it has results "
            f"on: {', '.join(submission.boards) or 'none'}"
        )
    return submission.boards[name]


@dataclass(frozen=True, slots=True)
class Publication:
    """A published submission, as everyone sees it."""

    id: str
    split: str
    team: str
    """Empty while the team chose to be anonymous."""
    team_id: int
    method: Method
    report: ScoreReport
    scores_held_until: datetime | None
    """When its scores are released, if they are not."""
    published_at: datetime
    shows_episodes: bool
    """Whether everyone may look at its episodes."""
    reviews: Sequence[Review]
    earlier: Sequence[EarlierResult]
    """Empty while scores are held back."""
    boards: Mapping[str, BoardResult]
    """The results on the other leaderboards of the split, by name."""


def publication(session: Session, submission_id: str, view: View) -> Publication:
    """Return a published submission; nothing in it reveals a team that is still anonymous.

    Raises
    ------
    NotFoundError
        If it does not exist, is not published or is withdrawn; the error does not reveal which.
    """
    row = find_submission(session, submission_id)
    if row is None or row.status != "published":
        raise NotFoundError("nothing is published here; sign in if it is a submission of your team")
    held_until = view.held_until(row)
    reviews = standing_reviews(session, row.id)
    return Publication(
        id=row.id,
        split=row.split,
        team=public_team(row, view.now),
        team_id=row.team_id,
        method=read_stored(Method, row.method),
        report=view.score_report(row),
        scores_held_until=held_until,
        published_at=cast("datetime", row.published_at),  # or it would not be published
        shows_episodes=row.shows_episodes or "baseline" in {each.verdict for each in reviews},
        reviews=reviews,
        earlier=[] if held_until else list(map(partial(read_stored, EarlierResult), row.earlier)),
        boards=view.boards(row),
    )


def public_team(row: Submission, now: datetime) -> str:
    """Return the team of a published submission; empty while it chose to be anonymous."""
    return "" if is_anonymous(row, now) else row.team.name


def with_public_episodes(split: str) -> Select[Submission]:
    """Select the published submissions to an open split whose episodes everyone may look at.

    These are the baselines, and those whose teams chose so; the latest first.
    """
    is_open = Submission.shows_episodes | has_review("baseline")
    return (
        select(Submission)
        .where(Submission.split == split, IS_SHOWN, is_open)
        .order_by(Submission.published_at.desc(), Submission.id)
    )


def has_review(verdict: str) -> Exists:
    """Return the condition that a submission has a standing review with a verdict."""
    return exists().where(
        Review.submission_id == Submission.id,
        Review.verdict == verdict,
        Review.lifted_at.is_(None),
    )


def check_metadata(method: Method, required: Collection[str]) -> None:
    """Check that a method has all required information.

    Raises MalformedError, which says what is missing.
    """
    missing = [name for name in required if getattr(method, name) in {"", None}]
    if missing:
        words = ", ".join(METHOD_FLAGS.get(name, name) for name in missing)
        raise MalformedError(f"required information about the method is missing: {words}")


@dataclass
class SubmissionService:
    """Access to submissions that needs more than the database: files, episodes and changes."""

    server: ServerState

    @classmethod
    def of(cls, server: ServerState) -> Self:
        """Return the service of a server."""
        return cls(server)

    def __post_init__(self) -> None:
        """Create the caches of scores and comparisons."""
        self._scored = lru_cache(RECENT)(self._score_again)
        self._compared = lru_cache(RECENT)(self._compare_again)

    def view(self, session: Session, now: datetime) -> View:
        """Return what may be seen at a moment."""
        return View.of(Reading(self.server, session, now))

    def file(self, submission: ScoredSubmission) -> Iterator[bytes]:
        """Return the submitted file, unpacked and otherwise unchanged, in pieces.

        Raises
        ------
        NotFoundError
            If it was deleted.
        UploadsError
            If the stored file is missing or damaged, at the latest after the last piece.
        """
        _check_upload(submission)
        pieces = stored_pieces(self.server.uploads, submission.sha256)
        return chain([next(pieces)], pieces)

    def episodes(self, submission: ScoredSubmission, name: str = "") -> Scores:
        """Return the scores of every episode, computed again from the upload.

        They are scored under the rules of the split's main leaderboard, or of another one that has
        the submission.

        Raises
        ------
        NotFoundError
            For every submission to a private split; also if the file was deleted, or the ground
            truth or the protocol has changed since the submission was scored.
        """
        self.check_episodes(submission, name)
        board = self.server.board(submission.split, name)
        return self._scored(board.split, name, board.signature, submission.sha256)

    def check_episodes(self, submission: ScoredSubmission, name: str = "") -> None:
        """Raise the NotFoundErrors of :meth:`episodes`."""
        board = self.server.board(submission.split, name)
        _check_upload(submission)
        if board.is_private:
            raise NotFoundError("per-episode values of private splits are never released")
        if not board.measures_as(submission.results[name].report):
            raise NotFoundError(
                f"the ground truth or protocol of {board.label} has changed since this submission; "
                "see its signature"
            )

    def _score_again(self, split: str, name: str, signature: str, sha256: str) -> Scores:
        """Score an upload again; a result is kept for the signature that it has."""
        board = self.server.board(split, name)
        check_signature(board, signature)
        return self.server.scoring.run(score_episodes, split, name, sha256).scores(board)

    def inspect(self, submission_id: str, actor: Actor) -> tuple[ScoredSubmission, Scores]:
        """Return a submission, and the value of every episode, scored again from its upload.

        Those of a private split are never sent over the network. They are for a user of the
        server's machine, who can read the ground truth anyway, and the audit log records it.

        Raises
        ------
        NotFoundError
            If there is no such submission, or its split is no longer served.
        UploadsError
            If its upload is missing or damaged.
        ConflictError
            If the means are not the stored scores, or the file was deleted because of its age.
        """
        folder = self.server.settings.folder
        with self.server.database.reading() as session:
            row = any_submission(session, submission_id)
            if row.upload_deleted_at is not None:
                raise ConflictError(
                    f"the file of {submission_id} was deleted on {row.upload_deleted_at:%Y-%m-%d}, "
                    "because it was old and not published"
                )
            known = row.as_scored()
        board = self.server.board(known.split)
        if not board.measures_as(known.report):
            raise ConflictError(
                f"{submission_id} was scored before the ground truth or the rules changed; "
                f"run `reverie-eval server rescore {folder} {board.split}` first"
            )
        reading = board.read(stored_upload(self.server.uploads, known.sha256))
        scores = board.score(reading)
        if board.report(scores, reading).scores != known.report.scores:
            raise ConflictError(
                f"{submission_id}: the upload does not give the stored scores; run `reverie-eval "
                f"server doctor {folder}`"
            )
        with self.server.transactions.begin(actor) as transaction:
            row = any_submission(transaction.session, submission_id)
            transaction.record(INSPECTED, row, row.id)
        return known, scores

    def compare(self, board: Board, named: Mapping[str, ScoredSubmission]) -> Comparison:
        """Compare results of a leaderboard on the same episodes, all others with the first.

        Raises
        ------
        NotFoundError
            As for :meth:`episodes`.
        ProtocolError
            If the split has a single target.
        """
        for each in named.values():
            self.check_episodes(each, board.name)
        files = tuple((name, each.sha256) for name, each in named.items())
        return self._compared(board.split, board.name, board.signature, files)

    def _compare_again(
        self, split: str, name: str, signature: str, files: tuple[tuple[str, str], ...]
    ) -> Comparison:
        return Comparison.of(
            {key: self._scored(split, name, signature, file) for key, file in files}
        )

    def change(
        self,
        person: Person,
        submission_id: str,
        change: SubmissionChange,
        organiser: Actor | None = None,
    ) -> ScoredSubmission:
        """Publish, withdraw or edit a submission, or hide its team until a date.

        An ``organiser`` may do this for a person.

        Raises
        ------
        NotFoundError
            As for :func:`submission_of`.
        ConflictError
            If a withdrawn submission would be published, a disqualified one removed, or episodes of
            a private split shown.
        MalformedError
            If required information about the method would be missing.
        """
        with self.server.database.reading() as session:
            self.server.rules.follow(session)
            known = _row_of(session, person, submission_id).as_scored()
            if not change.model_fields_set:
                view = self.view(session, self.server.clock())
                return submission_of(session, person, submission_id, view)
        drawn = self._intervals(known) if change.published else {}
        with self.server.transactions.begin(organiser or person) as transaction:
            now, row = transaction.now, _row_of(transaction.session, person, submission_id)
            is_removed = change.withdrawn or change.published is False
            if is_removed and is_disqualified(standing_reviews(transaction.session, row.id)):
                raise ConflictError(
                    "the organiser has disqualified this submission; until the review is lifted, "
                    "it cannot be unpublished or withdrawn"
                )
            results, before = row.results, _editable(row)
            if any(
                results[name].report.signature != known.results[name].report.signature
                for name in drawn
            ):
                raise ConflictError(
                    "this submission was scored again meanwhile, after a correction; try again"
                )
            for name, (intervals, _) in drawn.items():
                report = results[name].report.model_copy(update={"intervals": intervals})
                row.store_result(name, results[name].model_copy(update={"report": report}))
            sums = {name: of_board for name, (_, of_board) in drawn.items()}
            store_sums(transaction.session, row.id, sums)
            self._apply(change, row, now)
            details = difference(before, _editable(row))
            if details or drawn:
                transaction.record("changed", row, row.id, **details)
            self._replace_earlier(transaction, row, change)
            return self.view(transaction.session, now).report(row)

    def _apply(self, change: SubmissionChange, row: Submission, now: datetime) -> None:
        if change.method is not None:
            row.method = self._edited(row, change.method).model_dump(mode="json")
        if change.withdrawn is not None:
            row.withdrawn_at = (row.withdrawn_at or now) if change.withdrawn else None
        if change.published is not None:
            row.published_at = (row.published_at or now) if change.published else None
        if "anonymous_until" in change.model_fields_set:
            row.anonymous_until = change.anonymous_until
        if change.shows_episodes is not None:
            row.shows_episodes = self._may_show(row, wanted=change.shows_episodes)
        if change.published and row.withdrawn_at is not None:
            raise ConflictError("a withdrawn submission cannot be published; restore it first")

    def _may_show(self, row: Submission, *, wanted: bool) -> bool:
        board = self.server.boards.get(row.split)
        if wanted and (board is None or board.is_private):
            raise ConflictError("episodes of private splits are never shown to anyone")
        return wanted

    def _replace_earlier(
        self, transaction: Transaction, row: Submission, change: SubmissionChange
    ) -> None:
        """Take the team's other results off the leaderboard, if the split shows one per team.

        A disqualified one stays.
        """
        board = self.server.boards.get(row.split)
        is_shown = row.published_at is not None and (change.published or change.withdrawn is False)
        if board is None or not board.settings.one_per_team or not is_shown:
            return
        chosen = select(Submission).where(
            Submission.split == row.split,
            Submission.team_id == row.team_id,
            Submission.id != row.id,
            IS_SHOWN,
        )
        for earlier in transaction.session.scalars(chosen).all():
            if not is_disqualified(standing_reviews(transaction.session, earlier.id)):
                before = _editable(earlier)
                earlier.published_at = None
                details = difference(before, _editable(earlier))
                transaction.record("changed", earlier, earlier.id, **details)

    def _edited(self, row: Submission, change: MethodChange) -> Method:
        edited = change.model_dump(mode="json", exclude_unset=True)
        method = read_stored(Method, {**row.method, **edited})
        check_metadata(method, self.server.settings.required_metadata)
        # A file with answers may be declared so, or not be declared.
        if bool(method.navigation_only) is not bool(row.method["navigation_only"]):
            raise ConflictError(
                "whether a submission is navigation only follows from its file, and cannot be "
                "changed"
            )
        return method

    def _intervals(self, known: ScoredSubmission) -> Mapping[str, tuple[IntervalReport, Sums]]:
        """Compute missing intervals, and the sums by which ranks are compared, by leaderboard.

        This is done for open splits only. It takes longer than scoring, so it is only done for
        published submissions.
        """
        own = self.server.board(known.split)
        waiting = [
            board
            for board in own.all
            if (result := known.results.get(board.name)) is not None
            and result.report.intervals is None
            and board.measures_as(result.report)
        ]
        if own.is_private or known.upload_deleted_at is not None or not waiting:
            return {}
        return self.server.scoring.run(
            draw_intervals, known.split, [board.name for board in waiting], known.sha256
        )


def draw_intervals(
    context: Context, split: str, names: Sequence[str], sha256: str
) -> Mapping[str, tuple[IntervalReport, Sums]]:
    """Return intervals and cluster sums of a stored upload, by leaderboard that has intervals."""
    content = stored_upload(context.uploads, sha256)
    boards = [find_board(context.boards, split, name) for name in names]
    found = {board.name: board.scored(content, has_intervals=True) for board in boards}
    return {
        name: (report.intervals, cluster_sums(scores))
        for name, (report, scores) in found.items()
        if report.intervals is not None and scores is not None
    }


def _editable(row: Submission) -> Mapping[str, Any]:
    """Return what a team may change of a submission, as the audit log has it."""
    state = SubmissionChange(
        published=row.published_at is not None,
        withdrawn=row.withdrawn_at is not None,
        anonymous_until=row.anonymous_until,
        shows_episodes=row.shows_episodes,
    )
    method = read_stored(Method, row.method).model_dump(mode="json")
    return {**state.model_dump(mode="json"), "method": method}


def _check_upload(submission: ScoredSubmission) -> None:
    if submission.upload_deleted_at is not None:
        day = f"{submission.upload_deleted_at:%Y-%m-%d}"
        raise NotFoundError(
            f"the file was deleted on {day}: this server deletes the files of unpublished "
            "submissions after a while; scores and receipt stay"
        )


def _row_of(session: Session, person: Person, submission_id: str) -> Submission:
    row = find_submission(session, submission_id)
    if row is None or (not person.is_organiser and row.team_id != person.team_id):
        raise NotFoundError(f"your team has no submission {submission_id!r}")
    return row
