"""Checks before a server starts; all problems are reported at once, each with its remedy."""

import os
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from reverie_eval.errors import Problem
from reverie_eval.receipts import ReceiptError, key_id_of
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.server.audit.signing import (
    current_key,
    load_key,
    open_key,
    public_pem_of,
)
from reverie_eval.server.boards.schedules import Schedules
from reverie_eval.server.corrections.corrections import count_outdated
from reverie_eval.server.opening import REFUSALS, FolderError, damaged, database_fault, reason_of
from reverie_eval.server.scoring.boards import Board, all_boards, load_boards, rules_of
from reverie_eval.server.scoring.rules import LastRules, different
from reverie_eval.server.settings import (
    SETTINGS_FILE,
    Settings,
    SettingsError,
    load_settings,
    variables_ignored,
)
from reverie_eval.server.store.damage import find_damage
from reverie_eval.server.store.database import AT_ONCE, Database, is_full
from reverie_eval.server.store.tables import IS_SHOWN, Submission, read_stored
from reverie_eval.server.store.uploads import Uploads, UploadsError, open_uploads, stored_pieces
from reverie_eval.text import count_text, first_few, short_digest

_DEFAULT_PASSWORDS = frozenset({"postgres", "password", "secret", "changeme", "change-me", "admin"})
NEWEST_UPLOAD = "newest upload"
"""A check that ``server doctor`` does not need, as it reads all uploads."""
_NEWEST = select(Submission.sha256, Submission.upload_deleted_at).order_by(
    Submission.received_at.desc()
)
_OTHERS_MAY_READ = 0o077
_FEW_EPISODES = 1000


@dataclass(frozen=True, slots=True)
class Finding:
    """One result of checking a server."""

    check: str
    """What was checked: ``signing key``."""
    kind: Literal["ok", "note", "fault"]
    what: str
    """What was found; for a fault, also what to do."""


def check_folder(folder: Path) -> Sequence[Finding]:
    """Check everything that a server needs to start."""
    try:
        settings = load_settings(folder)
    except SettingsError as error:
        return [Finding("settings", "fault", str(problem)) for problem in error.problems]
    return list(_findings(settings))


def _findings(settings: Settings) -> Iterator[Finding]:
    yield from _at_settings(settings)
    fault = database_fault(settings) or _damage(settings)
    boards = yield from _at_ground_truth(settings, {} if fault else _rules_in_force(settings))
    if fault is not None:
        yield from _at_signing_key(settings, None)
        yield Finding("database", "fault", fault)
        yield from _at_uploads(settings, None)
        return
    with closing(Database(settings.database_url)) as database, database.reading() as session:
        yield from _at_signing_key(settings, session)
        # The URL's query may contain the passphrase of a key.
        url = settings.database_url.set(query={}).render_as_string()
        yield Finding("database", "ok", url)
        yield from guarded("database", _at_rows(session, settings, boards))
        yield from guarded("uploads", _at_uploads(settings, session))


def _rules_in_force(settings: Settings) -> Mapping[str, str]:
    """Return the rules that were recorded last; none if they cannot be read."""
    with (
        suppress(LookupError, TypeError, *REFUSALS),
        closing(Database(settings.database_url)) as database,
        database.reading() as session,
    ):
        return LastRules().read(session)
    return {}


def _at_rows(
    session: Session, settings: Settings, boards: Mapping[str, Board]
) -> Iterator[Finding]:
    yield from _at_rules(session, boards)
    yield from _at_schedules(session, settings)
    yield from _at_results(session, boards, settings.folder)


def guarded(check: str, findings: Iterator[Finding]) -> Iterator[Finding]:
    """Yield findings; if stored rows cannot be read, yield that as the last one."""
    try:
        yield from findings
    except REFUSALS as error:
        yield Finding(check, "fault", reason_of(error))
    except (LookupError, TypeError, AttributeError):  # JSON of another shape
        yield Finding(check, "fault", damaged("a stored value cannot be read"))


def _damage(settings: Settings) -> str | None:
    """Return what is damaged in a database of this version, and the remedy; None if nothing is."""
    found = find_damage(settings.database_url)
    return damaged(first_few(found, 1)) if found else None


def check_sound(folder: Path, note: Callable[[str], None]) -> Settings:
    """Check a server's folder and return its settings.

    ``note`` is called with each finding that is not a fault but deserves attention.

    Raises
    ------
    FolderError
        If there are faults; it lists all of them.
    """
    findings = check_folder(folder)
    faults = [finding for finding in findings if finding.kind == "fault"]
    if faults:
        raise FolderError([Problem("unsound", fault.check, fault.what) for fault in faults])
    for finding in findings:
        if finding.kind == "note":
            note(finding.what)
    return load_settings(folder)


def _at_settings(settings: Settings) -> Iterator[Finding]:
    file = settings.folder / SETTINGS_FILE
    is_private = not file.stat().st_mode & _OTHERS_MAY_READ
    yield Finding("settings", "ok", f"{file}, splits: {', '.join(settings.splits)}")
    for name in variables_ignored():
        message = f"the environment variable {name} is not a setting; check its spelling"
        yield Finding("settings", "note", message)
    if settings.public_address.startswith("https:") and not settings.trusted_proxies:
        message = (
            "public_address is https, which a proxy must provide, but trusted_proxies is empty: "
            "all visitors share one rate limit, and cookies are not marked Secure; add the "
            "address from which the proxy connects"
        )
        yield Finding("settings", "note", message)
    yield from _at_password_file(settings)
    url = settings.database_url
    if url.password and not is_private and "REVERIE_EVAL_DATABASE" not in os.environ:
        message = f"other users can read the database's password; run `chmod 600 {file}`"
        yield Finding("settings", "fault", message)
    if url.password and url.password in {*_DEFAULT_PASSWORDS, url.username}:
        message = "the database's password is easy to guess; choose another"
        yield Finding("settings", "fault", message)


def _at_password_file(settings: Settings) -> Iterator[Finding]:
    if settings.mail is None or settings.mail.password_file is None:
        return
    file = settings.path(settings.mail.password_file)
    try:
        is_private = not file.stat().st_mode & _OTHERS_MAY_READ
    except OSError as error:
        yield Finding("settings", "fault", f"{file} cannot be read: {error.strerror}")
    else:
        if not is_private:
            message = f"other users can read {file}; run `chmod 600 {file}`"
            yield Finding("settings", "fault", message)


def _at_ground_truth(
    settings: Settings, in_force: Mapping[str, str]
) -> Generator[Finding, None, Mapping[str, Board]]:
    """Return the splits; none if some cannot be scored."""
    try:
        boards = load_boards(settings, in_force)
    except SettingsError as error:
        yield from (Finding("ground truth", "fault", str(problem)) for problem in error.problems)
        return {}
    for name, board in boards.items():
        truth = board.truth
        digest = short_digest(truth.fingerprint)
        what = f"{name}: {truth.header.dataset}, {board.settings.visibility}, {digest}"
        yield Finding("ground truth", "ok", what)
        episodes = len(truth.episodes.instr_ids)
        if board.is_private and board.others:
            yield Finding("ground truth", "note", _told_by_others(board, episodes))
        if board.is_private and episodes < _FEW_EPISODES and not truth.is_demo:
            message = (
                f"{name} is private and has only {episodes} episodes: its scores reveal exact "
                "counts, and a year's submissions reveal the outcomes of more than a tenth of the "
                "episodes; lower its quota (documentation: Security)"
            )
            yield Finding("ground truth", "note", message)
    demo = [name for name, board in boards.items() if board.truth.is_demo]
    if demo and len(demo) < len(boards):
        verb = "are" if len(demo) > 1 else "is"
        message = (
            f"{', '.join(demo)} {verb} of the synthetic demo world, beside splits with real data: "
            "its scores mean nothing, and pages say so; replace the bundle, or remove the section "
            "from the settings"
        )
        yield Finding("ground truth", "note", message)
    return boards


def _told_by_others(board: Board, episodes: int) -> str:
    """Return a sentence on what other leaderboards of a private split reveal."""
    own, all_counts = (
        sum(metric.is_binary for each in boards for metric in each.headline)
        for boards in ([board], board.all)
    )
    year = board.settings.effective_quota.year
    return (
        f"{board.split} is private and has {count_text(len(board.others), 'other leaderboard')}: a "
        f"submission reveals up to {all_counts} counts of outcomes instead of {own}, so a year's "
        f"{count_text(year, 'submission')} reveal up to {year * all_counts:,} outcomes of "
        f"{episodes:,} episodes instead of {year * own:,} (documentation: Security)"
    )


def _at_signing_key(settings: Settings, session: Session | None) -> Iterator[Finding]:
    """Check the key; which one is in use is known only if the database can be used."""
    current = None if session is None else current_key(session)
    try:
        path = settings.path(settings.signing_key)
        key = load_key(path) if current is None else open_key(path, current.key_id)
    except ReceiptError as error:
        yield Finding("signing key", "fault", str(error))
    else:
        yield Finding("signing key", "ok", key_id_of(public_pem_of(key)))


def _at_rules(session: Session, boards: Mapping[str, Board]) -> Iterator[Finding]:
    """Check whether the last server on the database had other rules, such as another bundle."""
    rules, last = rules_of(boards), LastRules().read(session)
    for board in different(rules, last) if boards else ():
        ours, theirs = (each.get(board, "no such leaderboard") for each in (rules, last))
        message = (
            f"{board}: this folder has {ours}, the server that last started on this database "
            f"{theirs}; such servers would score the same file differently: restart all of "
            "them with the same bundles and settings"
        )
        yield Finding("rules", "note", message)


def _at_schedules(session: Session, settings: Settings) -> Iterator[Finding]:
    """Look for splits whose phases or pauses were set at the desk."""
    reports = Schedules(settings.splits).list_all(session)
    for report in filter(lambda report: report.desk, reports):
        split, now = settings.splits[report.split], report.in_effect
        try:
            split.check_phases(now.phases, now.release_scores)
        except ValueError as error:
            remedy = f"run `reverie-eval server phase reset {settings.folder} {report.split}`"
            message = f"{report.split}, as set at the desk: {error}; {remedy}"
            yield Finding("phases", "fault", message)
            continue
        message = (
            f"{report.split}: phases or a pause set at the desk override the settings; "
            f"`reverie-eval server phase show {settings.folder}` compares them"
        )
        yield Finding("phases", "note", message)


def _at_results(session: Session, boards: Mapping[str, Board], folder: Path) -> Iterator[Finding]:
    """Look for stored exact values of private splits, and for results that are not ranked."""
    try:
        for board in filter(lambda board: board.is_private, boards.values()):
            yield from _at_exact_values(session, board)
        for board in all_boards(boards):
            yield from _at_outdated(session, board, folder)
        for board in filter(lambda board: board.settings.one_per_team, boards.values()):
            yield from _at_several(session, board)
    except REFUSALS:
        message = "some results cannot be read; run `reverie-eval server doctor`"
        yield Finding("results", "note", message)


def _at_exact_values(session: Session, board: Board) -> Iterator[Finding]:
    kept = select(Submission.report, Submission.earlier, Submission.boards)
    exact = 0
    for report, earlier, boards in session.execute(
        kept.where(Submission.split == board.split).execution_options(yield_per=AT_ONCE)
    ):
        results = [{"report": report}, *earlier]
        for result in boards.values():
            results += [result, *result["earlier"]]
        reports = (read_stored(ScoreReport, result["report"]) for result in results)
        exact += not all(map(board.may_keep, reports))
    if exact:
        message = (
            f"{board.split} is private, but exact values of {count_text(exact, 'result')} were "
            "stored while it was open; open it again, and give the private split another name"
        )
        yield Finding("secrets", "fault", message)


def _at_several(session: Session, board: Board) -> Iterator[Finding]:
    """Look for teams with several results on a leaderboard that shows one of each."""
    teams = select(Submission.team_id).where(Submission.split == board.split, IS_SHOWN)
    several = teams.group_by(Submission.team_id).having(func.count() > 1)
    number = len(session.scalars(several).all())
    if number:
        message = (
            f"{count_text(number, 'team')} with several published results on {board.split}, which "
            "shows one per team; these stay until the team publishes its next result or "
            "unpublishes them"
        )
        yield Finding("results", "note", message)


def _at_outdated(session: Session, board: Board, folder: Path) -> Iterator[Finding]:
    number = count_outdated(session, board)
    if not number:
        return
    sent, command = count_text(number, "submission"), f"reverie-eval server rescore {folder}"
    have = "has" if number == 1 else "have"
    message = (
        f"{sent} to {board.split} {have} no result on {board.name} under the current ground "
        f"truth and rules; score them with `{command} {board.split}`"
        if board.name
        else f"{sent} to {board.split} not ranked, because the ground truth or the rules have "
        f"changed since; score them again with `{command} {board.split}`"
    )
    yield Finding("results", "note", message)


def _at_uploads(settings: Settings, session: Session | None) -> Iterator[Finding]:
    """Check that uploads can be stored, and are those of the database, if that can be used."""
    is_s3 = settings.uploads.startswith("s3://")
    place = settings.uploads if is_s3 else str(settings.path(settings.uploads))
    try:
        uploads = open_uploads(settings.uploads, settings.folder)
        uploads.try_out()
    except UploadsError as error:
        yield Finding("uploads", "fault", str(error))
        return
    except OSError as error:
        is_space = is_full(error)
        remedy = "free some space" if is_space else "choose a folder that the server can write to"
        message = f"{place}: {error.strerror}; {remedy}"
        yield Finding("uploads", "fault", message)
        return
    yield Finding("uploads", "ok", place)
    if session is not None:
        try:
            try_newest(session, uploads)  # `server doctor` reads all of them
        except UploadsError as error:
            yield Finding(NEWEST_UPLOAD, "fault", str(error))


def try_newest(session: Session, uploads: Uploads) -> None:
    """Test whether the newest upload can be read: then the others are in their place, too.

    Raises UploadsError if not.
    """
    newest = session.execute(_NEWEST.limit(1)).first()
    if newest is not None and newest.upload_deleted_at is None:
        next(stored_pieces(uploads, newest.sha256))
