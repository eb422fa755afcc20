"""Where results may be written: never over what was given, and never twice to one file."""

from pathlib import Path

from reverie_eval import ReverieEvalError


def check_outputs(outputs: list[str | Path | None], inputs: list[str | Path | None]) -> None:
    """Refuse to write over an input, or twice to the same file.

    Raises
    ------
    ReverieEvalError
        Naming the file.
    """
    taken = {Path(path).resolve() for path in inputs if path and Path(path).is_file()}
    for output in outputs:
        if not output:
            continue
        place = Path(output).resolve()
        if place in taken:
            raise ReverieEvalError(f"{output} is used already; choose another file to write to")
        taken.add(place)
