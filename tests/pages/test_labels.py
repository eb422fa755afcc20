"""Problems of forms name the fields as the page labels them."""

import re
from collections.abc import Mapping

import pytest

from reverie_eval.server.http.labels import labels_of
from tests.pages.test_access import ROWS, stock
from tests.support.serving import GOOD, OPEN, ORGANISER, OWNER, PRIVATE, Serving
from tests.support.visiting import Visitor, said, signed_in

CONTROL = re.compile(r'<(?:input|select|textarea)\b[^>]*\bname="([^"]+)"[^>]*>')
BAD = "\u200b"
"""Invisible, so not valid in any text."""

# Where the form is, to where it is sent, what is typed, and what the page says.
WRONG: Mapping[str, tuple[str, dict[str, str], str]] = {
    "a row": (
        "/desk/phases",
        {"split": PRIVATE, "name-0": "a", "name-1": "b", "closes-1": "soon"},
        "Phase 2, closes: must be a time",
    ),
    "a row after an empty one": (
        "/desk/phases",
        {"split": PRIVATE, "name-0": "", "name-1": "b", "closes-1": "soon"},
        "Phase 2, closes: must be a time",
    ),
    "a line": (
        "/join",
        {"team": "Green", "institution": "Here", "people": "Ada, a@example.org\n\nBen, ben"},
        "People, line 3, e-mail: must be an e-mail address",
    ),
    "a list": (
        "/join",
        {"team": "Green", "institution": "Here", "people": ""},
        "People: must have 1 or more entries",
    ),
    "all of them": (
        "/join",
        {"team": "Green", "institution": "Here", "people": "A, a@example.org\nA, b@example.org"},
        "see the list of problems. Each person needs a name of their own",
    ),
    "a name": ("/join", {"team": BAD, "people": "A, a@example.org"}, "Institution: must have"),
    "a day": (
        "/desk/people/tokens",
        {"person": "1", "kind": "invite", "expires_at": "yesterday"},
        "Last day: 'yesterday' is not a day",
    ),
    "no day": (
        "/desk/quotas",
        {"team": "Blue", "split": OPEN, "extra": "1", "reason": "disk"},
        "Last day: required but missing",
    ),
    "a number": (
        "/desk/quotas",
        {"team": "Blue", "split": OPEN, "extra": "x", "expires_at": "2026-04-01", "reason": "r"},
        "Extra submissions: must be a whole number",
    ),
    "an address": (
        "/desk/people",
        {"name": "Dora", "team": "Red", "role": "participant", "email": "dora"},
        "E-mail: must be an e-mail address",
    ),
    "a choice": (
        "/desk/people",
        {"name": "Dora", "team": "Red", "role": "king"},
        "Role: must be 'participant' or 'organiser'",
    ),
    "a team": ("/desk/people/teams", {"name": BAD}, "Name: must be one line"),
    "another form with the same field": (
        "/desk/people/teams/rename",
        {"team": "Red", "name": BAD},
        "New name: must be one line",
    ),
    "one choice of several": (
        "/desk/reviews",
        {"submission_id": "{submission}", "verdict": "fine", "reason": "ran"},
        "Verdict: must be",
    ),
    "part of a method": (
        "/desk/reported",
        {"split": OPEN, "name": "Theirs", "team": "Them", "source": "Them", "paper": "x"},
        "Paper: must be a link",
    ),
    "a disclosure": (
        "/desk/reported",
        {"split": OPEN, "name": "Theirs", "team": "Them", "source": "Them", "human": "x"},
        "Human: must be true or false",
    ),
    "a pasted file": ("/desk/people/import", {"text": ""}, "Or paste it: must have"),
    "news": ("/desk/news", {"text": ""}, "Text: must have"),
    "a notice": ("/desk/notice", {"banner": BAD}, "Banner: must be one line"),
    "a title": ("/desk/snapshots", {"split": OPEN, "title": ""}, "Title: must have"),
    "a person": ("/desk/people/1", {"name": BAD, "team": "Blue"}, "Name: must be one line"),
    "a submission": (
        "/submissions/{submission}",
        {"name": "Walker", "code": "x"},
        "Code: must be a link",
    ),
    "a hidden date": (
        "/submissions/{submission}",
        {"published": "true", "anonymous_until": "soon"},
        "Hide the team until: must be a time",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_problem_names_the_field_as_its_label_does(case: str, copied: Serving) -> None:
    visitor = signed_in(copied, OWNER if case in ("a submission", "a hidden date") else ORGANISER)
    submission = copied.upload(OWNER, GOOD).json()["submission"]["id"]
    path, typed, expected = WRONG[case]
    own = {name: value.format(submission=submission) for name, value in typed.items()}
    reply = visitor.send(path.format(submission=submission), own)
    assert reply.status_code == 400
    assert expected in said(reply)
    assert "data-field" not in reply.text


def test_a_file_that_somebody_sent(server: Serving) -> None:
    typed = {"person": "1", "split": OPEN, "received_at": "noon", "name": "Walker"}
    reply = signed_in(server, ORGANISER).send("/desk/emailed-files", typed, file=GOOD)
    assert "Received: must be a time" in said(reply)


@pytest.mark.parametrize("row", [row for row in ROWS if row.startswith("POST")])
def test_every_field_of_every_form_has_a_label(row: str, copied: Serving) -> None:
    """So a problem with any of them can be named, whatever is added."""
    parts = stock(copied)
    path = row.removeprefix("POST ").format(**parts)
    visitor = signed_in(copied, OWNER if path.startswith("/submissions") else ORGANISER)
    above = (path, path.rpartition("/")[0], path.rpartition("/")[0].rpartition("/")[0])
    pages = (visitor.get(each or "/") for each in (*above, "/desk/people"))
    html = next(page.text for page in pages if page.status_code == 200)
    labels = labels_of(html, path)
    for form in re.findall(r"<form\b.*?</form>", html, re.DOTALL):
        action = re.match(r'<form\b[^>]*\baction="([^"?]*)', form)
        if action is None or action[1] == path:
            controls = [each for each in CONTROL.finditer(form) if "hidden" not in each[0]]
            assert all(labels.get(control[1]) for control in controls), controls


PEOPLE = {
    "with a comma": "Ada Lovelace, ada@example.org",
    "as mail programs write it": "Ada Lovelace <ada@example.org>",
    "quoted": '"Ada Lovelace" <ada@example.org>',
    "with both": "Ada Lovelace, <ada@example.org>",
}


@pytest.mark.parametrize("people", PEOPLE.values(), ids=PEOPLE)
def test_people_are_pasted_as_mail_programs_write_them(people: str, server: Serving) -> None:
    form = {"team": "Green", "institution": "Here", "people": f"{people}\nBen <ben@example.org>"}
    assert Visitor(server).send("/join", form).status_code == 200
    found = server.ask(ORGANISER, "GET", "/organiser/requests").json()
    assert [(each["name"], each["email"]) for each in found[0]["people"]] == [
        ("Ada Lovelace", "ada@example.org"),
        ("Ben", "ben@example.org"),
    ]
