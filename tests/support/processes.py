"""The installed command as processes: a server that listens, and commands beside it."""

import os
import re
import shutil
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from tempfile import mkdtemp
from types import MappingProxyType
from unittest.mock import patch

import httpx
import pytest

from reverie_eval_cli.main import main
from tests.conftest import COMMAND, unavailable
from tests.support.flat_world import Outcome
from tests.support.forking import Forked, Surroundings, command, run_command
from tests.support.serving import NO_TLS
from tests.support.waiting import PATIENCE, wait_until

TOKEN = re.compile(r"rv_[\w-]{43}")

Variables = Mapping[str, str]
NONE: Variables = MappingProxyType({})


@dataclass(frozen=True)
class Server:
    """A server that listens."""

    url: str
    said: str
    """What the server printed before it named its address."""
    log: Path
    process: Forked

    def get(self, path: str, token: str = "") -> httpx.Response:
        """Ask it for something."""
        return httpx.get(
            f"{self.url}/api/v1{path}", headers=_headers(token), timeout=PATIENCE, verify=NO_TLS
        )

    def upload(self, token: str, split: str, content: bytes) -> httpx.Response:
        """Send it a submission."""
        return httpx.post(
            f"{self.url}/api/v1/splits/{split}/submissions",
            params={"name": "Walker"},
            content=content,
            headers=_headers(token),
            timeout=PATIENCE,
            verify=NO_TLS,
        )


@dataclass(frozen=True)
class Laptop:
    """Somebody's folder to work in, whatever the developer's environment names."""

    folder: Path
    is_real: bool = False
    """Whether each command runs in a process of its own."""

    def run(
        self, *words: str | Path, status: int | None = 0, variables: Variables = NONE
    ) -> Outcome:
        """Run a command that ends with this status, or with any."""
        environment = self._environment(variables)
        if self.is_real:
            ended = run_command(*words, folder=self.folder, environment=environment)
        else:
            ended = self._run_here(words, environment)
        assert status in (None, ended.status), ended.out + ended.err
        assert "Traceback" not in ended.err
        return ended

    def shell(self, line: str, variables: Variables = NONE) -> Outcome:
        """Run a line of the shell that succeeds."""
        return self._run(["sh", "-ec", line], 0, variables)

    def like_anybody(self, *words: str) -> Outcome:
        """Run a command that may not write everywhere, even if it is the superuser's."""
        bound: list[str | Path] = []
        if os.geteuid() == 0:
            setpriv = shutil.which("setpriv") or unavailable("there is no setpriv")
            bound = [setpriv, "--bounding-set", "-dac_override,-dac_read_search"]
        return self._run([*bound, COMMAND, *words], None, NONE)

    def _run(
        self, words: Sequence[str | Path], status: int | None, variables: Variables
    ) -> Outcome:
        done = subprocess.run(
            words,
            cwd=self.folder,
            env=self._environment(variables),
            capture_output=True,
            text=True,
            check=False,
        )
        assert status in (None, done.returncode), done.stdout + done.stderr
        assert "Traceback" not in done.stderr
        return Outcome(done.returncode, done.stdout, done.stderr)

    def _run_here(self, words: Sequence[str | Path], environment: Variables) -> Outcome:
        with (
            chdir(self.folder),
            patch.dict(os.environ, environment, clear=True),
            redirect_stdout(StringIO()) as out,
            redirect_stderr(StringIO()) as err,
        ):
            status = main([str(word) for word in words])
        return Outcome(status, out.getvalue(), err.getvalue())

    @contextmanager
    def serving(self, *words: str | Path, variables: Variables = NONE) -> Iterator[Server]:
        """Run a server at any free port until the end, also if it is a bad one."""
        streams = Path(mkdtemp(dir=self.folder))
        printed, log = streams / "printed", streams / "log"
        printed.touch()
        surroundings = Surroundings(self.folder, self._environment(variables), printed, log)
        with Forked(command, surroundings, "serve", *words, "--port", "0") as process:
            try:
                said = _wait_for(r"listening at (\S+), .*\n.*\n.*\n", printed, process)
                yield Server(said[1], said.string, log, process)
            finally:
                process.kill()

    def _environment(self, variables: Variables) -> dict[str, str]:
        kept = {k: v for k, v in os.environ.items() if not k.startswith("REVERIE_EVAL_")}
        return {**kept, "XDG_CONFIG_HOME": str(self.folder / "config"), **variables}


@pytest.fixture
def laptop(tmp_path: Path) -> Laptop:
    """Return an empty folder to work in."""
    return Laptop(tmp_path)


@pytest.fixture
def lab(folder: Path) -> str:
    """Return a server's folder, as a word of a command."""
    return str(folder)


def _wait_for(pattern: str, file: Path, process: Forked) -> re.Match[str]:
    def is_there() -> bool:
        has_ended = process.poll() is not None
        is_found = re.search(pattern, file.read_text()) is not None
        assert is_found or not has_ended, file.read_text()
        return is_found

    wait_until(is_there)
    found = re.search(pattern, file.read_text())
    assert found is not None
    return found


def _headers(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"} if token else {}
