"""A language model as an agent: what it is told, what it replies, and what is kept of that."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal, get_args

from reverie_eval.agents._episode import Episode
from reverie_eval.agents.chat._asking import Asker, Budget, Message, Prices
from reverie_eval.agents.chat._dialogue import (
    Choices,
    Chosen,
    NoActionError,
    NumberedMap,
    Prompts,
    captions_of,
    describe_objects,
    describe_ways,
    pictures_around,
)
from reverie_eval.agents.chat._endpoint import Endpoint, Reply
from reverie_eval.agents.chat.errors import CutReplyError, RefusalError, WrongActionError
from reverie_eval.arrays import Array
from reverie_eval.errors import ReverieEvalError
from reverie_eval.simulator import Action, Go, Observation, jpeg_url
from reverie_eval.tasks import find_task
from reverie_eval.text import count_text, did_you_mean

InputClass = Literal["geometry", "objects", "views"]
History = Literal["full", "map"]

# Why a reply ended, as endpoints say it.
_CUT = "length"
_REFUSED = frozenset({"content_filter", "refusal"})
# Of JPEGs. Higher than Pillow's 75, because objects to be pointed at may be small.
_QUALITY = 85
# Fields of a request that settings may not have.
_OUR_FIELDS = frozenset({"model", "messages", "response_format", "stream", "n"})


class ChatAgent:
    """Asks a language model for each action, at an endpoint that is compatible with OpenAI's.

    Replies are kept in a file, and no reply is paid for twice.

    Parameters
    ----------
    model : str
        The model, as the endpoint calls it.
    endpoint : str
        The address to which ``/chat/completions`` is appended: ``http://localhost:11434/v1``.
    observe : {"geometry", "objects", "views"}
        The input class: where neighbours are; also the objects that annotators labelled, which is
        perfect perception; or also six pictures.
    cache : path
        The folder of ``replies.jsonl``, where replies are kept.
    history : {"full", "map"}
        Whether the model is sent all messages of the episode again, or a map of where it was.
    prompts : path, optional
        A folder with texts that replace ours.
    moves : int
        Moves that the model can make in an episode; by default as many as actions in agents of
        public codebases, such as ``max_action_len`` of DUET.
    settings : mapping, optional
        Further fields of each request; by default, a temperature of 0.
    key_from : str
        The environment variable with the key, if one is needed.
    prices : path, optional
        A table of prices, as TOML.
    max_cost : float, optional
        US dollars; no reply is asked for once those in the file cost as much.
    timeout : float
        Seconds to wait for the next byte of a reply before the request counts as failed.

    Raises
    ------
    ReverieEvalError
        If an option is wrong, a file cannot be read, there is no key, or there is a limit of the
        cost and no prices.
    MissingPartError
        If what sends requests is not installed.
    """

    def __init__(
        self,
        model: str,
        endpoint: str,
        observe: InputClass,
        cache: str,
        *,
        history: History = "full",
        prompts: str | None = None,
        moves: int = 15,
        settings: Mapping[str, Any] | None = None,
        key_from: str = "",
        prices: str | None = None,
        max_cost: float | None = None,
        timeout: float = 300.0,
    ) -> None:
        self._settings = {"temperature": 0} if settings is None else dict(settings)
        _check_options(observe, history, moves, self._settings)
        self._model, self._observe, self._history, self._moves = model, observe, history, moves
        self._prompts = Prompts(None if prompts is None else Path(prompts))
        self._budget = Budget(
            None if prices is None else Prices.read(Path(prices), model), max_cost
        )
        self._endpoint = Endpoint(endpoint, key_from, timeout)
        self._cache = Path(cache)
        self._asker: Asker | None = None

    @classmethod
    def identity(cls, **options: Any) -> Mapping[str, Any]:
        """Return what of the options can change an answer, and check all of them."""
        made = cls(**options)
        return {
            "model": made._model,
            "observe": made._observe,
            "history": made._history,
            "moves": made._moves,
            "settings": made._settings,
            "prompts": made._prompts.digest,
        }

    def start(self, episode: Episode) -> None:
        """Begin an episode."""
        if self._asker is None:
            self._asker = Asker(
                self._endpoint, self._model, self._settings, self._cache, self._budget
            )
        self._episode = episode
        self._seed = episode.rng.getrandbits(32)
        self._has_target = find_task(episode.task).has_targets
        self._explored = NumberedMap()
        self._moved = 0
        self._messages: list[Message] = []
        self._thought = ""

    def act(self, seen: Observation) -> Action:
        """Ask for an action, and once more if it is not one.

        Raises
        ------
        RefusalError, CutReplyError, WrongActionError, LongPromptError
            If the model gives none.
        EndpointError
            If the endpoint gives no reply.
        """
        self._paid: list[str] = []
        choices, message, said = self._tell(seen)
        self._episode.log(asked=said)
        chosen = self._choose([*self._system(seen), *self._messages, message], choices)
        self._episode.log(reply=chosen.text, thought=chosen.thought)
        if self._history == "full":
            # Pictures once: they are most of what a model is sent.
            self._messages += [_message("user", said), _message("assistant", chosen.text)]
        self._thought = chosen.thought
        self._moved += isinstance(chosen.action, Go)
        return chosen.action

    # What the model is told.

    def _system(self, seen: Observation) -> Sequence[Message]:
        answer = {"geometry": "place", "objects": "object", "views": "box"}[self._observe]
        name = answer if self._has_target else "route"
        text = self._prompts.fill(name, instruction=seen.instruction, moves=self._moves)
        return [_message("system", text)]

    def _tell(self, seen: Observation) -> tuple[Choices, Message, str]:
        """Return what the model can choose, and the message that says so, also as text alone."""
        here = self._explored.enter(seen)
        left = self._moves - self._moved
        neighbours = seen.neighbours if left else ()
        views: Sequence[int] = ()
        visible = ""
        objects, pictures = None, None
        if self._observe == "objects":
            self._explored.note_objects(seen.candidates)
            visible = describe_objects(seen)
            objects = {each.object_id: each.object_id for each in seen.candidates}
        if self._observe == "views":
            views = pictures_around(seen)
            visible = captions_of(seen, views)
            pictures = dict(enumerate(views, 1))
        said = self._prompts.fill(
            "step",
            map=self._explored.map(self._thought) if self._history == "map" else "",
            place=here,
            neighbours=describe_ways(seen, neighbours, self._explored, views),
            visible=visible,
            moves_left=f"You have {count_text(left, 'move') if left else 'no moves'} left.",
        )
        choices = Choices(
            {self._explored.number(each.viewpoint_id): each.viewpoint_id for each in neighbours},
            objects if self._has_target else None,
            pictures if self._has_target else None,
        )
        return choices, _message("user", said, [seen.image(view) for view in views]), said

    # What it replies.

    def _choose(self, messages: Sequence[Message], choices: Choices) -> Chosen:
        reply = self._ask(messages, choices)
        try:
            return _read(reply, choices)
        except NoActionError as error:
            self._episode.log(wrong_reply=reply.text, problem=str(error))
            again = self._prompts.fill("repair", problem=error)
        wrong = _message("assistant", reply.text or "(nothing)")
        reply = self._ask([*messages, wrong, _message("user", again)], choices)
        try:
            return _read(reply, choices)
        except NoActionError as error:
            self._episode.log(reply=reply.text)
            kind = CutReplyError if reply.end == _CUT else WrongActionError
            raise kind(f"no action after a second try: {error}") from None

    def _ask(self, messages: Sequence[Message], choices: Choices) -> Reply:
        assert self._asker is not None  # noqa: S101  # an episode has been started
        reply = self._asker.ask(messages, choices.response_format, self._seed, self._log_paid)
        if reply.refusal or reply.end in _REFUSED:
            raise RefusalError(reply.refusal or reply.text or reply.end)
        return reply

    def _log_paid(self, reply: Reply) -> None:
        self._paid.append(reply.key)
        self._episode.log(**asdict(reply.usage), replies=self._paid)
        if self._budget.prices:
            self._episode.log(prices_of=self._budget.prices.date)


def _read(reply: Reply, choices: Choices) -> Chosen:
    try:
        return choices.read(reply.text)
    except NoActionError:
        if reply.end == _CUT:
            raise NoActionError("it was cut off before its end; be brief") from None
        raise


def _message(role: str, text: str, pictures: Sequence[Array] = ()) -> Message:
    if not pictures:
        return {"role": role, "content": text}
    urls = [jpeg_url(each, _QUALITY) for each in pictures]
    shown = [{"type": "image_url", "image_url": {"url": url}} for url in urls]
    return {"role": role, "content": [{"type": "text", "text": text}, *shown]}


def _check_options(observe: str, history: str, moves: object, settings: Mapping[str, Any]) -> None:
    for name, value, known in (
        ("observe", observe, get_args(InputClass)),
        ("history", history, get_args(History)),
    ):
        if value not in known:
            raise ReverieEvalError(f"{name} is {value!r}{did_you_mean(value, known)}")
    if type(moves) is not int or moves < 0:
        raise ReverieEvalError(f"moves is a whole number, not {moves!r}")
    if ours := sorted(_OUR_FIELDS & {*settings}):
        raise ReverieEvalError(f"settings cannot have {', '.join(ours)}")
