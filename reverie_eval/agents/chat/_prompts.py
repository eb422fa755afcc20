"""The texts that a model is sent: files, which a user can replace."""

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path
from string import Template

from reverie_eval.errors import ReverieEvalError
from reverie_eval.text import did_you_mean

DEFAULT_PROMPTS = Path(__file__).parent / "prompts"
"""The folder of our own."""

_SYSTEM = frozenset({"instruction", "moves"})
# The names of the files, without ``.txt``, and the placeholders of each. The first four begin an
# episode: the answer is an object, a box, the place alone, or the end of a route.
_PLACEHOLDERS: Mapping[str, frozenset[str]] = {
    "object": _SYSTEM,
    "box": _SYSTEM,
    "place": _SYSTEM,
    "route": _SYSTEM,
    "step": frozenset({"map", "place", "neighbours", "visible", "moves_left"}),
    "repair": frozenset({"problem"}),
}
_SHOWN = 12


class Prompts:
    """The texts of a folder, each with placeholders such as ``$instruction``.

    Parameters
    ----------
    folder : Path, optional
        Texts that it does not have are ours.

    Raises
    ------
    ReverieEvalError
        If the folder cannot be read, has a text of another name, or a placeholder of another name.
    """

    def __init__(self, folder: Path | None = None) -> None:
        own = [] if folder is None else _texts_in(folder)
        files = {path.stem: path for path in (*DEFAULT_PROMPTS.glob("*.txt"), *own)}
        self._texts = {name: _read(path) for name, path in sorted(files.items())}

    @property
    def digest(self) -> str:
        """A digest of all texts."""
        return hashlib.sha256(repr(self._texts).encode()).hexdigest()[:_SHOWN]

    def fill(self, name: str, **values: object) -> str:
        """Return a text with its placeholders filled; lines that are left empty are joined."""
        text = Template(self._texts[name]).substitute(values)
        return re.sub(r"\n{3,}", "\n\n", text).strip()


def _texts_in(folder: Path) -> list[Path]:
    files = sorted(folder.glob("*.txt"))
    if not files:
        raise ReverieEvalError(f"{folder}: there is no folder with prompts, such as object.txt")
    for file in files:
        if file.stem not in _PLACEHOLDERS:
            raise ReverieEvalError(
                f"{file} is not a prompt{did_you_mean(file.stem, _PLACEHOLDERS)}"
            )
    return files


def _read(file: Path) -> str:
    """Return the text of a file whose placeholders are known."""
    known = _PLACEHOLDERS[file.stem]
    try:
        text = file.read_text("utf-8")
        Template(text).substitute(dict.fromkeys(known, ""))
    except UnicodeDecodeError as error:
        raise ReverieEvalError(f"{file}: {error}") from None
    except KeyError as error:
        listed = ", ".join(f"${name}" for name in sorted(known)) or "none"
        raise ReverieEvalError(
            f"{file}: unknown placeholder ${error.args[0]}; there are: {listed}"
        ) from None
    except ValueError:
        raise ReverieEvalError(f"{file}: a $ that is not of a placeholder is written $$") from None
    return text
