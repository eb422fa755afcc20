"""Agents: how they are called, reference agents, and how one is found by its name.

An agent has two methods, ``start(episode)`` and ``act(observation)``, which returns an action.
"""

from reverie_eval.agents._episode import Agent, Episode, Solved
from reverie_eval.agents._exploring import NearestFirstAgent, WordMatchAgent
from reverie_eval.agents._finding import BUILT_IN, ENTRY_POINTS, AgentSource
from reverie_eval.agents._reference import (
    AGENTS,
    MAX_RANDOM_STEPS,
    RandomAgent,
    Record,
    ShortestAgent,
    StopAgent,
    run_agent,
)

__all__ = [
    "AGENTS",
    "BUILT_IN",
    "ENTRY_POINTS",
    "MAX_RANDOM_STEPS",
    "Agent",
    "AgentSource",
    "Episode",
    "NearestFirstAgent",
    "RandomAgent",
    "Record",
    "ShortestAgent",
    "Solved",
    "StopAgent",
    "WordMatchAgent",
    "run_agent",
]
