"""The login file: which servers one is signed in to, readable by oneself alone."""

import os
import tempfile
from pathlib import Path
from typing import Self

from platformdirs import user_config_path
from pydantic import BaseModel, ConfigDict, ValidationError

from reverie_eval.errors import ReverieEvalError

SERVER_VARIABLE = "REVERIE_EVAL_SERVER"
"""The environment variable that names the evaluation server to talk to."""
TOKEN_VARIABLE = "REVERIE_EVAL_TOKEN"  # noqa: S105  # the name of a variable, not a token
"""The environment variable that holds the token to show it."""

_OTHERS = 0o077


class LoginError(ReverieEvalError):
    """The login file is damaged, or others can read it."""


class Logins(BaseModel):
    """The content of the login file."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

    latest: str | None = None
    """The server that is meant where none is named."""
    tokens: dict[str, str] = {}
    """By the server's URL."""

    @classmethod
    def load(cls) -> Self:
        """Read the file; where there is none, nobody is signed in.

        Raises
        ------
        LoginError
            If others can read it, or it is damaged.
        """
        path = login_path()
        try:
            content = path.read_bytes()
        except FileNotFoundError:
            return cls()
        if os.name == "posix" and path.stat().st_mode & _OTHERS:
            raise LoginError(f"others can read your tokens; run `chmod 600 {path}`")
        try:
            return cls.model_validate_json(content)
        except ValidationError:
            remedy = "remove it and run `reverie-eval login` again"
            raise LoginError(f"{path} is damaged; {remedy}") from None

    def signed_in(self, server: str, token: str) -> Self:
        """Return the same with one more server, or another token for it."""
        tokens = {**self.tokens, server: token}
        return self.model_copy(update={"latest": server, "tokens": tokens})

    def save(self) -> Path:
        """Write the file, in one step: it is the old one or the new one."""
        path = login_path()
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        number, draft = tempfile.mkstemp(dir=path.parent)  # readable by oneself alone
        try:
            with os.fdopen(number, "w", encoding="utf-8") as file:
                file.write(self.model_dump_json(indent=2) + "\n")
            Path(draft).replace(path)
        except OSError:
            Path(draft).unlink(missing_ok=True)
            raise
        return path


def login_path() -> Path:
    """Return where the file is: ``~/.config/reverie-eval/logins.json`` on Linux."""
    return user_config_path("reverie-eval", appauthor=False) / "logins.json"
