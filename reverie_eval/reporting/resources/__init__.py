"""Files that ship beside the code: styles and templates."""

from importlib.resources import files


def text_of(name: str) -> str:
    """Return the text of a file in this folder."""
    return (files(__name__) / name).read_text(encoding="utf-8")
