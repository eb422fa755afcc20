"""The server's address, where people copy it: never what the Host header of a request says."""

from pathlib import Path

import pytest

from tests.support.serving import OPEN, ORGANISER, OWNER, OpenServer, Serving, settings_of
from tests.support.visiting import signed_in

ADDRESS = "https://eval.example.org"
EVIL = {"Host": "evil.example"}
PRINTING = {
    f"/splits/{OPEN}/bibtex": f"{ADDRESS}/splits/{OPEN}",
    f"/splits/{OPEN}/latex?text=nothing": f"{ADDRESS}/splits/{OPEN}",
    "/guide/submitting": ADDRESS,
    "/guide/api": ADDRESS,
}


@pytest.fixture
def public(folder: Path, open_server: OpenServer) -> Serving:
    """Return a server with a public address, and with something on its board."""
    server = open_server(settings_of(folder).model_copy(update={"public_address": ADDRESS}))
    submission = server.upload(OWNER).json()["submission"]["id"]
    server.ask(OWNER, "PATCH", f"/submissions/{submission}", json={"published": True})
    return server


@pytest.mark.parametrize(("path", "printed"), PRINTING.items(), ids=PRINTING)
def test_what_is_copied_has_the_public_address(path: str, printed: str, public: Serving) -> None:
    text = public.client.get(path, headers=EVIL).text
    assert printed in text
    assert "evil.example" not in text


@pytest.mark.parametrize(
    "path", ["/guide/", "/splits/", "/", "/api/v1/splits/", "/nothing", "/team"]
)
def test_nobody_is_led_to_another_host(path: str, public: Serving) -> None:
    reply = public.client.get(path, headers=EVIL)
    assert "evil.example" not in reply.text + str(reply.headers)


def test_who_gets_an_invitation_is_led_to_the_public_address(public: Serving) -> None:
    desk = signed_in(public, ORGANISER)
    fields = {"person": "1", "kind": "invite"}
    shown = desk.send("/desk/people/tokens", fields, headers=EVIL).text
    assert f"{ADDRESS}/sign-in" in shown
    assert "evil.example" not in shown


def test_without_a_setting_it_is_what_the_server_listens_at(server: Serving) -> None:
    assert "http://server/splits/" in server.client.get(f"/splits/{OPEN}/latex", headers=EVIL).text
