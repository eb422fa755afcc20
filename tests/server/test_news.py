"""News by three doors, and how people find the organiser."""

from pathlib import Path

import pytest

from reverie_eval.schemas.organising import NewNews
from reverie_eval.server.audit.log import entries
from reverie_eval.server.boards.news import add_news, remove_news
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.settings import SettingsError, load_settings
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.tables import News
from tests.support.acting import NOON, acting
from tests.support.flat_world import Run
from tests.support.serving import OPEN, ORGANISER, OpenServer, Serving, settings_of
from tests.support.visiting import said, signed_in

TEXT = "The workshop is <b>on 12 June</b>."
SHOWN = "The workshop is &lt;b&gt;on 12 June&lt;/b&gt;."
CONTACT = "reverie@lab.example.org"
LINK = '<a href="mailto:reverie@lab.example.org">reverie@lab.example.org</a>'


def texts(server: Serving) -> list[str]:
    return [entry["text"] for entry in server.ask(None, "GET", "/news").json()]


def test_news_are_posted_and_removed_by_three_doors(
    server: Serving, folder: Path, run: Run
) -> None:
    desk = signed_in(server, ORGANISER)
    assert run("server", "news", "add", str(folder), "earliest").status == 0
    server.ask(ORGANISER, "POST", "/organiser/news", json={"text": "second"}).raise_for_status()
    assert desk.send("/desk/news", {"text": TEXT}).status_code == 303
    assert texts(server) == [TEXT, "second", "earliest"]
    for page in (f"/splits/{OPEN}", "/desk/news"):
        assert SHOWN in desk.get(page).text
    assert "second" in run("server", "news", "list", str(folder)).out
    assert run("server", "news", "remove", str(folder), "1").status == 0
    assert server.ask(ORGANISER, "DELETE", "/organiser/news/2").status_code == 200
    assert desk.send("/desk/news/3/remove", {}).status_code == 303
    assert texts(server) == []
    assert server.ask(ORGANISER, "DELETE", "/organiser/news/2").status_code == 404
    assert "earliest" not in said(desk.get(f"/splits/{OPEN}"))


def test_posting_and_removing_are_logged(sqlite: Database) -> None:
    with acting(sqlite, "Olga") as transaction:
        posted = add_news(transaction, NewNews(text="soon"))
        assert posted.model_dump() == {
            "id": 1,
            "text": "soon",
            "created_at": NOON,
        }
        assert remove_news(transaction, 1) == posted
        session = transaction.session
        assert session.get_one(News, 1).removed_at == NOON
        for news_id in (1, 2):
            with pytest.raises(NotFoundError) as refused:
                remove_news(transaction, news_id)
            told = f"there is no news entry {news_id}; `news list` shows all"
            assert str(refused.value) == told
        logged = [(each.action, each.row, each.subject, each.details) for each in entries(session)]
    assert logged == [
        ("news added", "news:1", "server", {"text": "soon"}),
        ("news removed", "news:1", "server", {"text": "soon"}),
    ]


def test_a_news_entry_without_text_is_refused(server: Serving, folder: Path, run: Run) -> None:
    assert run("server", "news", "add", str(folder), " ").status == 2
    assert server.ask(ORGANISER, "POST", "/organiser/news", json={"text": ""}).status_code == 400
    refused = signed_in(server, ORGANISER).send("/desk/news", {"text": ""})
    assert refused.status_code == 400
    assert texts(server) == []


def test_contact_and_links_are_where_people_look_for_them(
    folder: Path, open_server: OpenServer, server: Serving
) -> None:
    known = settings_of(folder).model_copy(
        update={"contact": CONTACT, "links": {"Paper": "https://arxiv.org/abs/1904.10151"}}
    )
    served = open_server(known, server.tokens)
    for page in ("/splits/test", "/guide"):
        text = served.client.get(page).text
        assert LINK in text
        assert '<a href="https://arxiv.org/abs/1904.10151">Paper</a>' in text
    assert f"Contact: {LINK}" in served.client.get("/sign-in").text
    refused = signed_in(served, "Ada").get("/desk")
    assert (refused.status_code, f"The organiser: {LINK}" in refused.text) == (403, True)
    report = served.ask(None, "GET", "/server").json()
    assert report["contact"] == CONTACT
    assert report["links"] == {"Paper": "https://arxiv.org/abs/1904.10151"}
    description = served.client.get("/api/v1/openapi.json").json()
    assert description["info"]["contact"] == {"name": "the organiser", "email": CONTACT}


@pytest.mark.parametrize("contact", ["somebody", "http://lab.example.org", "a@b", "a b@c.org"])
def test_a_contact_that_leads_nowhere_is_refused(contact: str, folder: Path) -> None:
    file = folder / "reverie-eval.toml"
    file.write_text(f'contact = "{contact}"\n{file.read_text()}')
    with pytest.raises(SettingsError, match=r"contact: .* must be an e-mail address, or a link"):
        load_settings(folder)
