"""The pages to read: they say what the schemas, the catalogue and the settings say."""

import json
import re
from html import unescape
from pathlib import Path

import html5lib
import pytest
from jsonschema import Draft202012Validator

from reverie_eval import PROTOCOLS
from reverie_eval.reporting.service import METHOD_FLAGS
from reverie_eval.schemas.service import Method, Phase
from reverie_eval.server.boards.query import BoardQuery
from reverie_eval.server.errors import ERRORS
from reverie_eval.server.home.guide_page import in_words
from reverie_eval.server.settings import Limits, Quota
from reverie_eval.submissions import submission_schema
from reverie_eval.tasks import find_task
from tests.support.acting import NOON
from tests.support.serving import PRIVATE, OpenServer, Serving, adjusted, settings_of
from tests.support.visiting import Visitor, said

CHAPTERS = ("", "/submitting", "/metrics", "/protocols", "/rules", "/api", "/privacy")


def words(server: Serving, chapter: str) -> str:
    return said(Visitor(server).get(f"/guide{chapter}"))


@pytest.mark.parametrize("chapter", CHAPTERS)
def test_a_chapter_is_sound_and_leads_to_what_is_there(server: Serving, chapter: str) -> None:
    reply = Visitor(server).get(f"/guide{chapter}")
    assert reply.status_code == 200
    html5lib.HTMLParser(strict=True).parse(reply.text)
    for link in set(re.findall(r'href="(/[^"#]*)', reply.text)) - {"/submit", "/episodes"}:
        assert server.client.get(unescape(link), follow_redirects=True).status_code == 200, link
    here = re.findall(r'href="/guide([^"]*)" aria-current="page"', reply.text)
    assert chapter in here


def test_every_field_of_a_submission_is_told_of(server: Serving) -> None:
    text = words(server, "/submitting")
    prediction = submission_schema()["$defs"]["Prediction"]
    for name, field in prediction["properties"].items():
        assert (f"{name} required" in text) == (name in prediction["required"])
        assert field["description"] in text
    assert "instr_id required Text. The episode:" in text
    assert "predView Whole number, at least 0, below 36. The index" in text
    assert "trajectory required List of 1 or more of [text, number, number]. The agent's" in text


def test_the_example_is_a_submission(server: Serving) -> None:
    page = Visitor(server).get("/guide/submitting").text
    example = unescape(re.findall(r"<pre tabindex=\"0\"><code>(.*?)</code>", page, re.DOTALL)[0])
    Draft202012Validator(submission_schema()).validate(json.loads(example))


IN_WORDS = [
    pytest.param({"type": "string"}, "text", id="text"),
    pytest.param({"type": "boolean"}, "true or false", id="boolean"),
    pytest.param({"type": "number", "exclusiveMinimum": 0}, "number, above 0", id="bounds"),
    pytest.param({"type": "integer", "maximum": 12345}, "whole number, at most 12,345", id="most"),
    pytest.param({"anyOf": [{"type": "number"}, {"type": "null"}]}, "number", id="or null"),
    pytest.param(
        {"anyOf": [{"type": "number"}, {"type": "string"}]}, "number or text", id="either"
    ),
    pytest.param(
        {"type": "array", "minItems": 2, "items": {"type": "integer"}},
        "list of 2 or more of whole number",
        id="list",
    ),
]


@pytest.mark.parametrize(("schema", "expected"), IN_WORDS)
def test_a_schema_in_words(schema: dict[str, object], expected: str) -> None:
    assert in_words(schema) == expected


def test_every_metric_is_told_of_under_its_key(server: Serving) -> None:
    page = Visitor(server).get("/guide/metrics").text
    text = words(server, "/metrics")
    task = find_task("reverie")
    for key in task.metrics:
        assert page.count(f'id="{key}"') == 1
        assert task.metric(key).definition in text


def test_every_protocol_is_told_of_under_its_name(server: Serving) -> None:
    page = Visitor(server).get("/guide/protocols").text
    for name, protocol in PROTOCOLS.items():
        assert page.count(f'id="{name}"') == 1
        assert protocol.source in unescape(page)
    official, paper = page.index('id="official-v1"'), page.index('id="paper"')
    assert official < page.index(f"scores {PRIVATE} here") < paper


def test_the_rules_are_those_of_the_settings(open_server: OpenServer, folder: Path) -> None:
    settings = settings_of(folder)
    phase = Phase(name="<i>Spring</i>", opens=NOON.replace(year=2027))
    quota = Quota(day=3, month=17, year=1234)
    changed = adjusted(settings, quota=quota, phases=(phase,), protocol="duet")
    changed = changed.model_copy(update={"required_metadata": ("code", "extra_data")})
    text = words(open_server(changed), "/rules")
    assert f"{PRIVATE} private duet 91 3 17 1,234" in text
    assert f"{PRIVATE} <i>Spring</i> 2027-03-02 12:00 UTC not set not open yet" in text
    assert "Required: the name, code, extra data." in text


def test_large_numbers_can_be_read(open_server: OpenServer, folder: Path) -> None:
    limits = Limits(requests_per_minute=1_000_000)
    server = open_server(settings_of(folder).model_copy(update={"limits": limits}))
    assert "1,000,000 requests per minute" in words(server, "/api")


def test_equal_values_and_unequal_ranks_are_explained(server: Serving) -> None:
    assert "the same two decimals can have different ranks" in words(server, "/rules")
    assert "by all their digits, of which two decimals are shown" in words(server, "/metrics")


def test_every_flag_of_a_method_is_worded_filtered_and_explained(server: Serving) -> None:
    flags = {name for name, field in Method.model_fields.items() if field.annotation == bool | None}
    assert set(METHOD_FLAGS) == flags
    assert flags < set(BoardQuery.model_fields)
    text = words(server, "/rules")
    assert "What nobody declares is shown as not declared, which is not a no." in text
    assert all(
        f"{METHOD_FLAGS[name]} {Method.model_fields[name].description}" in text for name in flags
    )


def test_every_problem_has_a_place(server: Serving) -> None:
    page = unescape(Visitor(server).get("/guide/api").text)
    for code, error in ERRORS.items():
        assert re.search(rf'id="{code}".*?>{error.status.value}<.*?<td>{error.__doc__}</td>', page)


def test_nothing_secret_is_told(server: Serving) -> None:
    for chapter in CHAPTERS:
        text = Visitor(server).get(f"/guide{chapter}").text
        assert str(server.state.settings.folder) not in text
        assert "sqlite" not in text
