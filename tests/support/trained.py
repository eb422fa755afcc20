"""Result files of an agent that learns: the longer it trains, the more episodes it solves."""

import json
from collections.abc import Sequence
from pathlib import Path
from random import Random

from reverie_eval import GroundTruth


def write_checkpoints(
    folder: Path, truths: Sequence[GroundTruth], seeds: int, steps: Sequence[int]
) -> None:
    """Write ``seed{seed}/{step}_{split}.json`` for each seed, step and split.

    The chance to solve an episode rises to one half at half of the steps, and then stays. Episodes
    differ in how hard they are, which all files share.
    """
    for truth in truths:
        solved, failed = zip(*_records(truth), strict=True)
        hard = [Random(f"{truth.split} {row}").random() for row in range(len(solved))]
        for seed in range(1, seeds + 1):
            (folder / f"seed{seed}").mkdir(parents=True, exist_ok=True)
            for step in steps:
                luck = Random(f"{truth.split} {seed} {step}")
                skill = min(step / steps[-1], 0.5)
                rows = zip(solved, failed, hard, strict=True)
                records = [
                    right if (luck.random() + it) / 2 < skill else wrong
                    for right, wrong, it in rows
                ]
                file = folder / f"seed{seed}" / f"{step}_{truth.split}.json"
                file.write_text(json.dumps(records))


def _records(truth: GroundTruth) -> list[tuple[dict[str, object], dict[str, object]]]:
    """Return of each episode the annotated path with the target, and a stop at the start."""
    solution, ids = truth.require_solution(), truth.graph.viewpoint_ids
    found = []
    for row, instr_id in enumerate(truth.episodes.instr_ids):
        item = truth.episodes.item[row]
        begin, end = solution.path_offsets[item : item + 2]
        poses = [[ids[viewpoint], 0.0, 0.0] for viewpoint in solution.path[begin:end].tolist()]
        target = int(solution.target_object[row])
        found.append(
            (
                {"instr_id": instr_id, "trajectory": poses, "predObjId": target},
                {"instr_id": instr_id, "trajectory": poses[:1], "predObjId": -1},
            )
        )
    return found
