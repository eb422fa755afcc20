"""Arguments and options that several commands take, each worded once."""

import math
import os
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from datetime import date, datetime, timezone
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.shell_completion import CompletionItem

from reverie_eval import Evaluator, GroundTruth, ReverieEvalError, Scores, SubsetError
from reverie_eval.files import parse_toml
from reverie_eval.ground_truth import (
    DEMO_BUNDLES,
    GROUND_TRUTH_VARIABLE,
    bundled_splits,
    find_ground_truth,
    read_episode_ids,
)
from reverie_eval.tasks import DEFAULT_PROTOCOL, DEFAULT_TASK, KNOWN_SPLITS, find_task, task_names
from reverie_eval.text import did_you_mean
from reverie_eval_cli.output import RejectedSubmission

if TYPE_CHECKING:
    from reverie_eval.schemas.wire import WireModel
    from reverie_eval.scoring import Clustering, Track

Command = TypeVar("Command", bound=Callable[..., Any])
Request = TypeVar("Request", bound="WireModel")
ALL_PROTOCOLS = "all"
"""Instead of a protocol: all of the task."""
_SPLIT_NAMES = "train, val_seen, val_unseen or test."
_PER_CENT = 100
_NUMBER = re.compile(r"[0-9]+(\.[0-9]+)?")
PATH = click.Path(path_type=Path)


class Choice(click.Choice[str]):
    """One of some names; an error suggests the closest."""

    def get_invalid_choice_message(
        self,
        value: object,
        ctx: click.Context | None,  # noqa: ARG002
    ) -> str:
        """Say what was given, and what can be."""
        # click would list all choices; after a slip, the closest one is enough.
        return f"unknown value {value!r}{did_you_mean(value, self.choices)}"


class _SplitName(click.types.StringParamType):
    """The name of a split; which there are is known with the ground truth."""

    def get_missing_message(self, param: click.Parameter, ctx: click.Context | None) -> str:  # noqa: ARG002
        """Say what most splits are called."""
        return f"Name the split of the file: {_SPLIT_NAMES}"


class Number(click.IntRange):
    """A whole number in a range."""

    # As errors and the help name it; click says "integer range".
    name = "whole number"


class Decimal(click.FloatRange):
    """A finite number in a range."""

    name = "number"

    def convert(
        self, value: float, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Refuse what every range lets through, because no comparison with NaN is true."""
        number: float = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number", param, ctx)
        return number


class _Share(Decimal):
    """A share between 0 and 1; an error says how a percentage is written."""

    def convert(
        self, value: float, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Refuse a percentage, and name the share that it is."""
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter as error:
            percent = float(value) if _NUMBER.fullmatch(str(value)) else 0.0
            if 1 < percent < _PER_CENT:
                remedy = f"; write {percent / _PER_CENT:g} for {percent:g} %"
                self.fail(error.message.removesuffix(".") + remedy, param, ctx)
            raise


class Time(click.ParamType[datetime]):
    """A time with its time zone, as ISO 8601 writes it."""

    name = "TIME"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> datetime:
        """Read a time."""
        # Without its zone, a time is another moment on another machine.
        time = value if isinstance(value, datetime) else _read_time(str(value))
        if time is None:
            example = "such as 2027-06-01T12:00:00Z"
            self.fail(f"{value!r} is not a time with a time zone, {example}", param, ctx)
        return time.astimezone(timezone.utc)


class DayOrTime(click.ParamType[str]):
    """A day, or a time with its time zone."""

    name = "TIME"

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Return it as written: a day is its first second, or at the end of a phase its last."""
        try:
            # Kept as written: whether a day means its first or its last second depends on the end
            # of a phase.
            date.fromisoformat(value)
        except ValueError:
            if _read_time(value) is None:
                example = "such as 2027-06-01 or 2027-06-01T12:00:00Z"
                self.fail(
                    f"{value!r} is not a day or a time with a time zone, {example}", param, ctx
                )
        return value


def _read_time(text: str) -> datetime | None:
    """Return a time with its time zone, or None if the text is not one."""
    try:
        time = datetime.fromisoformat(text)
    except ValueError:
        return None
    # Guessing a zone would move deadlines.
    return None if time.tzinfo is None else time


def completing(
    names: Callable[[click.Context], Iterable[str]],
) -> Callable[[click.Context, click.Parameter, str], list[CompletionItem]]:
    """Complete to names, which may depend on the words before."""

    def complete(
        context: click.Context, _: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        return [CompletionItem(name) for name in names(context) if name.startswith(incomplete)]

    return complete


@completing
def complete_split(context: click.Context) -> Iterable[str]:
    """Complete to the splits of the ground truth, or to the published ones."""
    # Completion parses what was typed so far; an option behind the cursor is not known yet.
    given = context.params.get("ground_truth") or os.environ.get(GROUND_TRUTH_VARIABLE)
    return bundled_splits(Path(given or DEMO_BUNDLES)) or KNOWN_SPLITS


@completing
def complete_protocol(context: click.Context) -> Iterable[str]:
    """Complete to the protocols of the task."""
    task = find_task(context.params.get("task") or DEFAULT_TASK)
    return [*(each.name for each in task.protocols), *task.aliases]


complete_task = completing(lambda _: task_names())


with_default = partial(click.option, show_default=True)
submission = click.argument("submission", type=click.Path(allow_dash=True))
submissions = click.argument(
    "submissions",
    metavar="SUBMISSION...",
    nargs=-1,
    required=True,
    type=click.Path(allow_dash=True),
)


def split_named(*names: str) -> Callable[[Command], Command]:
    """Add the split that is scored, under these names."""
    return click.option(
        *names,
        "split",
        type=_SplitName(),
        required=True,
        metavar="NAME",
        shell_complete=complete_split,
        help=_SPLIT_NAMES,
    )


split = split_named("--split")
ground_truth = click.option(
    "--ground-truth",
    metavar="PATH",
    type=click.Path(),
    help="A bundle or a folder of bundles.  [default: $REVERIE_EVAL_GROUND_TRUTH, or else the "
    "demo world]",
)
task = click.option(
    "--task",
    metavar="NAME",
    shell_complete=complete_task,
    help="The benchmark, such as r2r.  [default: that of the bundle, or reverie]",
)


def _task_of(what: str) -> Callable[[Command], Command]:
    return with_default(
        "--task",
        default=DEFAULT_TASK,
        metavar="NAME",
        shell_complete=complete_task,
        help=f"The benchmark that the {what}, such as r2r.",
    )


server_task = _task_of("split is of")
dataset_task = _task_of("files are of")

protocol = with_default(
    "--protocol",
    default=DEFAULT_PROTOCOL,
    metavar="NAME",
    shell_complete=complete_protocol,
    help="The rules to score by.",
)
track = with_default(
    "--track",
    type=Choice(["full", "grounding"]),
    default="full",
    help="grounding: answers alone, with the agent placed at the goal.",
)


def episodes_listed(meaning: str) -> Callable[[Command], Command]:
    """Add a file that lists some episodes."""
    return click.option("--episodes-from", metavar="FILE", type=PATH, help=meaning)


episodes_from = episodes_listed(
    "Use only the episodes whose instr_ids FILE lists, one per line or as JSON."
)
cluster = with_default(
    "--cluster",
    type=Choice(["target", "scan"]),
    default="target",
    help="What to resample for intervals: target objects or scans, each with all its episodes.",
)


def confidence(meaning: str) -> Callable[[Command], Command]:
    """Add the confidence of intervals."""
    return click.option(
        "--confidence",
        metavar="SHARE",
        type=_Share(0, 1, min_open=True, max_open=True),
        help=f"{meaning}  [default: 0.95]",
    )


def together(*options: Callable[[Any], Any]) -> Callable[[Command], Command]:
    """Add several options, in this order."""

    def decorate(command: Command) -> Command:
        # Decorators apply from the inside, and the help lists options from the outside.
        for add in reversed(options):
            command = add(command)
        return command

    return decorate


def grouped(
    name: str, group: type, *options: Callable[[Any], Any]
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Add options that a command gets as one argument, a dataclass with a field for each."""

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(command)
        def with_group(**values: Any) -> Any:
            # click passes every option as an argument of its own; the fields of the dataclass say
            # which are taken.
            own = {field.name: values.pop(field.name) for field in fields(group)}
            return command(**{name: group(**own)}, **values)

        return together(*options)(with_group)

    return decorate


@dataclass(frozen=True)
class IntervalOptions:
    """What ``--ci``, ``--cluster`` and ``--confidence`` say, where intervals need not be shown."""

    ci: bool
    cluster: "Clustering | None"
    confidence: float | None

    @property
    def are_wanted(self) -> bool:
        """Whether any of them asks for intervals."""
        return bool(self.ci or self.cluster or self.confidence)

    @property
    def over(self) -> "Clustering":
        """What is resampled."""
        return self.cluster or "target"

    def added_to(self, scores: Scores) -> Scores:
        """Return scores with the intervals that are wanted, if any."""
        if not self.are_wanted:
            return scores
        return scores.with_intervals(self.over, confidence=self.confidence)


def intervals(shown: str, confident: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Add whether intervals are shown, over what, and how confident they are."""
    return grouped(
        "intervals",
        IntervalOptions,
        click.option("--ci", is_flag=True, help=f"Also show {shown}"),
        click.option(
            "--cluster",
            type=Choice(["target", "scan"]),
            help="What to resample for intervals; implies --ci.  [default: target]",
        ),
        confidence(f"Confidence of {confident}; implies --ci."),
    )


def sample_of(truth: GroundTruth, episodes_from: Path) -> GroundTruth:
    """Return the ground truth of the episodes that a file lists."""
    try:
        return truth.subset(read_episode_ids(episodes_from))
    except SubsetError as error:
        raise RejectedSubmission(f"{episodes_from}: {error}") from None


@dataclass(frozen=True)
class TruthOptions:
    """What ``--split``, ``--ground-truth`` and ``--task`` say."""

    split: str
    ground_truth: str | None
    task: str | None

    def find(self, episodes_from: Path | None = None) -> GroundTruth:
        """Find the ground truth of the split, or of the episodes that a file lists."""
        truth = find_ground_truth(self.ground_truth, self.split, self.task)
        return truth if episodes_from is None else sample_of(truth, episodes_from)


@dataclass(frozen=True)
class ScoringOptions(TruthOptions):
    """What ``--split``, ``--ground-truth``, ``--task``, ``--protocol`` and ``--track`` say."""

    protocol: str
    track: "Track"

    def evaluator(self, truth: GroundTruth) -> Evaluator:
        """Return what scores submissions."""
        if self.protocol == ALL_PROTOCOLS:
            known = ", ".join(each.name for each in truth.task.protocols)
            raise click.UsageError(
                "only `reverie-eval FILE` takes --protocol all; choose one here: " + known
            )
        return Evaluator(
            split=self.split, ground_truth=truth, protocol=self.protocol, track=self.track
        )


truth = grouped("truth_options", TruthOptions, split, ground_truth, task)


def scoring_by(
    protocol: Callable[[Any], Any], split: Callable[[Any], Any] = split
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Add what scores submissions, with a command's own options for protocol and split."""
    return grouped("scoring", ScoringOptions, split, ground_truth, task, protocol, track)


scoring = scoring_by(protocol)


def checked(
    model: type[Request], name_of: Callable[[str], str] = str, /, **fields: object
) -> Request:
    """Return what options ask for, checked as the API checks it; an error names wrong fields."""
    # Only organisers' commands check with the models of the API, which are slow to load.
    from pydantic import ValidationError

    from reverie_eval.schemas.wire import wrong_value

    try:
        return model.model_validate(fields)
    except ValidationError as error:
        wrong = map(wrong_value, error.errors())
        told = "; ".join(f"{name_of(each.where)}: {each.message}" for each in wrong)
        raise ReverieEvalError(told) from None


def output(what: str) -> Callable[[Command], Command]:
    """Add ``-o FILE`` for what a command prints otherwise."""
    return click.option(
        "-o",
        "--output",
        metavar="FILE",
        type=click.Path(),
        help=f"Write {what} to FILE.  [default: standard output]",
    )


def new_path(metavar: str, meaning: str) -> Callable[[Command], Command]:
    """Add ``-o`` for a file or a folder that a command always writes."""
    return click.option("-o", "--output", required=True, metavar=metavar, type=PATH, help=meaning)


def layout(*names: str, explained: str = "") -> Callable[[Command], Command]:
    """Add ``--format``, whose default is the first name."""
    return with_default(
        "--format",
        "layout",
        type=Choice(names),
        default=names[0],
        help=f"Format of the output.{explained}",
    )


dataset_parts = together(
    click.option(
        "--annotations",
        metavar="PATH",
        type=PATH,
        help="REVERIE_SPLIT.json or its folder; also a private file with the solution.",
    ),
    click.option("--boxes", metavar="PATH", type=PATH, help="The BBox folder, or one BBoxes.json."),
    click.option(
        "--connectivity", metavar="PATH", type=PATH, help="The folder of connectivity files."
    ),
)
"""Where the published files are, if not in a clone."""
dataset_files = together(
    click.argument("root", metavar="[DATASET]", required=False, type=PATH), dataset_parts
)
"""The published files: a clone's root, and where they are if not in it. A command gets them as the
keyword arguments of :meth:`reverie_eval.dataset.DatasetFiles.find`."""


jobs = click.option(
    "--jobs",
    metavar="N",
    type=Number(min=1),
    help="Number of worker processes.  [default: number of cores]",
)


def _read_agent_options(
    _context: click.Context, _parameter: click.Parameter, given: Iterable[str]
) -> dict[str, Any]:
    """Read each NAME=VALUE: the value is one of TOML, or else text."""
    return dict(map(_read_agent_option, given))


def _read_agent_option(text: str) -> tuple[str, Any]:
    name, mark, value = text.partition("=")
    if not mark:
        raise click.UsageError(f"--option {text}: expected NAME=VALUE")
    try:
        return name, parse_toml(f"value = {value}")["value"]
    except ValueError:
        return name, value


agent_option = click.option(
    "--option",
    metavar="NAME=VALUE",
    multiple=True,
    callback=_read_agent_options,
    help="An option of the agent; may be repeated.",
)
