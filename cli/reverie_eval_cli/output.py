"""What commands print and write: results, progress, and why a submission was rejected."""

import errno
import io
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO, TypeVar

import click

from reverie_eval import Evaluator, ReverieEvalError, Scores, SubmissionError
from reverie_eval.files import staged_file
from reverie_eval.logs import find_run
from reverie_eval.metrics import CATALOGUE
from reverie_eval.reporting.tables import MARK, Part, Printout, Table
from reverie_eval.scoring import Failure
from reverie_eval.submissions import source_name

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table as RichTable

T = TypeVar("T")
STANDARD_OUTPUT = "-"
_ANY_WIDTH = 1000
# Characters: on a terminal, a wrapped column is not narrower.
_NARROWEST_TEXT = 12


class RejectedSubmission(click.ClickException):
    """A submission or subset was rejected; the message names the file and lists its problems."""

    exit_code = 1

    def show(self, file: Any = None) -> None:
        """Print the problems to standard error."""
        # Not in click's form, which begins with "Error": editors jump to `file: location`.
        print(self.message, file=file or sys.stderr)


@contextmanager
def naming(submission: str) -> Iterator[None]:
    """Say which file was rejected."""
    try:
        yield
    except SubmissionError as error:
        raise RejectedSubmission(rejection(submission, error)) from None


def rejection(submission: str, error: SubmissionError) -> str:
    """Return what is wrong with which submission."""
    return f"{source_name(submission)}: {error}"


def score_each(submissions: Sequence[str], evaluator: Evaluator) -> Sequence[Scores]:
    """Score all, with the logs of runs; if some are rejected, list the problems of each."""

    def score(submission: str) -> Scores:
        scored, run = evaluator(submission), find_run(submission)
        return scored if run is None else scored.with_run(run)

    return score_each_by(score, submissions)


def score_each_by(score: Callable[[str], T], submissions: Sequence[str]) -> Sequence[T]:
    """Score all in another way; if some are rejected, list the problems of each."""
    scores: list[T] = []
    rejections: list[str] = []
    # All files before any is reported: one round of corrections, not one for each file.
    for submission in with_progress(submissions, "Scoring", len(submissions)):
        try:
            scores.append(score(submission))
        except SubmissionError as error:
            rejections.append(rejection(submission, error))
    if rejections:
        raise RejectedSubmission("\n".join(rejections))
    return scores


def failure_line(file: str, error: Failure) -> str:
    """Say in a line why a file has no scores."""
    if isinstance(error, OSError):
        return f"{file}: {error.strerror}"
    first, *others = error.problems
    more = f" (`reverie-eval validate` lists {len(others):,} more)" if others else ""
    return f"{file}: submission rejected: {first}{more}"


def check_outputs(
    outputs: Iterable[str | Path | None], inputs: Iterable[str | Path | None]
) -> None:
    """Refuse to write over an input, twice to the same file, or where nothing can be written."""
    # Resolved, so that links and ``./`` do not hide that two names are one file.
    taken = {Path(path).resolve() for path in inputs if path and Path(path).is_file()}
    for output in outputs:
        if not output or output == STANDARD_OUTPUT:
            continue
        resolved = Path(output).resolve()
        if resolved in taken:
            raise ReverieEvalError(
                f"{output} is an input, or named twice; choose another file to write to"
            )
        taken.add(resolved)
        # Said now, because after the scoring the scores would be lost. A device needs no folder.
        is_device, folder = resolved.exists() and not resolved.is_file(), resolved.parent
        if not is_device and not os.access(folder, os.W_OK | os.X_OK):
            reason = errno.EACCES if folder.is_dir() else errno.ENOENT
            raise OSError(reason, os.strerror(reason), str(output))


@contextmanager
def open_output(file_name: str, *, mode: int = 0o666) -> Iterator[TextIO]:
    """Open a text file that appears complete or not at all, or standard output.

    ``mode`` has the permissions of a new file, before the process's umask.
    """
    if file_name == STANDARD_OUTPUT:
        yield sys.stdout
        return
    with (
        staged_file(Path(file_name), mode=mode) as file,
        # A name on disk need not be valid UTF-8, and csv writes its own line ends.
        io.TextIOWrapper(file, "utf-8", errors="backslashreplace", newline="") as text,
    ):
        yield text


def write_text(text: str, output: str | None) -> None:
    """Write a text to a file, or to standard output."""
    with open_output(output or STANDARD_OUTPUT) as file:
        file.write(text)


def show(
    text: Callable[[], str],
    output: str | None = None,
    on_terminal: "Callable[[Console], None] | None" = None,
) -> None:
    """Write a result to a file, to a terminal in its own way, or to a pipe as text."""
    if on_terminal and output is None and _is_rich(sys.stdout):
        from rich.console import Console

        on_terminal(Console())
    else:
        write_text(f"{text()}\n", output)


def _is_rich(stream: TextIO) -> bool:
    """Whether the stream is a terminal and rich is installed, which draws on it."""
    return stream.isatty() and find_spec("rich") is not None


def show_printout(printout: Printout, layout: str, output: str | None) -> None:
    """Write a result in one of its formats; a terminal gets tables that fit it."""
    is_for_people = layout in ("table", "text")
    show(
        lambda: printout.text(layout),
        output,
        (lambda console: print_parts(console, printout.parts())) if is_for_people else None,
    )


def show_table(table: Table) -> None:
    """Print a table."""
    show(table.to_text, None, lambda console: print_table(console, table))


def print_parts(console: "Console", parts: Sequence[Part]) -> None:
    """Print the parts of a result on a terminal."""
    for part in parts:
        if part.title:
            console.print(part.title, style="bold", markup=False, highlight=False)
        for table in part.tables:
            print_table(console, table)
        if part.note:
            end = "\n" if part is parts[-1] else "\n\n"
            console.print(part.note, style=part.style, markup=False, highlight=False, end=end)


def print_table(console: "Console", table: Table) -> None:
    """Print on a terminal a table or, if it does not fit, its narrow layout, and its notes.

    A layout whose last text column can be wrapped fits as well. If none does, the table is printed
    as plain text and the terminal breaks its lines: nothing is cut.
    """
    for layout in filter(None, (table, table.narrow)):
        if _fits_wrapped(console, layout):
            console.print(_rich_table(layout))
            if not any(layout.headings):  # without headings, rich adds no empty line
                console.print()
            break
    else:
        text = replace(table, caption="", findings=(), notes=()).to_text()
        console.print(text, end="\n\n", markup=False, highlight=False, soft_wrap=True)
    for sentence in table.findings:
        console.print(sentence, style="bold", markup=False, highlight=False)
    if table.findings:
        console.print()
    for line in [*filter(None, [table.caption]), *table.notes]:
        # As they are, unwrapped, so that they can be copied.
        console.print(line, style="dim", markup=False, highlight=False, soft_wrap=True)


def fits(console: "Console", table: Table) -> bool:
    """Return whether a table fits a terminal without wrapping anything."""
    options = console.options.update_width(_ANY_WIDTH)
    return console.measure(_rich_table(table), options=options).maximum <= console.width


def _fits_wrapped(console: "Console", table: Table) -> bool:
    """Return whether a table fits a terminal with its last text column as narrow as allowed."""
    wrapped = max(table.text_columns, default=None)
    narrowest = [
        [cell[:_NARROWEST_TEXT] if number == wrapped else cell for number, cell in enumerate(row)]
        for row in table.rows
    ]
    return fits(console, replace(table, rows=narrowest))


def _rich_table(table: Table) -> "RichTable":
    from rich.box import SIMPLE_HEAD
    from rich.table import Table as RichTable
    from rich.text import Text

    has_headings, primary = any(table.headings), CATALOGUE[table.task.ranking[0]].heading
    laid_out = RichTable(box=SIMPLE_HEAD if has_headings else None, show_header=has_headings)
    for number, heading in enumerate(table.flat_headings):
        laid_out.add_column(
            heading,
            justify="left" if number in table.text_columns else "right",
            no_wrap=number != max(table.text_columns, default=None),
            overflow="fold",
            style="bold" if heading == primary else "",
        )
    for row in table.rows:
        cells = [Text(cell, style="yellow" if cell.endswith(MARK) else "") for cell in row]
        laid_out.add_row(*cells, style="bold" if row[0] == primary else "")
    return laid_out


def note(text: str) -> None:
    """Print a note to standard error."""
    say(f"note: {text}")


def say(text: str) -> None:
    """Print a line to standard error.

    Where that is closed or full, the line is lost, but neither the result nor the exit status.
    """
    with suppress(OSError):
        print(text, file=sys.stderr)


def with_progress(several: Iterable[T], description: str, total: int) -> Iterable[T]:
    """Show a progress bar on a terminal while they are worked on."""
    if not _is_rich(sys.stderr):
        return several
    from rich.console import Console
    from rich.progress import track

    # On standard error, and gone when done: the result stays alone on standard output.
    return track(several, description, total, console=Console(stderr=True), transient=True)


@contextmanager
def episode_bar(total: int, done: int) -> Iterator[Callable[[], None]]:
    """Show a progress bar of episodes on a terminal; yield the function that counts one more."""
    if not _is_rich(sys.stderr):
        yield lambda: None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    began = time.monotonic()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=total, completed=done, rate="")
        # Of this command alone: what was done before took no time now.
        finished = count(1)

        def advance() -> None:
            rate = next(finished) / (time.monotonic() - began)
            bar.update(task, advance=1, rate=f"{rate:.2g} a second")

        yield advance


@contextmanager
def transfer_bar(description: str) -> Iterator[Callable[[int, int], None] | None]:
    """Show a progress bar of bytes on a terminal; yield the function that updates it."""
    if not _is_rich(sys.stderr):
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn

    # Without markup: a file's name may have brackets.
    columns = TextColumn("{task.description}", markup=False), BarColumn(), DownloadColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(description, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
