"""Agents: how they are called, reference agents, and how one is found by its name.

An agent has two methods, ``start(episode)`` and ``act(observation)``, which returns an action; or
``act_batch(episodes, observations)``, which returns one for each episode. An agent that remembers
nothing can be a function that does what ``act`` does.
"""

from reverie_eval.agents._episode import Agent, BatchAgent, Episode
from reverie_eval.agents._finding import BUILT_IN_AGENTS, AgentSource
from reverie_eval.agents._untrained import (
    AGENTS,
    DEMO_AGENT,
    MAX_RANDOM_STEPS,
    RandomAgent,
    ShortestAgent,
    StopAgent,
)

__all__ = [
    "AGENTS",
    "BUILT_IN_AGENTS",
    "DEMO_AGENT",
    "MAX_RANDOM_STEPS",
    "Agent",
    "AgentSource",
    "BatchAgent",
    "Episode",
    "RandomAgent",
    "ShortestAgent",
    "StopAgent",
]
