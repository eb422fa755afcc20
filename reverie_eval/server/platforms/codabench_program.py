"""The scoring program of a Codabench competition: scores the file that a participant sent.

It is copied into the bundle unchanged, and runs in a container that has reverie-eval.
"""

import json
import sys
from pathlib import Path

import reverie_eval as rv
from reverie_eval.server.platforms.scores import displayed_scores


def main(given: Path, output: Path) -> None:
    """Write ``scores.json`` with the digits that the leaderboard shows, or exit with the reason."""
    reference = given / "ref"
    rules = json.loads((reference / "rules.json").read_bytes())
    try:
        scores = rv.evaluate(
            find_submission(given / "res"),
            split=rules["split"],
            ground_truth=reference / "bundle.npz",
            protocol=rules["protocol"],
            track=rules["track"],
        )
        shown = displayed_scores(scores.to_report(), rules["metrics"])
    except rv.SubmissionError as error:
        sys.exit(str(error))
    output.mkdir(parents=True, exist_ok=True)
    unfinished = output / ".scores"
    unfinished.write_text(json.dumps(shown))
    unfinished.replace(output / "scores.json")


def find_submission(folder: Path) -> Path:
    """Return the only JSON file of an unpacked archive, apart from those that macOS adds."""
    found = [
        path
        for path in sorted(folder.rglob("*.json"))
        if not path.name.startswith(".") and "__MACOSX" not in path.parts
    ]
    if len(found) != 1:
        names = ", ".join(path.name for path in found) or "none"
        sys.exit(f"the zip archive must contain one .json file, the submission; found: {names}")
    return found[0]


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
