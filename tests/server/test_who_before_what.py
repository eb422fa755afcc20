"""Whoever may not make a request is told so, whatever is wrong with it."""

import re
from http import HTTPStatus

import pytest

from reverie_eval.server.app import create_app
from tests.pages.test_access import ROWS, SIGN_IN, outcome, sign_in
from tests.support.description import API, Description
from tests.support.page_routes import page_routes
from tests.support.serving import ORGANISER, OTHER, Serving

WRONG = {
    "no JSON": (b"{", "application/json"),
    "another form": (b"[]", "application/json"),
    "nothing": (b"", "application/json"),
    "no form": (b"x", "multipart/form-data; boundary=y"),
}
ANYBODY = ("/tokens", "/join")
"""Where one uses an invitation, or asks for an account."""
PLACE = re.compile(r"{[a-z_]+}")


@pytest.mark.parametrize("wrong", WRONG)
def test_the_api_says_who_before_what(wrong: str, shared: Serving) -> None:
    content, kind = WRONG[wrong]
    shared.client.cookies.clear()  # another test may have signed in
    seen = 0
    for name, _ in Description(shared).operations():
        method, path = name.split()
        is_organiser = path.startswith("/organiser")
        if path in ANYBODY or (method == "GET" and not is_organiser):
            continue
        expected = {None: 401, OTHER: 403} if is_organiser else {None: 401}
        for who, status in expected.items():
            headers = {"Content-Type": kind}
            if who:
                headers["Authorization"] = f"Bearer {shared.tokens[who]}"
            # Neither the path nor the query is valid.
            where = f"{API}{PLACE.sub('x' * 200, path)}?limit=none&cursor=&metric=x"
            reply = shared.client.request(method, where, content=content, headers=headers)
            assert reply.status_code == status, (name, who, reply.text)
            seen += 1
    assert seen > 70


def test_an_organiser_is_told_what_is_wrong(shared: Serving) -> None:
    shared.client.cookies.clear()
    for name, _ in Description(shared).operations():
        method, path = name.split()
        if path.startswith("/organiser") and method in ("POST", "PATCH", "PUT"):
            headers = {"Authorization": f"Bearer {shared.tokens[ORGANISER]}"}
            where = API + PLACE.sub("1", path)
            reply = shared.client.request(method, where, content=b"{", headers=headers)
            assert HTTPStatus.BAD_REQUEST <= reply.status_code < HTTPStatus.INTERNAL_SERVER_ERROR
            assert reply.status_code not in (401, 403), name


@pytest.mark.parametrize("row", [row for row in ROWS if "/desk" in row])
def test_the_desk_says_who_before_what(row: str, shared: Serving) -> None:
    method, path = row.split()
    assert (method, path) in set(page_routes(create_app(shared.state)))
    where = PLACE.sub("not-a-number", path) + f"?done={'x' * 100}&split={'x' * 100}"
    for who, expected in {None: SIGN_IN, OTHER: "403"}.items():
        token = sign_in(shared, who)
        for fields in ({"csrf_token": token}, {"csrf_token": token, "name": "\u200b"}):
            reply = shared.client.request(method, where, data=fields)
            assert outcome(reply) == expected
