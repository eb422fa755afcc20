"""Files that ship beside the code, styles and templates, and markup for the templates."""

from importlib.resources import files
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from markupsafe import Markup


def text_of(name: str) -> str:
    """Return the text of a file in this folder."""
    return (files(__name__) / name).read_text(encoding="utf-8")


def as_markup(html: str) -> "Markup":
    """Return HTML that is escaped already as markup, which templates do not escape again."""
    from markupsafe import Markup  # comes with Jinja, which maps in a notebook do without

    return Markup(html)  # noqa: S704  # callers escape
