"""Lines that are read by everybody, or years later: reasons, banners, names on a board."""

from reverie_eval.schemas.wire import LONGEST_LINE, one_line
from reverie_eval.server.errors import MalformedError


def demand_line(text: str, refusal: str, longest: int = LONGEST_LINE) -> str:
    """Return a text in the form in which it is kept: one line, of letters that can be seen.

    Raises
    ------
    MalformedError
        With the refusal, if it is empty, too long, or no such line.
    """
    try:
        line = one_line(text.strip())
    except ValueError:
        line = ""
    if not 0 < len(line) <= longest:
        raise MalformedError(refusal)
    return line


def demand_reason(text: str) -> str:
    """Return why something was done; MalformedError if that is not said."""
    return demand_line(text, "say why, in a line that will be read years later")
