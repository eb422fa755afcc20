"""The login file: a token for each server the user is signed in to, readable by no one else."""

import os
from pathlib import Path

from platformdirs import user_config_path
from pydantic import BaseModel, ConfigDict, ValidationError
from typing_extensions import Self

from reverie_eval.errors import ReverieEvalError
from reverie_eval.files import is_private, staged_file


class LoginError(ReverieEvalError):
    """The login file is damaged, or others can read it."""


class Logins(BaseModel):
    """The content of the login file."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

    latest: str | None = None
    """The server that the user signed in to last, used if none is given."""
    tokens: dict[str, str] = {}
    """Token by server URL."""

    @classmethod
    def load(cls) -> Self:
        """Read the file; without one, the user is signed in nowhere."""
        path = login_path()
        try:
            content = path.read_bytes()
        except FileNotFoundError:
            return cls()
        if os.name == "posix" and not is_private(path):
            raise LoginError(f"other users can read your tokens; run `chmod 600 {path}`")
        try:
            return cls.model_validate_json(content)
        except ValidationError:
            remedy = "remove it and run `reverie-eval login` again"
            raise LoginError(f"{path} is damaged; {remedy}") from None

    def with_token(self, server: str, token: str) -> Self:
        """Return a copy with a token added or replaced."""
        tokens = {**self.tokens, server: token}
        return self.model_copy(update={"latest": server, "tokens": tokens})

    def save(self) -> Path:
        """Write the file atomically."""
        path = login_path()
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        with staged_file(path, mode=0o600) as file:
            file.write(f"{self.model_dump_json(indent=2)}\n".encode())
        return path


def login_path() -> Path:
    """Return the path of the file: ``~/.config/reverie-eval/logins.json`` on Linux."""
    return user_config_path("reverie-eval", appauthor=False) / "logins.json"
