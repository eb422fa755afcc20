"""A language model as an agent, at a real endpoint that misbehaves in every way it can."""

import io
import json
import re
from base64 import b64decode
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import msgspec
import numpy as np
import pytest
from PIL import Image

from reverie_eval import GroundTruth, ReverieEvalError
from reverie_eval.agents import AgentSource
from reverie_eval.client import sending
from reverie_eval.ground_truth import DEMO_BUNDLES
from reverie_eval.runner import RunCard, RunError, RunPlan, Totals, read_attempts, read_steps, run
from reverie_eval.simulator import Environment
from tests.support.endpoints import USAGE, Behaviour, Endpoint, endpoint, failing, saying
from tests.support.runs import EPISODES, WORLD, forget_end, some
from tests.support.skyboxes import write_skybox
from tests.support.waiting import PATIENCE
from tests.support.worlds import ground_truth_of

KEY = "sk-0123456789"
GO, ANSWER = (
    json.dumps({"action": "go", "place": 2}),
    json.dumps({"action": "answer", "object": 5}),
)
STOP = '{"thought": "", "action": "stop"}'
LOST = '{"thought": "", "action": "go", "place": 9}'
HALF = '{"thought": "%s", "action": "go", "place": 2}'
LONG_AGO = "Wed, 21 Oct 2015 07:28:00 GMT"
HARMFUL = failing(400, "flagged", "content_filter")
LONG = failing(400, "This model's maximum context length is 4096 tokens", "context_length_exceeded")
TOO_LONG = {
    "vLLM": "The decoder prompt (length 9) is longer than the maximum model length of 8.",
    "SGLang": "The input (9 tokens) is longer than the model's context length (8 tokens).",
    "llama.cpp": "request (9 tokens) exceeds the available context size (8 tokens)",
    "Anthropic": "prompt is too long: 9 tokens > 8 maximum",
    "Gemini": "The input token count (9) exceeds the maximum number of tokens allowed (8).",
}


class Chat:
    """Runs of a language model in the small house, and how long it waited."""

    def __init__(self, folder: Path, served: Endpoint, waits: list[float]) -> None:
        self.folder = folder / "run"
        self.served = served
        self.waits = waits
        self.truth = ground_truth_of(WORLD)

    def options(self, **changes: Any) -> Mapping[str, Any]:
        """Return the options of the agent."""
        mine = {"model": "words", "endpoint": self.served.url, "key_from": "MY_KEY"}
        return {**mine, "observe": "objects", "cache": str(self.folder), **changes}

    def run(self, episodes: int = 1, **changes: Any) -> Totals:
        """Run some episodes."""
        truth = self.truth.subset(EPISODES[:episodes])
        return run(RunPlan(AgentSource("chat", self.options(**changes)), truth), self.folder)

    def run_one_as_usual(self, **changes: Any) -> None:
        """Run an episode that ends as if the endpoint always behaved well."""
        totals = self.run(**changes)
        (record,) = json.loads((self.folder / "submission.json").read_text())
        assert [pose[0] for pose in record["trajectory"]] == ["hall", "north"]
        assert (record["predObjId"], totals.ended, totals.attempts) == (5, 1, 1)

    @property
    def notes(self) -> list[Mapping[str, Any]]:
        """The notes of all steps."""
        return [step.notes for step in read_steps(self.folder)]


@pytest.fixture(scope="module")
def served() -> Iterator[Endpoint]:
    with endpoint(KEY) as serving:
        yield serving


@pytest.fixture
def chat(served: Endpoint, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Chat:
    waits: list[float] = []
    monkeypatch.setattr(sending, "sleep", waits.append)
    monkeypatch.setattr("reverie_eval.runner._run.WAITS", ())
    monkeypatch.setenv("MY_KEY", KEY)
    served.requests.clear()
    served.script.clear()
    return Chat(tmp_path, served, waits)


@pytest.mark.parametrize(
    ("script", "waits", "requests"),
    [
        pytest.param([], [], 2, id="good"),
        pytest.param([failing(429)], [1], 3, id="busy"),
        pytest.param([failing(429, Retry_After="7")], [7], 3, id="busy, and says when to ask"),
        pytest.param([failing(429, Retry_After="7.5")], [7.5], 3, id="busy for part of a second"),
        pytest.param([failing(429, Retry_After=LONG_AGO)], [0], 3, id="busy until a date"),
        pytest.param([failing(429, Retry_After="soon")], [1], 3, id="busy for no known time"),
        pytest.param([failing(500), failing(503), failing(529)], [1, 2, 4], 5, id="broken"),
        pytest.param([replace(saying(STOP), is_cut=True)], [1], 3, id="cut connection"),
        pytest.param([Behaviour("<html>wait</html>")], [1], 3, id="a page of a proxy"),
        pytest.param([Behaviour({"error": {"message": "no"}})], [1], 3, id="error after all"),
        pytest.param([Behaviour("[" * 10**5)], [1], 3, id="a deep list"),
        pytest.param([Behaviour({"choices": []})], [1], 3, id="no choice"),
        pytest.param([saying("", "error")], [1], 3, id="error in the choice"),
        pytest.param([saying("")], [1], 3, id="empty"),
        pytest.param([saying(None)], [1], 3, id="null"),
        pytest.param([saying("I go to place 2.")], [], 3, id="no JSON, repaired"),
        pytest.param([saying('{"action": "go", "place"')], [], 3, id="broken JSON, repaired"),
        pytest.param([saying(LOST)], [], 3, id="wrong action, repaired"),
        pytest.param([saying("{", "length")], [], 3, id="cut reply, repaired"),
        pytest.param([saying("{" * 10**6, "length")], [], 3, id="the same letter for ever"),
        pytest.param([saying(f"<think>Or {STOP}?", "length")], [], 3, id="cut thought, repaired"),
        pytest.param([saying(f"Or {STOP}?</think> I stay.")], [], 3, id="a thought alone"),
        pytest.param(
            [saying(LOST.replace("9", f'"{"9" * 5000}"'))], [], 3, id="digits for ever, repaired"
        ),
        pytest.param([saying(HALF % r"\ud83d")], [], 2, id="half of a character in its JSON"),
        pytest.param([saying(HALF % "\ud83d")], [], 2, id="half of a character"),
        pytest.param(
            [replace(failing(400), unless="response_format")], [], 3, id="no response_format"
        ),
        pytest.param(
            [saying(f'<think>{{"a": 1}}</think> {LOST}'.replace("9", "2"))], [], 2, id="thinks"
        ),
        pytest.param([saying('```json\n{"action": "go", "place": "2"}\n```')], [], 2, id="fenced"),
    ],
)
def test_what_passes_ends_in_the_same_submission(
    script: list[Behaviour], waits: list[float], requests: int, chat: Chat
) -> None:
    chat.served.script.extend(script)
    chat.run_one_as_usual()
    assert (chat.waits, len(chat.served.requests)) == (waits, requests)


def test_a_reply_that_does_not_come_is_asked_for_again(
    chat: Chat, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a short wait, which no other reply on a slow machine needs to keep to."""
    timeout = httpx.Timeout(PATIENCE, read=0.2)

    def sleep(seconds: float) -> None:
        chat.waits.append(seconds)
        timeout.read = PATIENCE

    monkeypatch.setattr(httpx, "Timeout", lambda *_, **__: timeout)
    monkeypatch.setattr(sending, "sleep", sleep)
    chat.served.script.append(replace(saying(STOP), is_slow=True))
    chat.run_one_as_usual()
    assert (chat.waits, len(chat.served.requests)) == ([1], 3)


@pytest.mark.parametrize(
    ("script", "reason"),
    [
        pytest.param(
            [saying(None, message={"refusal": "I cannot."})],
            "RefusalError: I cannot.",
            id="refused",
        ),
        pytest.param([saying("", "content_filter")], "RefusalError: content_filter", id="filtered"),
        pytest.param([HARMFUL] * 2, "RefusalError: flagged", id="filtered before"),
        pytest.param([LONG] * 2, "LongPromptError: This model's maximum", id="too long"),
        *(
            pytest.param(
                [failing(400, said)] * 2, f"LongPromptError: {said}", id=f"{name}: too long"
            )
            for name, said in TOO_LONG.items()
        ),
        pytest.param(
            [saying(LOST)] * 2,
            'WrongActionError: no action after a second try: "place" is 9, and can be: 2',
            id="wrong action twice",
        ),
        pytest.param(
            [saying("Hm."), saying('{"action": "answer", "object": 1}')],
            'WrongActionError: no action after a second try: "object" is 1, and can be: 8',
            id="wrong in two ways",
        ),
        pytest.param(
            [saying("{", "length")] * 2, "CutReplyError: no action after a second", id="cut twice"
        ),
    ],
)
def test_what_the_model_does_wrong_ends_the_episode_where_it_is(
    script: list[Behaviour], reason: str, chat: Chat
) -> None:
    chat.served.script.extend(script)
    totals = chat.run()
    (attempt,) = read_attempts(chat.folder)
    assert (attempt.state, totals.cut_off, chat.waits) == ("cut_off", 1, [])
    assert attempt.reason.startswith(reason)
    (record,) = json.loads((chat.folder / "submission.json").read_text())
    assert record["predObjId"] == -1


@pytest.mark.parametrize(
    ("script", "message", "requests"),
    [
        pytest.param([failing(403, "not you")], "403 Forbidden: not you", 1, id="forbidden"),
        pytest.param(
            [failing(404, "no model words")] * 2, "404 Not Found: no model words", 2, id="no model"
        ),
        pytest.param([failing(400, "bad")] * 2, "400 Bad Request: bad", 2, id="bad request"),
        pytest.param(
            [failing(429, "pay first", "insufficient_quota")], "pay first", 1, id="no money"
        ),
        pytest.param(
            [failing(429, "tomorrow", Retry_After="3600")], "tomorrow", 1, id="a long wait"
        ),
        pytest.param([Behaviour("", 302, {"Location": "/"})], "it answered 302", 1, id="redirect"),
        pytest.param(
            [Behaviour("data: [DONE]", headers={"Content-Type": "text/event-stream"})],
            "it sent an event stream; expected one JSON object",
            1,
            id="a stream",
        ),
        pytest.param(
            [Behaviour(b'{"model": "\xe9"}', headers={"Content-Type": "application/json"})],
            "it sent JSON that is not in UTF-8",
            1,
            id="Latin-1",
        ),
        pytest.param(
            [saying(GO), saying(STOP, model="words-2")],
            "the model that replies is 'words-2' now, and was 'words-1'",
            2,
            id="another model",
        ),
        pytest.param([failing(503)] * 6, "1 episode of 1 failed", 6, id="busy for ever"),
        pytest.param([saying("")] * 6, "1 episode of 1 failed", 6, id="empty for ever"),
    ],
)
def test_everything_else_is_never_an_answer(
    script: list[Behaviour], message: str, requests: int, chat: Chat
) -> None:
    chat.served.script.extend(script)
    with pytest.raises(RunError) as caught:
        chat.run()
    assert message in str(caught.value)
    assert len(chat.served.requests) == requests
    assert not (chat.folder / "submission.json").exists()
    assert chat.run().ended == 1  # the same command goes on


# What is paid.


PRICES = """
date = 2026-11-26
[words]
input = 2.5
cached = 0.5
output = 10
[free]
input = 0
cached = 0
output = 0
"""
COST = (40 * 2.5 + 60 * 0.5 + 20 * 10) / 1e6
"""US dollars for a reply; 40 of the 100 tokens sent are not cached."""
FREE = {"prices": "prices.toml", "model": "free"}


@pytest.fixture
def prices(tmp_path: Path) -> str:
    (tmp_path / "prices.toml").write_text(PRICES)
    return str(tmp_path / "prices.toml")


@pytest.mark.parametrize(
    ("given", "usage", "expected"),
    [
        pytest.param({"prices": "prices.toml"}, USAGE, (200, 120, 40, 10, 2 * COST), id="priced"),
        pytest.param({}, USAGE, (200, 120, 40, 10, None), id="no prices"),
        pytest.param({**FREE}, USAGE, (200, 120, 40, 10, 0), id="free"),
        pytest.param({**FREE}, None, (None, None, None, None, 0), id="free, no usage"),
        pytest.param({}, None, (None,) * 5, id="no usage"),
        pytest.param(
            {"prices": "prices.toml"},
            {"prompt_tokens": 100, "completion_tokens": 20},
            (200, None, 40, None, 2 * (100 * 2.5 + 20 * 10) / 1e6),
            id="nothing cached",
        ),
    ],
)
@pytest.mark.usefixtures("prices")
def test_tokens_and_money_are_added_up(
    given: Mapping[str, Any], usage: Any, expected: Any, chat: Chat, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(chat.folder.parent)
    chat.served.script += [saying(GO, usage=usage), saying(ANSWER, usage=usage)]
    totals = chat.run(**given)
    sent = (totals.input_tokens, totals.cached_tokens)
    received = (totals.output_tokens, totals.reasoning_tokens)
    assert (*sent, *received, totals.money) == (*expected[:-1], pytest.approx(expected[-1]))
    assert {note.get("prices_of") for note in chat.notes} == {"2026-11-26" if given else None}


def test_what_was_paid_for_an_empty_reply_counts(chat: Chat, prices: str) -> None:
    chat.served.script.append(saying(""))
    assert chat.run(prices=prices).money == pytest.approx(3 * COST)


def test_a_limit_of_the_cost_ends_the_run_which_goes_on_with_a_higher_one(
    chat: Chat, prices: str
) -> None:
    with pytest.raises(RunError, match=r"the limit of \$\d.* is reached; the same command"):
        chat.run(4, prices=prices, max_cost=2.5 * COST)
    assert len(chat.served.requests) == 3  # the third was asked for below the limit
    totals = chat.run(4, prices=prices, max_cost=1.0)
    assert (totals.ended, len(chat.served.requests)) == (4, 8)
    assert totals.money == pytest.approx(8 * COST)


def test_a_cost_that_is_unknown_is_not_below_a_limit(chat: Chat, prices: str) -> None:
    chat.served.script.append(saying(GO, usage=None))
    with pytest.raises(RunError, match="does not say how many tokens it used"):
        chat.run(prices=prices, max_cost=1.0)
    with pytest.raises(RunError, match="the cost of earlier replies is unknown"):
        chat.run(prices=prices, max_cost=1.0)
    assert chat.run().money is None


def test_no_reply_is_paid_twice(chat: Chat) -> None:
    """Not in a new folder either, unless another seed asks for other replies."""
    cache = str(chat.folder.with_name("cache"))
    first, chat.folder = chat.folder, chat.folder.with_name("again")
    assert chat.run(4, cache=cache).input_tokens == 800
    again, chat.folder = chat.folder, first
    totals = chat.run(4, cache=cache)
    assert (totals.input_tokens, len(chat.served.requests)) == (None, 8)
    names = {each / "submission.json" for each in (first, again)}
    assert len({name.read_bytes() for name in names}) == 1
    chat.folder = chat.folder.with_name("other")
    chat.run(4, cache=cache, settings={"temperature": 1})
    assert len(chat.served.requests) == 16


def test_a_reply_that_was_paid_for_and_not_logged_is_logged_once(chat: Chat) -> None:
    """Killed between the two, and again."""
    chat.run(2)
    replies, steps, episodes = (
        (chat.folder / name).read_bytes().splitlines(keepends=True)
        for name in ("replies.jsonl", "steps.jsonl", "episodes.jsonl")
    )
    forget_end(chat.folder)
    (chat.folder / "episodes.jsonl").write_bytes(episodes[0])
    (chat.folder / "steps.jsonl").write_bytes(b"".join(steps[:2]))
    (chat.folder / "replies.jsonl").write_bytes(b"".join(replies[:3]) + replies[3][:20])
    totals = chat.run(2)
    assert (totals.input_tokens, totals.ended) == (400, 2)
    assert len(chat.served.requests) == 5  # the reply that was cut off is asked for again
    again = (chat.folder / "replies.jsonl").read_bytes().splitlines(keepends=True)
    assert again[:3] == replies[:3]
    assert json.loads(again[3])["key"] == json.loads(replies[3])["key"]


def test_a_line_that_is_not_a_reply_is_named(chat: Chat) -> None:
    chat.folder.mkdir()
    cache = chat.folder.with_name("cache")
    cache.mkdir()
    (cache / "replies.jsonl").write_text("{}\n")
    with pytest.raises(RunError, match=r"replies.jsonl, byte 0: not a reply of a model: .*asked"):
        chat.run(cache=str(cache))


# What can change an answer.


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        pytest.param({"model": "others"}, "option model: words, now others", id="model"),
        pytest.param({"history": "map"}, "option history: full, now map", id="history"),
        pytest.param(
            {"observe": "geometry"}, "option observe: objects, now geometry", id="input class"
        ),
        pytest.param(
            {"settings": {}}, "option settings: {'temperature': 0}, now {}", id="settings"
        ),
        pytest.param({"prompts": "mine"}, "option prompts: ", id="prompts"),
    ],
)
def test_a_run_does_not_go_on_with_what_can_change_an_answer(
    changes: Mapping[str, Any], message: str, chat: Chat, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(chat.folder.parent)
    Path("mine").mkdir()
    Path("mine", "repair.txt").write_text("No: $problem")
    chat.run()
    with pytest.raises(RunError) as caught:
        chat.run(**changes)
    assert message in str(caught.value)


def test_a_run_goes_on_at_another_address_with_other_money_and_keys(
    chat: Chat, prices: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    chat.served.script += [saying(GO), failing(403)]
    with pytest.raises(RunError):
        chat.run()
    monkeypatch.setenv("OTHER", KEY)
    with endpoint(KEY) as other:
        chat.run(endpoint=other.url, key_from="OTHER", prices=prices, max_cost=1.0, timeout=100.0)
        assert len(other.requests) == 1
    card = msgspec.json.decode((chat.folder / "run.json").read_bytes(), type=RunCard)
    assert [each.options["key_from"] for each in card.circumstances] == ["MY_KEY", "OTHER"]


def test_a_key_is_nowhere(chat: Chat, monkeypatch: pytest.MonkeyPatch) -> None:
    """Endpoints repeat it in their errors."""
    monkeypatch.setenv("MY_KEY", "sk-wrong")
    with pytest.raises(
        RunError, match=r"401 Unauthorized: Incorrect API key provided: \.\.\."
    ) as error:
        chat.run()
    monkeypatch.setenv("MY_KEY", KEY)
    chat.run()
    written = b"".join(file.read_bytes() for file in chat.folder.iterdir())
    assert b"sk-" not in written + str(error.value).encode()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        pytest.param({"endpoint": "localhost:80"}, "like https://HOST/v1", id="no address"),
        pytest.param({"endpoint": "http://me:pw@h/v1"}, "without user, key or query", id="user"),
        pytest.param({"endpoint": "http://h/v1?key=x"}, "without user, key or query", id="query"),
        pytest.param({"key_from": "NO_KEY"}, "variable NO_KEY has no key", id="key"),
        pytest.param({"observe": "all"}, "observe is 'all'; choose one of: geometry", id="class"),
        pytest.param({"history": "maps"}, "did you mean map?", id="history"),
        pytest.param({"moves": 1.5}, "moves is a whole number, not 1.5", id="moves"),
        pytest.param({"settings": {"n": 2}}, "settings cannot have n", id="settings"),
        pytest.param({"max_cost": 1.0}, "a limit of the cost needs prices", id="no prices"),
        pytest.param({"prices": "none.toml"}, "none.toml", id="no file of prices"),
        pytest.param({"prices": "undated.toml"}, "undated.toml has no date", id="undated"),
        pytest.param({"prices": "bad.toml"}, "bad.toml: ", id="not TOML"),
        pytest.param(
            {"prices": "prices.toml", "model": "big"},
            "prices.toml has no prices for 'big', but for words, free",
            id="unknown price",
        ),
        pytest.param({"prices": "half.toml"}, "'words': cached, output should be US", id="half"),
        pytest.param({"prompts": "none"}, "none: there is no folder with prompts", id="no prompts"),
        pytest.param({"prompts": "other"}, "is not a prompt; did you mean step?", id="name"),
        pytest.param(
            {"prompts": "wrong"},
            "placeholder $where; there are: $problem",
            id="placeholder",
        ),
        pytest.param({"prompts": "money"}, "a $ that is not of a placeholder", id="dollar"),
        pytest.param({"prompts": "latin"}, "object.txt: 'utf-8' codec can't decode", id="encoding"),
        pytest.param({"model_": "x"}, "its options: model, endpoint, observe", id="option"),
    ],
)
def test_what_is_wrong_is_said_before_there_is_a_folder(
    changes: Mapping[str, Any],
    message: str,
    chat: Chat,
    prices: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(chat.folder.parent)
    Path("undated.toml").write_text("[words]\ninput = 1")
    Path("bad.toml").write_text("words")
    Path("half.toml").write_text("date = 2026-01-01\n[words]\ninput = 1\noutput = -1\n")
    texts = {"other/setp": "", "wrong/repair": "$where", "money/repair": "$5 for $problem"}
    for name, text in texts.items():
        file = Path(f"{name}.txt")
        file.parent.mkdir()
        file.write_text(text)
    Path("latin").mkdir()
    Path("latin", "object.txt").write_bytes(b"\xfc")
    with pytest.raises((ReverieEvalError, OSError)) as caught:
        chat.run(**changes)
    assert message in str(caught.value)
    assert not chat.folder.exists()
    assert chat.served.requests == []


def test_an_endpoint_that_is_not_there_is_named_at_once(chat: Chat) -> None:
    with pytest.raises(RunError, match=r"connection refused; no server is running there$"):
        chat.run(endpoint="http://127.0.0.1:1/v1")
    assert chat.waits == []


# What a model is told, as somebody reads it who sees nothing else.


FIRST = """You are at place 1. You can go to:
- place 2: straight ahead, 2.2 m
- place 3: 138° right, 2.7 m
- place 4: 99° right, 1.7 m
- place 5: 165° left, 2.0 m

Visible from here:
- object 25: picture, behind you
- object 29: rug, 151° left
- object 26: picture, 132° left
- object 27: picture, 88° left
- object 23: bench, 71° left
- object 28: plant, 69° right

You have 2 moves left."""
SECOND = """You are at place 2. You can go to:
- place 1: behind you, 2.2 m, visited
- place 6: 76° right, 1.7 m
- place 7: 86° left, 2.1 m

Visible from here:
- object 32: radiator, straight ahead
- object 31: picture, 91° right
- object 30: picture, 114° right
- object 33: window, 144° right

You have 1 move left."""
THIRD = """You are at place 6. You can go to:
- nowhere any more

Visible from here:
- object 32: radiator, 134° left
- object 31: picture, 34° right
- object 30: picture, 69° right
- object 33: window, 117° right

You have no moves left."""
MAP = """Your map:
- place 1 leads to 2, 3, 4, 5; visible: bench, picture, plant, rug
- place 2 leads to 1, 6, 7; visible: picture, radiator, window
- place 6 leads to 2, 8; visible: picture, radiator, window
Your way so far: 1, 2, 6
Not visited yet: 3, 4, 5, 7, 8
Your last thought: On.

"""
BEGIN = """
Walk to the bedroom on level 1 and change the sheets on the bed

"""
WALK = [saying(f'{{"thought": "On.", "action": "go", "place": {place}}}') for place in (2, 6)]


def asked(chat: Chat, **options: Any) -> list[Mapping[str, Any]]:
    """Return the messages of the last request of a walk through the demo world."""
    chat.truth = some(1)
    chat.served.script += [*WALK, saying(STOP)]
    run(RunPlan(AgentSource("chat", chat.options(moves=2, **options)), chat.truth), chat.folder)
    messages: list[Mapping[str, Any]] = chat.served.requests[-1]["messages"]
    return messages


def test_all_messages_are_sent_again(chat: Chat) -> None:
    system, *others = asked(chat)
    assert BEGIN in system["content"]
    assert "You can make 2 moves." in system["content"]
    assert '{"thought": "...", "action": "answer", "object": 12}' in system["content"]
    replies = [f'{{"thought": "On.", "action": "go", "place": {place}}}' for place in (2, 6)]
    contents = [FIRST, replies[0], SECOND, replies[1], THIRD]
    roles = ["user", "assistant"] * 3
    assert [(it["role"], it["content"]) for it in others] == [*zip(roles, contents, strict=False)]
    notes = chat.notes
    assert [each["asked"] for each in notes] == [FIRST, SECOND, THIRD]
    assert [each["thought"] for each in notes] == ["On.", "On.", ""]


def test_a_map_is_sent_instead(chat: Chat) -> None:
    system, message = asked(chat, history="map")
    assert BEGIN in system["content"]
    assert message == {"role": "user", "content": MAP + THIRD}


def test_geometry_has_no_objects(chat: Chat) -> None:
    system, *_, message = asked(chat, observe="geometry")
    assert "answer" not in system["content"]
    assert message["content"] == re.sub(r"Visible.*\n\n", "", THIRD, flags=re.DOTALL)
    (attempt,) = read_attempts(chat.folder)
    assert attempt.read == ("geometry", "instruction")
    schema = chat.served.requests[-1]["response_format"]["json_schema"]["schema"]
    assert schema["properties"]["action"]["enum"] == ["go", "stop"]


def test_a_task_without_targets_has_no_answers(chat: Chat) -> None:
    truth = GroundTruth.load(DEMO_BUNDLES / "r2r" / "val_unseen.npz")
    chat.truth = truth.subset(truth.episodes.instr_ids[:1])
    chat.served.script.append(saying(STOP))
    run(RunPlan(AgentSource("chat", chat.options()), chat.truth), chat.folder)
    (request,) = chat.served.requests
    assert "Follow it, and end where it leads to." in request["messages"][0]["content"]
    schema = request["response_format"]["json_schema"]["schema"]
    assert schema["properties"]["action"]["enum"] == ["go", "stop"]


def test_views_are_six_pictures_around(chat: Chat, tmp_path: Path) -> None:
    """The agent looks to 83.6 degrees; the nearest of the level views, 15, looks to 90."""
    truth = some(1)
    pictures = write_skybox(tmp_path, truth)
    chat.served.script += [
        saying('{"action": "answer", "picture": 7, "box": [1, 2, 3, 4]}'),
        saying('{"action": "answer", "picture": 2, "box": [410, 220, 90, 60]}'),
    ]
    source = AgentSource("chat", chat.options(observe="views"))
    totals = run(RunPlan(source, truth, pictures=pictures), chat.folder)
    assert totals.read == ("geometry", "instruction", "pictures")
    text, *shown = chat.served.requests[0]["messages"][-1]["content"]
    assert text["text"].partition("\n\n")[2].splitlines()[:7] == [
        "The pictures show:",
        "- picture 1: straight ahead",
        "- picture 2: 66° right",
        "- picture 3: 126° right",
        "- picture 4: behind you",
        "- picture 5: 114° left",
        "- picture 6: 54° left",
    ]
    assert "- place 4: 99° right, 1.7 m, in picture 3\n" in text["text"]
    images = [Image.open(io.BytesIO(b64decode(each["image_url"]["url"][23:]))) for each in shown]
    assert [image.size for image in images] == [(640, 480)] * 6
    seen = Environment(truth, pictures=pictures).reset(truth.episodes.instr_ids[0])
    for image, view in zip(images, (15, 17, 19, 21, 23, 13), strict=True):
        assert np.abs(np.asarray(image, int) - seen.image(view)).mean() < 4
    (record,) = json.loads((chat.folder / "submission.json").read_text())
    assert (record["predView"], record["predBox"]) == (17, [410, 220, 90, 60])
    (wrong,) = (note["problem"] for note in chat.notes)
    assert wrong == '"picture" is 7, and can be: 1, 2, 3, 4, 5, 6'
