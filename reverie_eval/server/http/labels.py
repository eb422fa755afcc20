"""Naming the fields of a form in messages as its page labels them.

A problem is located by the name of a field: ``phases.1.closes``. Only the page that shows it knows
what the field is called there, so the labels are read from the rendered page.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape, unescape
from html.parser import HTMLParser

from markupsafe import Markup

from reverie_eval.schemas.report import ProblemReport

_MARKED = re.compile(r'<b data-field="([^"]*)"></b>')
"""What stands for the name of a field until the page is rendered."""
_FIELD = re.compile(r"[a-z_]+(\.([0-9]+|[a-z_]+))*")
_IN_ROWS = re.compile(r"(\w+)\.([0-9]+)(?:\.(\w+))?")
_OF_ROW = re.compile(r".*-[0-9]+")
"""The name of a control for a field in one of several rows: ``closes-1``."""
_OPTIONAL = " (optional)"
_EMPTY = frozenset({"br", "hr", "img", "input", "link", "meta"})
"""Elements without an end tag."""
_CONTROLS = frozenset({"input", "select", "textarea"})
_WORDS: Mapping[str, str] = {"email": "e-mail"}


def place_of(problem: ProblemReport) -> Markup:
    """Return where a problem is: the mark of a field, or a place in a file."""
    is_field = problem.code == "wrong-value" and _FIELD.fullmatch(problem.where)
    frame = '<b data-field="{}"></b>' if is_field else "<code>{}</code>"
    return Markup(frame).format(problem.where)  # noqa: S704


def name_fields(html: str, path: str) -> str:
    """Replace the mark of every field by what the page calls it.

    ``path`` is that of the form which was sent.
    """
    if not _MARKED.search(html):
        return html
    labels = labels_of(html, path)
    return _MARKED.sub(lambda found: escape(field_name(unescape(found[1]), labels)), html)


def field_name(where: str, labels: Mapping[str, str]) -> str:
    """Return what the page calls a field, given the labels of its controls.

    Examples
    --------
    >>> field_name("method.name", {"name": "Name"})
    'Name'
    >>> field_name("phases.1.closes", {"closes-1": "Phase 2, closes"})
    'Phase 2, closes'
    >>> field_name("people.0.email", {"people": "People"})
    'People, line 1, e-mail'
    """
    in_rows = _IN_ROWS.fullmatch(where)
    if in_rows:
        rows, number, part = in_rows.groups()
        if f"{part}-{number}" in labels:
            return labels[f"{part}-{number}"]
        line = f"{labels.get(rows, _in_words(rows))}, line {int(number) + 1}"
        return f"{line}, {_in_words(part)}" if part else line
    name = where.rpartition(".")[2]
    return labels.get(name) or _in_words(name).capitalize()


def _in_words(name: str) -> str:
    return _WORDS.get(name, name.replace("_", " "))


def labels_of(html: str, path: str) -> Mapping[str, str]:
    """Return the labels of the forms that are sent to a path, by the names of their controls.

    Examples
    --------
    >>> labels_of('<form action="/x"><label for="a">E-mail</label><input id="a" name="b">', "/x")
    {'b': 'E-mail'}
    """
    reader = _FormReader(path)
    reader.feed(html)
    reader.close()
    named = ((control.name, reader.label(control)) for control in reader.controls)
    return {name: label for name, label in named if label}


@dataclass
class _Element:
    tag: str
    attributes: Mapping[str, str | None]
    text: str = ""
    legend: str = ""


@dataclass
class _Control:
    name: str
    id: str
    is_radio: bool
    groups: Sequence[_Element] = field(repr=False)
    """The groups around it, the innermost first."""


class _FormReader(HTMLParser):
    """Collects the controls of the forms that are sent to a path, and all that may label them."""

    def __init__(self, path: str) -> None:
        super().__init__()
        self.controls: list[_Control] = []
        self._path = path
        self._open: list[_Element] = []
        self._texts: dict[str, str] = {}
        """Labels by the id of their control, and texts by their own id."""

    def label(self, control: _Control) -> str:
        """Return a control's label: that of the group for one choice out of several."""
        own = self._texts.get(control.id, "")
        group = self._group_name(control.groups[0]) if control.groups else ""
        if control.is_radio:
            return group
        return f"{group}, {own[:1].lower()}{own[1:]}" if _OF_ROW.fullmatch(control.name) else own

    def _group_name(self, group: _Element) -> str:
        return self._texts.get(group.attributes.get("aria-labelledby") or "", group.legend)

    def handle_starttag(self, tag: str, attrs: Sequence[tuple[str, str | None]]) -> None:
        """Remember an element that is open, and a control."""
        element = _Element(tag, dict(attrs))
        if tag in _CONTROLS and self._is_here():
            self._add(element)
        if tag not in _EMPTY:
            self._open.append(element)

    def handle_data(self, data: str) -> None:
        """Add text to the elements that it is in, unless it is a hint."""
        if not any(each.attributes.get("class") == "hint" for each in self._open):
            for element in self._open:
                element.text += data

    def handle_endtag(self, tag: str) -> None:
        """Keep the text of an element that ends."""
        if tag in _EMPTY:
            return
        while self._open:
            element = self._open.pop()
            self._keep(element, " ".join(element.text.split()).removesuffix(_OPTIONAL))
            if element.tag == tag:
                return

    def _keep(self, element: _Element, text: str) -> None:
        if element.tag == "legend" and self._open:
            self._open[-1].legend = text
        of = element.attributes.get("for" if element.tag == "label" else "id")
        if of and element.tag not in _CONTROLS:
            self._texts[of] = text

    def _add(self, element: _Element) -> None:
        groups = [
            each
            for each in reversed(self._open)
            if each.tag == "fieldset" or each.attributes.get("role") == "radiogroup"
        ]
        name, kind = element.attributes.get("name"), element.attributes.get("type")
        if name and kind != "hidden":
            id = element.attributes.get("id") or ""  # noqa: A001
            self.controls.append(_Control(name, id, kind == "radio", groups))

    def _is_here(self) -> bool:
        return any(
            each.tag == "form"
            and (each.attributes.get("action") or self._path).partition("?")[0] == self._path
            for each in self._open
        )
