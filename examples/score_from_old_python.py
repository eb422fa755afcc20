"""Score from a Python that is older than reverie-eval supports: copy this file beside your code.

It needs Python 3.6 and nothing else. The command `reverie-eval` is in an environment of its own,
where `pipx install reverie-eval` or `uv tool install reverie-eval` puts it, and is run from here::

    from score_from_old_python import evaluate

    report = evaluate(predictions, split="val_unseen")
    print(report["scores"]["rgspl"], report["signature"])

``python score_from_old_python.py submit.json val_unseen`` prints the report of a file.
"""

import json
import os
import subprocess
import sys

COMMAND = os.environ.get("REVERIE_EVAL_COMMAND", "reverie-eval")


def evaluate(predictions, split, **options):
    """Return what ``reverie-eval score --format json`` prints, as a dict.

    ``predictions`` are the records of a submission, with Python or numpy numbers, or the path of a
    file. Options are those of the command: ``protocol="paper"``, ``ground_truth="bundles"``.
    Raises ValueError with every problem if the submission is rejected.
    """
    is_file = isinstance(predictions, (str, os.PathLike))
    words = [COMMAND, "score", os.fspath(predictions) if is_file else "-", "--format", "json"]
    for name, value in dict(options, split=split).items():
        words += ["--" + name.replace("_", "-"), str(value)]
    content = "" if is_file else json.dumps(predictions, default=lambda number: number.item())
    # What is there for this Python is not for the command's.
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME")}
    finished = subprocess.run(  # noqa: UP022  # Python 3.6 has no `capture_output`
        words,
        input=content.encode(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=environment,
        check=False,
    )
    if finished.returncode:
        raise ValueError(finished.stderr.decode())
    return json.loads(finished.stdout.decode())


if __name__ == "__main__":
    print(json.dumps(evaluate(sys.argv[1], sys.argv[2]), indent=2))
