"""What an agent saw, did and said in an episode, step by step: lists for reports and notebooks."""

import json
from collections.abc import Iterator
from html import escape
from math import degrees, inf

import numpy as np

from reverie_eval.analysis import Episode
from reverie_eval.geometry import level_view
from reverie_eval.logs import COSTS, Step, cost_text
from reverie_eval.reporting.answer_svg import view_svg
from reverie_eval.reporting.answers import AnswerView
from reverie_eval.reporting.maps import EpisodeMap
from reverie_eval.text import count_text

# Letters of a viewpoint's id, which tell those of a scan apart.
_SHOWN_OF_ID = 8
_VIEW = "max-width: 20rem; margin: 0.4em 0"
_NOTE = "margin: 0.2em 0; max-height: 14em; overflow: auto; white-space: pre-wrap"


def replay_html(episode: Episode, episode_map: EpisodeMap) -> str:
    """List the steps of an episode, folded; empty if its run has no log of them.

    The map has the numbers of the steps where they were made.
    """
    if not episode.steps:
        return ""
    steps = "".join(
        f'<li value="{step.step}">{_seen(step, episode, episode_map)}'
        f"{_view(step, episode, episode_map)}{_done(step, episode)}{''.join(_said(step))}</li>"
        for step in episode.steps
    )
    count = count_text(len(episode.steps), "step")
    return f"<details><summary>Replay {count}</summary><ol>{steps}</ol></details>"


def _seen(step: Step, episode: Episode, episode_map: EpisodeMap) -> str:
    """Say where the agent was, and what there was to see."""
    parts = [f"{_viewpoint(step.viewpoint_id)}, facing {degrees(step.heading) % 360:.0f}°"]
    if step.viewpoint_id in episode_map.viewpoint_ids:  # a log may be of other buildings
        row = episode_map.viewpoint_ids.index(step.viewpoint_id)
        neighbours = len(episode.graph.neighbours(int(episode_map.graph_row[row])))
        objects = len(episode.visible_objects(step.viewpoint_id))
        to_goal = float(episode_map.to_goal(np.array([row]))[0])
        parts += [
            count_text(neighbours, "neighbour"),
            count_text(objects, "object"),
            *([] if to_goal == inf else [f"{to_goal:.1f} m to the goal"]),
        ]
    return "; ".join(parts)


def _view(step: Step, episode: Episode, episode_map: EpisodeMap) -> str:
    """Draw the level view nearest to where the agent faced; a line break without one.

    A task without objects has no rooms to draw.
    """
    is_here = step.viewpoint_id in episode_map.viewpoint_ids
    if not is_here or episode.target_object is None:
        return "<br>"
    view = level_view(step.heading)
    drawing = view_svg(AnswerView.at_step(episode, step.viewpoint_id, view))
    return f'<div style="{_VIEW}">{drawing}</div>'


def _done(step: Step, episode: Episode) -> str:
    """Say what the agent did, and what that cost."""
    arguments = [
        escape(episode.object_name(value)) if name == "object_id" else _viewpoint(str(value))
        for name, value in dict(step.arguments or {}).items()
    ]
    costs = [
        cost_text(key, value) for key in COSTS if (value := getattr(step, key, None)) is not None
    ]
    action = escape(step.action) or "no action"
    return f"<b>{action}</b> {', '.join(arguments)} <small>{', '.join(costs)}</small>"


def _said(step: Step) -> Iterator[str]:
    for name, value in step.notes.items():
        text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
        yield f'<p style="{_NOTE}"><em>{escape(name)}</em> {escape(text)}</p>'


def _viewpoint(text: str) -> str:
    return f'<code title="{escape(text)}">{escape(text[:_SHOWN_OF_ID])}</code>'
