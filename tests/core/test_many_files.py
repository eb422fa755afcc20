"""Many files give the same scores wherever they are scored, and one bad file stops no other."""

import json
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from subprocess import PIPE
from typing import Any

import pytest

import reverie_eval as rv
from reverie_eval.runner import run_agent
from reverie_eval.scoring import Executor
from reverie_eval.submissions import watch_files
from tests.conftest import COMMAND, SAMPLES
from tests.support.executors import EXECUTORS, Pickling
from tests.support.flat_world import Run

SPLIT = "val_unseen"
NAMES = ("mediocre", "good", "broken", "drawn")


@pytest.fixture
def files(tmp_path: Path) -> list[str]:
    """Copy the samples, and name a file that is not there."""
    for name in NAMES:
        shutil.copy(SAMPLES / f"{name}.json", tmp_path)
    return [*(str(tmp_path / f"{name}.json") for name in NAMES), str(tmp_path / "gone.json")]


def check(scored: rv.ScoredFiles, files: list[str]) -> None:
    """Check that all is as if each file had been scored alone."""
    mediocre, good, broken, drawn, gone = files
    assert list(scored) == [good, drawn, mediocre]
    assert list(scored.ranks.values()) == [1, 2, 3]
    for path, scores in scored.items():
        alone = rv.evaluate(path, split=SPLIT)
        assert dict(scores) == dict(alone)
        assert scores.signature == alone.signature
        assert scores.notes == alone.notes
        assert scores.box_outcomes == alone.box_outcomes
    assert list(scored.failures) == [broken, gone]
    rejected, missing = scored.failures.values()
    with pytest.raises(rv.SubmissionError) as alone_rejected:
        rv.evaluate(broken, split=SPLIT)
    assert str(rejected) == str(alone_rejected.value)
    assert isinstance(missing, FileNotFoundError)


@pytest.fixture(params=EXECUTORS)
def executor(request: pytest.FixtureRequest) -> Iterator[Executor]:
    with EXECUTORS[request.param]() as executor:
        yield executor


@pytest.mark.parametrize("jobs", [1, 2])
def test_processes_of_this_machine(jobs: int, files: list[str]) -> None:
    check(rv.evaluate_many(files, split=SPLIT, jobs=jobs), files)


def test_an_executor(executor: Executor, files: list[str]) -> None:
    check(rv.evaluate_many(files, split=SPLIT, executor=executor), files)


@pytest.mark.parametrize("where", [None, Pickling()], ids=["here", "elsewhere"])
@pytest.mark.parametrize("option", ["protocol", "track", "subset", "ground_truth"])
def test_files_are_scored_as_asked(
    option: str, where: Executor | None, files: list[str], demo: rv.GroundTruth
) -> None:
    ids = demo.episodes.instr_ids[:20]
    given = {
        "protocol": "duet",
        "track": "grounding",
        "subset": ids,
        "ground_truth": demo.subset(ids),
    }
    options: dict[str, Any] = {option: given[option]}
    scored = rv.evaluate_many(files[:2], split=SPLIT, jobs=1, executor=where, **options)
    for file in files[:2]:
        alone = rv.evaluate(file, split=SPLIT, **options)
        assert (dict(scored[file]), scored[file].signature) == (dict(alone), alone.signature)


def test_ground_truth_that_is_no_file(files: list[str], demo: rv.GroundTruth) -> None:
    truth = replace(demo, origin="memory")
    check(rv.evaluate_many(files, split=SPLIT, ground_truth=truth, executor=Pickling()), files)


def test_fifty_files_are_sent_together(files: list[str], tmp_path: Path) -> None:
    many = [str(shutil.copy(files[1], tmp_path / f"{n}.json")) for n in range(120)]
    executor = Pickling()
    scored = rv.evaluate_many(many, split=SPLIT, executor=executor)
    assert executor.calls == 3
    assert list(scored) == many
    assert set(scored.ranks.values()) == {1}


def test_another_bundle_elsewhere(files: list[str], tmp_path: Path) -> None:
    class Elsewhere(Pickling):
        def submit(self, function: Any, argument: Any, /) -> Any:
            _, results = super().submit(function, argument).result()
            done: Future[Any] = Future()
            done.set_result(("0" * 64, results))
            return done

    with pytest.raises(rv.GroundTruthError, match=r"give all processes the same file$") as refused:
        rv.evaluate_many(files, split=SPLIT, executor=Elsewhere())
    assert str(refused.value).startswith("a process found a different ground truth in ")


def test_files_without_answers_come_last(tmp_path: Path, demo: rv.GroundTruth) -> None:
    walked = [
        {key: value for key, value in record.items() if key != "predObjId"}
        for record in run_agent("shortest", demo)
    ]
    (tmp_path / "walk.json").write_text(json.dumps(walked))
    paths = [tmp_path / "walk.json", SAMPLES / "mediocre.json"]
    scored = rv.evaluate_many(paths, split=SPLIT)
    assert list(scored.ranks.values()) == [1, None]
    frame = scored.to_pandas()
    assert list(frame.index) == [str(paths[1]), str(paths[0])]
    assert frame.index.name == "file"
    assert list(frame) == [metric.key for metric in scored.metrics]
    assert frame.attrs["units"]["path_length"] == "metres"
    assert frame["success"].iloc[1] == 1.0
    assert frame["rgspl"].isna().tolist() == [False, True]


def test_nothing_to_score() -> None:
    scored = rv.evaluate_many([], split=SPLIT)
    assert (len(scored), dict(scored.ranks), list(scored.metrics)) == (0, {}, [])


# The command line.


def test_the_ranking(run: Run, files: list[str], tmp_path: Path) -> None:
    outcome = run(*files, "--split", SPLIT)
    assert outcome.status == 1
    heading, *rows = outcome.out.split("\n\n")[0].splitlines()
    assert heading.split()[:2] == ["rank", "file"]
    assert [row.split()[:2] for row in rows] == [["1", "good"], ["2", "drawn"], ["3", "mediocre"]]
    rejected, missing = outcome.err.splitlines()
    assert rejected.startswith(f"{files[2]}: submission rejected: ")
    assert rejected.endswith("(`reverie-eval validate` lists 22 more)")
    assert missing == f"{files[4]}: No such file or directory"


@pytest.mark.parametrize("words", [["runs"], ["runs/go*d.json"], ["**/go*d.json"]])
def test_a_folder_or_a_pattern(run: Run, here: Path, words: list[str]) -> None:
    (here / "runs").mkdir()
    shutil.copy(SAMPLES / "good.json", here / "runs")
    for name in ("notes.txt", "good.json.receipt.json"):
        (here / "runs" / name).write_text("not a submission")
    outcome = run(*words, "--split", SPLIT, "--format", "csv")
    assert outcome.status == 0
    heading, row = outcome.out.splitlines()
    assert heading.startswith("file,split,protocol,path_length,")
    assert row.startswith("runs/good.json,val_unseen,official-v1,")
    assert row.endswith(rv.evaluate("runs/good.json", split=SPLIT).signature)


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_reports_of_all_files(jobs: str, run: Run, files: list[str]) -> None:
    words = ("--split", SPLIT, "--format", "json", "--jobs", jobs)
    reports = json.loads(run(*files[:2], *words).out)
    assert list(reports) == [files[1], files[0]]
    assert reports[files[0]]["scores"] == dict(rv.evaluate(files[0], split=SPLIT))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["a.json", "b.json", "--ci"], "--ci cannot be combined with several files; `reverie-eval"),
        (
            ["a.json", "b.json", "--protocol", "all"],
            "--protocol all cannot be combined with several",
        ),
        (["empty"], "empty: no submission found; submissions end in .json, .json.gz, .jsonl"),
        (["*.nothing"], "*.nothing: no submission found"),
        # An empty path is the current folder, which has the two files.
        ([""], "a file's name is empty; is a variable of the shell not set?"),
        (["--watch", "none"], "none: there is no such file or folder to watch"),
        (["--watch", "empty", "--format", "csv"], "--format cannot be combined with --watch"),
    ],
)
def test_what_cannot_be_ranked(run: Run, here: Path, words: list[str], said: str) -> None:
    (here / "empty").mkdir()
    outcome = run("score", *words, "--split", SPLIT)
    assert outcome.status == 2
    assert said in outcome.err


# Watching.


def test_files_are_yielded_when_they_rest(tmp_path: Path) -> None:
    first, second = tmp_path / "a.json", tmp_path / "seed1" / "b.json"
    second.parent.mkdir()
    looks: list[Callable[[], object]] = [
        lambda: first.write_text("half"),
        lambda: first.write_text("half of it"),
        lambda: second.write_text("all"),
        lambda: None,
        lambda: first.write_text("all of it"),
        first.unlink,
        lambda: first.write_text("all of it again"),
        lambda: None,
    ]
    steps = iter(looks)
    yielded: list[tuple[str, str]] = []

    def pause() -> None:
        yielded.append(("look", ""))
        next(steps)()

    with suppress(RuntimeError):  # a generator turns the end of the steps into one
        for path in watch_files([str(tmp_path)], pause):
            yielded += [(Path(path).name, Path(path).read_text())]
    seen = [each for each in yielded if each[0] != "look"]
    assert seen == [("a.json", "half of it"), ("b.json", "all"), ("a.json", "all of it again")]
    assert [number for number, each in enumerate(yielded) if each in seen] == [3, 5, 10]


def test_watching_a_folder_until_it_is_interrupted(tmp_path: Path) -> None:
    shutil.copy(SAMPLES / "good.json", tmp_path)
    words = [str(COMMAND), "--watch", str(tmp_path), "--split", SPLIT]
    with subprocess.Popen(words, stdout=PIPE, stderr=PIPE, text=True) as watching:
        assert watching.stdout
        assert watching.stderr
        heading, good = watching.stdout.readline(), watching.stdout.readline()
        shutil.copy(SAMPLES / "broken.json", tmp_path)
        broken = watching.stderr.readline()
        watching.send_signal(signal.SIGINT)
        out, err = watching.communicate()
    assert heading.split()[-3:] == ["RGSPL", "%", "file"]
    assert good.split()[-2:] == ["57.22", str(tmp_path / "good.json")]
    assert broken.startswith(f"{tmp_path / 'broken.json'}: submission rejected: ")
    assert (out, err, watching.returncode) == ("", "", 0)
