"""A check for agents of your own, for a test of yours to call."""

from collections.abc import Iterable, Mapping

from reverie_eval.logs import Step
from reverie_eval.runner._walking import Job, Plan, Walker
from reverie_eval.simulator.conformance import ConformanceError


def check_agent(plan: Plan, *, number: int = 5) -> frozenset[str]:
    """Let an agent walk some episodes twice, and return what it read, as a run's record says it.

    The second time is in reverse order, and one episode at a time: an agent that remembers what it
    should not, or whose batches are not independent, does something else then.

    Parameters
    ----------
    plan : Plan
        The agent, and the episodes of which it walks the first.
    number : int
        Episodes that are walked.

    Raises
    ------
    ConformanceError
        If the agent does something else the second time, fails, does not end an episode, or does
        what cannot be done.
    """
    episodes = plan.ground_truth.episodes.instr_ids[:number]
    first, read = _walk(Walker(plan), episodes)
    second, _ = _walk(Walker(plan, most=1), episodes[::-1])
    for episode, actions in first.items():
        if actions != second[episode]:
            raise ConformanceError(f"{episode}: the agent does something else the second time")
    return read


def _walk(
    walker: Walker, episodes: Iterable[str]
) -> tuple[Mapping[str, list[object]], frozenset[str]]:
    """Return the actions in each episode, and all that was read."""
    jobs = iter([Job(episode, 1) for episode in episodes])
    actions: dict[str, list[object]] = {}
    read: set[str] = set()
    for row in walker.work(lambda: next(jobs, None)):
        if isinstance(row, Step):
            actions.setdefault(row.episode, []).append((row.action, row.arguments))
        elif row.state != "ended":
            raise ConformanceError(f"{row.episode}: {row.reason}")
        else:
            read.update(row.read)
    return actions, frozenset(read)
