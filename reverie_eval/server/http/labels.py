"""Naming the fields of a form in messages as its page labels them.

A problem is located by the name of a field: ``phases.1.closes``. Only the page that shows it knows
what the field is called there, so the labels are read from the rendered page.
"""

import re
from collections.abc import Mapping
from html import escape, unescape

from markupsafe import Markup

from reverie_eval.schemas.report import ProblemReport

_MARKED = re.compile(r'<b data-field="([^"]*)"></b>')
"""What stands for the name of a field until the page is rendered."""
_FIELD = re.compile(r"[a-z_]+(\.([0-9]+|[a-z_]+))*")
_IN_ROWS = re.compile(r"(\w+)\.([0-9]+)(?:\.(\w+))?")
_OF_ROW = re.compile(r".*-[0-9]+")
"""The name of a control for a field in one of several rows: ``closes-1``."""
_OPTIONAL = " (optional)"
# The pages are our own, so what labels their fields is always written in these ways.
_PART = re.compile(
    r"<form\b(?P<form>[^>]*)>"
    r"|<legend\b[^>]*>(?P<legend>.*?)</legend>"
    r'|<label for="(?P<id>[^"]*)"[^>]*>(?P<label>.*?)</label>'
    r"|<(?:input|select|textarea)\b(?P<control>[^>]*)>",
    re.DOTALL,
)
_ATTRIBUTE = re.compile(r'([\w-]+)="([^"]*)"')
_HINT = re.compile(r'<span class="hint".*?</span>', re.DOTALL)
_TAG = re.compile(r"<[^>]*>")
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
    >>> field_name("phases.1", {"closes-1": "Phase 2, closes"})
    'Phase 2'
    >>> field_name("people.0.email", {"people": "People"})
    'People, line 1, e-mail'
    """
    in_rows = _IN_ROWS.fullmatch(where)
    if in_rows:
        rows, number, part = in_rows.groups()
        if f"{part}-{number}" in labels:
            return labels[f"{part}-{number}"]
        if not part:
            for control, label in labels.items():
                if control.endswith(f"-{number}"):
                    return label.partition(",")[0]  # the legend of the row's controls
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
    texts: dict[str, str] = {}
    controls: list[tuple[Mapping[str, str], str]] = []
    legend, is_sent_there = "", False
    for part in _PART.finditer(html):
        match part.lastgroup:
            case "form":
                action = dict(_ATTRIBUTE.findall(part["form"])).get("action", path)
                is_sent_there = action.partition("?")[0] == path
            case "legend":
                legend = _text(part["legend"])
            case "label":
                texts[part["id"]] = _text(part["label"])
            case "control" if is_sent_there:
                controls.append((dict(_ATTRIBUTE.findall(part["control"])), legend))
    named = (
        (control.get("name", ""), _label(control, texts.get(control.get("id", ""), ""), group))
        for control, group in controls
        if control.get("type") != "hidden"
    )
    return {name: label for name, label in named if name and label}


def _label(control: Mapping[str, str], own: str, group: str) -> str:
    """Return a control's label: that of its group for one choice out of several, or before it."""
    if control.get("type") == "radio":
        return group
    is_in_row = _OF_ROW.fullmatch(control.get("name", ""))
    return f"{group}, {own[:1].lower()}{own[1:]}" if is_in_row else own


def _text(html: str) -> str:
    """Return the text of a label or a legend, without its hint."""
    return " ".join(unescape(_TAG.sub("", _HINT.sub("", html))).split()).removesuffix(_OPTIONAL)
