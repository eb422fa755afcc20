"""mutmut, with tests that are collected once: ``python -m tests.support.mutation_testing run``.

mutmut forks a process for each fault. By itself, it lets each of them collect the tests that it
runs, which takes longer than most of them.
"""

# ruff: noqa: SLF001 - pytest offers no other way to collect tests now and to run some later

import json
import os
import resource
import shutil
import sys
from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from importlib import import_module
from pathlib import Path

import pytest
from _pytest.config import _prepareconfig
from _pytest.runner import runtestprotocol
from mutmut.__main__ import cli
from mutmut.runners.harness import PytestRunner
from mutmut.workers import isolation

SECONDS_PER_FAULT = 8
"""Processor time after which a fault that no test has found counts as not found."""
SECONDS_TO_END = 30
"""Processor time after which a fault by which a test is still running has been found."""

IMPORTED = Path("mutants", "imported.txt")
DURATIONS = Path("mutants", "mutmut-stats.json")
NOT_FOUND, FOUND = 0, 1
"""What the status of a process tells mutmut."""


class CollectedTests(PytestRunner):  # type: ignore[misc]  # mutmut is not read
    """What mutmut runs in its server of processes, and in every process forked from it."""

    def run_stats(self, *, tests: Iterable[str]) -> int:
        """Run all tests without a fault, and note what they imported."""
        status = int(super().run_stats(tests=tests))
        IMPORTED.write_text("\n".join(sys.modules))
        return status

    def warm_up(self) -> None:
        """Collect the tests, the fastest first, and import what they import while they run."""
        imported = IMPORTED.read_text().splitlines()
        seconds = json.loads(DURATIONS.read_bytes())["duration_by_test"]
        os.chdir("mutants")
        # Any other traceback would show its source, for which modules with all faults are parsed.
        options = ["--rootdir=.", "--capture=no", "--quiet", "--tb=native"]
        options += self._pytest_add_cli_args
        config = _prepareconfig([*options, *self._pytest_add_cli_args_test_selection])
        config._do_configure()
        self._session = pytest.Session.from_config(config)
        config.hook.pytest_sessionstart(session=self._session)
        config.hook.pytest_collection(session=self._session)
        self._session.items.sort(key=lambda item: seconds.get(item.nodeid, 0.0))
        for name in imported:
            with suppress(ImportError):
                import_module(name)
        self._folders: pytest.TempPathFactory = config._tmp_path_factory  # type: ignore[attr-defined]

    def run_tests(self, *, mutant_name: str | None, tests: Iterable[str]) -> int:
        """Run tests up to the first that fails, in a folder of their own.

        They begin with those that found most of the earlier faults in the same function, and go on
        with the others in the same files. Otherwise, the fastest come first.
        """
        if mutant_name is None:  # before any fault is planted
            return int(super().run_tests(mutant_name=None, tests=tests))
        chosen, run = set(tests), self._folders.getbasetemp()
        function, _, _ = mutant_name.rpartition("__mutmut_")
        finders = run / function
        found = Counter(finders.read_text().splitlines() if finders.exists() else ())
        in_file = Counter(map(file_of, found.elements()))
        items = [item for item in self._session.items if item.nodeid in chosen]
        items.sort(key=lambda item: (-found[item.nodeid], -in_file[file_of(item.nodeid)]))
        own = run / f"{os.getpid()}"
        own.mkdir()
        self._folders._basetemp = own
        os.environ["PYTEST_XDIST_WORKER"] = own.name  # shares what is made once for all processes
        begun = used()
        _, most = resource.getrlimit(resource.RLIMIT_CPU)
        resource.setrlimit(resource.RLIMIT_CPU, (min(int(begun) + SECONDS_TO_END, most), most))
        try:
            for item, following in zip(items, [*items[1:], None], strict=True):
                if used() - begun > SECONDS_PER_FAULT:
                    break
                reports = runtestprotocol(item, log=False, nextitem=following)
                if any(report.failed for report in reports):
                    with finders.open("a") as file:
                        print(item.nodeid, file=file)
                    return FOUND
            return NOT_FOUND
        finally:
            shutil.rmtree(own, ignore_errors=True)


def used() -> float:
    """Return the seconds of processor time that this process and those it waited for have used."""
    return sum(os.times()[:4])


def file_of(test: str) -> str:
    """Return the file of a test."""
    return test.partition("::")[0]


if __name__ == "__main__":
    isolation.PytestRunner = CollectedTests
    cli()
