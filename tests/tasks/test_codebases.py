"""The list of public codebases: what it says must exist, and be found by any usual name."""

import re
from collections import Counter
from datetime import UTC, datetime

import pytest

from reverie_eval import ProtocolError
from reverie_eval.tasks import BUILT_IN, Codebase, codebases, find_codebase, find_task
from tests.support.flat_world import Run


@pytest.mark.parametrize("each", codebases(), ids=lambda each: each.name)
def test_an_entry_is_complete(each: Codebase) -> None:
    assert re.fullmatch(r"[\w.-]+/[\w.-]+", each.repository)
    assert re.fullmatch(r"[0-9a-f]{7}", each.commit)
    assert each.evaluator or each.file
    assert all(form.form for form in each.file)
    tasks = Counter(it.task for it in each.evaluator)
    assert not tasks or max(tasks.values()) == 1
    for it in each.evaluator:
        assert find_task(it.task).protocol(it.protocol)
        assert it.source
    today = datetime.now(UTC).date()
    dates = [*(it.executed for it in each.evaluator), *(it.executed for it in each.file)]
    assert all(it is None or it <= today for it in dates)


def test_a_name_belongs_to_one_codebase() -> None:
    owners = Counter(
        name for each in codebases() for name in {name.casefold() for name in each.names}
    )
    assert {name: count for name, count in owners.items() if count > 1} == {}


def test_every_protocol_that_a_codebase_scores_by_has_one() -> None:
    used = {
        (it.task, find_task(it.task).protocol(it.protocol).name)
        for each in codebases()
        for it in each.evaluator
    }
    released = {(name, rules.name) for name in BUILT_IN for rules in find_task(name).protocols}
    not_of_codebases = {("reverie", it) for it in ("paper", "paper-3m", "r2r-style")}
    further_paths = {("ndh", "official-player")}
    assert released - used == not_of_codebases | further_paths


@pytest.mark.parametrize(
    "name",
    [
        "DUET",
        "duet",
        "VLN-DUET",
        "cshizhe/vln-duet",
        "https://github.com/cshizhe/VLN-DUET",
        "https://github.com/cshizhe/VLN-DUET.git",
        "github.com/cshizhe/VLN-DUET/",
        "git@github.com:cshizhe/VLN-DUET.git",
        "https://github.com/cshizhe/VLN-DUET/tree/main/map_nav_src",
    ],
)
def test_a_codebase_has_many_names(name: str) -> None:
    assert find_codebase(name).name == "DUET"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        pytest.param("HM3D-AutoVLN", "did you mean HM3DAutoVLN? `reverie-eval", id="close"),
        pytest.param("vlnduet", "did you mean DUET? `reverie-eval", id="a repository's name"),
        pytest.param(
            "FAST", "unknown codebase 'FAST'; `reverie-eval protocol` lists", id="another"
        ),
        pytest.param(
            "official-v1",
            "'official-v1' is a protocol itself: score with --task reverie --protocol official-v1 "
            "or --task r2r --protocol official-v1 or",
            id="a protocol's name",
        ),
        pytest.param("zzz", "unknown codebase 'zzz'; `reverie-eval protocol` lists", id="no guess"),
    ],
)
def test_an_unknown_name_suggests_the_closest(name: str, message: str) -> None:
    with pytest.raises(ProtocolError) as refused:
        find_codebase(name)
    assert message in str(refused.value)


def test_the_command_prints_protocols_and_files(run: Run) -> None:
    done = run("protocol", "duet")
    assert (done.status, done.err) == (0, "")
    assert done.out.startswith("DUET: github.com/cshizhe/VLN-DUET at 93e8b23\n")
    assert "\nsoon: --task soon --protocol duet\n" in done.out
    assert "\nfile: submit_{split}_{fusion}.json\n" in done.out
    listed = run("protocol").out
    assert [line.split()[0] for line in listed.splitlines()] == [it.name for it in codebases()]
    unknown = run("protocol", "deut")
    assert (unknown.status, unknown.out) == (2, "")
    assert unknown.err.endswith("did you mean DUET? `reverie-eval protocol` lists all\n")
