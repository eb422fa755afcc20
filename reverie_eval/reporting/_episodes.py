"""An episode as a page shows it: its map, with what there was to do and what came of it."""

from html import escape

from reverie_eval.analysis import Episode
from reverie_eval.reporting._map_svg import map_key, map_svg
from reverie_eval.reporting._maps import EpisodeMap

_WIDTH = "max-width: 36rem"


def episode_html(episode: Episode) -> str:
    """Show an episode by itself, as in a notebook."""
    episode_map = EpisodeMap.of({"": episode})
    return (
        f'<figure style="margin: 0; {_WIDTH}">{map_svg(episode_map)}<figcaption>'
        f"<code>{escape(episode.instr_id)}</code> {instruction_html(episode.instruction)}<br>"
        f"{escape(episode.caption)}</figcaption>{map_key([''])}</figure>"
    )


def instruction_html(instruction: str) -> str:
    """Quote what the agent was told, if that is known."""
    return f"<q>{escape(instruction)}</q>" if instruction else ""
