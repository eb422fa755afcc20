"""Reference agents: the learning-free rows of the paper's tables, as submissions.

They know the answers (the shortest way needs the goal, a random candidate the boxes), so they run
on bundles with answers only, and never belong on a leaderboard.
"""

from reverie_eval.agents.reference import AGENTS, Record, run_agent

__all__ = ["AGENTS", "Record", "run_agent"]
