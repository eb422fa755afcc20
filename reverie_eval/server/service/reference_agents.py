"""What the reference agents score on open splits, to compare the first results with."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from threading import Lock

from reverie_eval.agents import AGENTS, run_agent
from reverie_eval.server.service.boards import Board


@dataclass(frozen=True, slots=True)
class ReferenceResult:
    """The scores of a reference agent."""

    agent: str
    scores: Mapping[str, float]


@dataclass(frozen=True)
class ReferenceAgents:
    """Runs the reference agents, on each split once."""

    _results: dict[str, Sequence[ReferenceResult]] = field(default_factory=dict)
    _lock: Lock = field(default_factory=Lock)
    """So that concurrent requests run them only once."""

    def results(self, board: Board) -> Sequence[ReferenceResult]:
        """Return the results on a split, the best first; none on a private split.

        There, the score of the random agent would say something about the answers.
        """
        if board.is_private:
            return ()
        with self._lock:
            if board.name not in self._results:
                found = [ReferenceResult(agent, _scores(board, agent)) for agent in AGENTS]
                primary = board.primary.key
                found.sort(key=lambda result: result.scores.get(primary, 0.0), reverse=True)
                self._results[board.name] = found
            return self._results[board.name]


def _scores(board: Board, agent: str) -> Mapping[str, float]:
    records = run_agent(agent, board.truth)
    if board.split.track == "grounding":  # takes answers alone
        records = [{key: record[key] for key in ("instr_id", "predObjId")} for record in records]
    return dict(board.score(board.read(json.dumps(records).encode())))
