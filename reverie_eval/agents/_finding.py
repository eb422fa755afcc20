"""Agents by name: those of this package, those that others install, and the user's own."""

import ast
import hashlib
import importlib
import importlib.util
import inspect
import sys
import sysconfig
import traceback
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache, partial
from importlib.metadata import entry_points
from pathlib import Path
from types import FunctionType, MappingProxyType, MethodType, ModuleType
from typing import Any

import numpy as np

from reverie_eval.agents._episode import Agent, BatchAgent, Episode
from reverie_eval.agents._untrained import AGENTS, NearestFirstAgent, WordMatchAgent
from reverie_eval.agents.chat import ChatAgent
from reverie_eval.errors import ReverieEvalError
from reverie_eval.simulator import Action, Observation
from reverie_eval.text import did_you_mean, short_digest

AGENT_ENTRY_POINTS = "reverie_eval.agents"
"""The group of entry points by which packages offer agents of their own."""

BUILT_IN_AGENTS: Mapping[str, type[Agent]] = MappingProxyType(
    {
        **AGENTS,
        "nearest-first": NearestFirstAgent,
        "word-match": WordMatchAgent,
        "chat": ChatAgent,
    }
)
"""The agents of this package, by name."""

_DEFAULT_NAME = "Agent"


@dataclass(frozen=True)
class AgentSource:
    """Where to find an agent, and its options: enough to make one in another process.

    Parameters
    ----------
    name : str
        A name in ``BUILT_IN_AGENTS``, an entry point, the folder of a trained model,
        ``module:Name``, ``file.py:Name``, or ``file.py``, whose agent is called ``Agent``. What is
        named is a class with the methods of :class:`Agent` or :class:`BatchAgent`, or a function
        that takes an observation and returns an action.
    options : mapping, optional
        Arguments of the class, or further ones of the function.
    """

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)
    _base: Path = field(default_factory=Path.cwd, init=False, repr=False)
    """The folder that a file is named from: an agent may change the working directory."""

    def make(self) -> Agent | BatchAgent:
        """Return a new agent.

        Raises
        ------
        ReverieEvalError
            If there is no such agent, it is neither a class nor a function of this kind, or it
            does not have such options.
        """
        found = self._find()
        _check_options(self.name, found, self.options)
        if not isinstance(found, type):
            return _Function(partial(found, **self.options))
        with _naming(f"{self.name} cannot be made", self._module_file.parent):
            made: Any = found(**self.options)
        is_batch = callable(getattr(made, "act_batch", None))
        is_whole = is_batch or callable(getattr(made, "act", None))
        if not (is_whole and callable(getattr(made, "start", None))):
            raise ReverieEvalError(
                f"{self.name} is not an agent; its class needs start(episode) and "
                "act(observation), or act_batch(episodes, observations)"
            )
        size = getattr(made, "batch_size", None)
        if is_batch and not (isinstance(size, int | np.integer) and size >= 1):
            raise ReverieEvalError(
                f"{self.name} has act_batch, and needs a batch_size: how many episodes it takes "
                f"at a time, a whole number from 1, not {size!r}"
            )
        agent: Agent | BatchAgent = made
        return agent

    @property
    def title(self) -> str:
        """The name without the folder of a file or of a model."""
        if self._path.is_dir():
            return self._path.resolve().name
        file, mark, name = self.name.rpartition(".py")
        return f"{Path(file).name}{mark}{name}"

    @property
    def version(self) -> str:
        """The ``version`` of the class, or of the function; empty if it has none.

        Raises ReverieEvalError as :meth:`make` does, but makes no agent.
        """
        found = self._find()
        _check_options(self.name, found, self.options)
        return str(getattr(found, "version", ""))

    @property
    def identity(self) -> Mapping[str, Any]:
        """What of the options can change an answer: all, or what the class's ``identity`` says.

        Raises ReverieEvalError as :meth:`make` does.
        """
        identity = getattr(self._find(), "identity", None)
        return identity(**self.options) if callable(identity) else self.options

    @property
    def digest(self) -> str:
        """A digest of the file that defines the agent, and of those beside it that it imports."""
        content, file = hashlib.sha256(), self._module_file
        if file.is_file():
            module_name = self._find().__module__
            root = file.parents[module_name.count(".") + (file.stem == "__init__")]
            for each in _own_files(file, root):
                content.update(each.relative_to(file.parent).as_posix().encode())
                content.update(each.read_bytes())
        return short_digest(content.hexdigest())

    def describe(self, error: BaseException) -> str:
        """Say what went wrong, and where in the agent's own files: which one at least."""
        told = _named(error)
        if self.name in BUILT_IN_AGENTS and isinstance(error, ReverieEvalError):
            return told  # nobody has to look into our files
        return f"{told} ({_location(error, self._module_file.parent) or self._module_file.name})"

    @property
    def _module_file(self) -> Path:
        """The file that defines the agent; one that does not exist if it was typed somewhere."""
        module = sys.modules.get(self._find().__module__)
        return self._base.joinpath(getattr(module, "__file__", None) or self.title).resolve()

    @property
    def _path(self) -> Path:
        return self._base / self.name

    @property
    def needs_solution(self) -> bool:
        """Whether the agent says, by its ``needs_solution``, that public bundles do not suffice."""
        return bool(getattr(self._find(), "needs_solution", False))

    def _find(self) -> Callable[..., Any]:
        if self.name in BUILT_IN_AGENTS:
            return BUILT_IN_AGENTS[self.name]
        if self._path.is_dir():
            from reverie_eval.agents.trained import find_trained  # torch takes seconds to import

            return find_trained(self._path)
        found: Any
        module_name, _, name = self.name.rpartition(":")
        if self.name.endswith(".py"):
            module_name, name = self.name, _DEFAULT_NAME
        if module_name:
            found = getattr(_import(module_name, self._base), name, None)
        else:
            offered = entry_points(group=AGENT_ENTRY_POINTS, name=self.name)
            found = next((each.load() for each in offered), None)
        # Of other things that can be called, nothing says in which file they are.
        if not isinstance(found, (type, FunctionType, MethodType)):
            raise ReverieEvalError(self._unknown(module_name, name))
        is_found: Callable[..., Any] = found
        return is_found

    def _unknown(self, module_name: str, name: str) -> str:
        if module_name:
            return f"{module_name} has no class or function {name!r}"
        return (
            f"there is no agent {self.name!r}{did_you_mean(self.name, BUILT_IN_AGENTS)}, "
            "a file.py, or module:Class"
        )


class _Function:
    """An agent that is a function, which remembers nothing."""

    def __init__(self, act: Callable[[Observation], Action]) -> None:
        self.act = act

    def start(self, episode: Episode) -> None:
        """Do nothing."""


def _check_options(name: str, found: Callable[..., Any], options: Mapping[str, Any]) -> None:
    given = [] if isinstance(found, type) else [None]  # a function is given the observation, too
    try:
        signature = inspect.signature(found)
    except ValueError:  # some classes written in C have none
        return
    try:
        signature.bind_partial(*given)
    except TypeError:
        message = f"{name} is not an agent; its function needs a parameter for the observation"
        raise ReverieEvalError(message) from None
    own = list(signature.parameters.values())[len(given) :]
    names = ", ".join(each.name for each in own) or "none"
    takes_any = {inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD}
    missing = [
        each.name
        for each in own
        if each.default is each.empty and each.kind not in takes_any and each.name not in options
    ]
    if missing:
        raise ReverieEvalError(f"{name} needs {', '.join(missing)}; its options: {names}")
    takes_others = any(each.kind is each.VAR_KEYWORD for each in own)
    unknown = sorted(options.keys() - {each.name for each in own})
    if unknown and not takes_others:
        told = f"{name} has no option {', '.join(unknown)}"
        raise ReverieEvalError(f"{told}; its options: {names}")
    try:
        signature.bind(*given, **options)
    except TypeError as error:
        raise ReverieEvalError(f"{name}: {error}; its options: {names}") from None


def _import(name: str, base: Path) -> ModuleType:
    """Import a module by its name or from its file; both may import what lies beside them."""
    is_file = name.endswith(".py")
    file = (base / name).resolve()
    if is_file and not file.is_file():
        raise ReverieEvalError(f"there is no file {name}")
    folder = file.parent if is_file else base
    if str(folder) not in sys.path:
        # After Python's own modules, for which an agent's json.py must not be taken.
        own = {sysconfig.get_path("stdlib"), sysconfig.get_config_var("DESTSHARED")}
        positions = [number for number, each in enumerate(sys.path, 1) if each in own]
        sys.path.insert(max(positions, default=0), str(folder))
    with _naming(f"{name} cannot be imported", folder):
        return _import_file(file) if is_file else importlib.import_module(name)


def _import_file(file: Path) -> ModuleType:
    name = f"{file.stem}_{short_digest(hashlib.sha256(str(file).encode()).hexdigest())}"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, file)
        module = importlib.util.module_from_spec(spec)  # type: ignore[arg-type]
        sys.modules[name] = module  # dataclasses look for the module of a class there
        try:
            spec.loader.exec_module(module)  # type: ignore[union-attr]
        except BaseException:
            del sys.modules[name]
            raise
    return sys.modules[name]


def _own_files(file: Path, root: Path) -> Collection[Path]:
    """Return a file and those of its folder that it imports, directly or not, in order.

    The files are read, not run: what was imported depends on what else a process did.
    """
    found, folder, queue = set[Path](), file.parent, [file]
    while queue:
        each = queue.pop()
        if each not in found and each.suffix == ".py" and each.is_relative_to(folder):
            found.add(each)
            queue += _imported(each, (folder, root))
    return sorted(found)


def _imported(file: Path, roots: Collection[Path]) -> Iterator[Path]:
    """Yield the files that a file's imports may mean, if they are there."""
    for node in _imports_in(file.read_bytes()):
        if isinstance(node, ast.Import):
            bases, names = roots, [each.name for each in node.names]
        else:
            bases = [file.parents[node.level - 1]] if node.level else roots
            names = [node.module or ".", *(f"{node.module or ''}.{it.name}" for it in node.names)]
        for base in bases:
            for name in names:
                path = base.joinpath(*name.split("."))
                yield from filter(Path.is_file, (path.with_suffix(".py"), path / "__init__.py"))


@lru_cache
def _imports_in(source: bytes) -> Sequence[ast.Import | ast.ImportFrom]:
    try:
        nodes = ast.walk(ast.parse(source))
    except SyntaxError:  # nothing can import it
        return ()
    return [node for node in nodes if isinstance(node, ast.Import | ast.ImportFrom)]


def _location(error: BaseException, folder: Path) -> str:
    """Return the last line in the files of a folder that an error came through; or nothing."""
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        file = Path(frame.filename).resolve()
        is_own = file.is_relative_to(folder) and file.is_file()  # `<string>` is none
        # An environment of packages may be in the folder, too.
        if is_own and "site-packages" not in file.relative_to(folder).parts:
            return f"{file.name}, line {frame.lineno}"
    return ""


@contextmanager
def _naming(what: str, folder: Path) -> Iterator[None]:
    """Say what failed in somebody else's code, and where."""
    try:
        yield
    except (Exception, SystemExit) as error:
        location = _location(error, folder)
        shown = f"{what}: {_named(error)}{location and f' ({location})'}"
        raise ReverieEvalError(shown) from error


def _named(error: BaseException) -> str:
    told = str(error)
    return f"{type(error).__name__}: {told}" if told else type(error).__name__
