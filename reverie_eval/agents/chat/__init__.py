"""A language model as an agent, behind an OpenAI-compatible endpoint."""

from reverie_eval.agents.chat._agent import ChatAgent, History, InputClass
from reverie_eval.agents.chat._dialogue import DEFAULT_PROMPTS

__all__ = ["DEFAULT_PROMPTS", "ChatAgent", "History", "InputClass"]
