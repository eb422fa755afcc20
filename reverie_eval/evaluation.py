"""Evaluate: the one place that joins reading, aligning, observing and scoring."""

from collections.abc import Mapping
from os import PathLike
from types import MappingProxyType

import numpy as np

from reverie_eval import metrics
from reverie_eval.alignment import align
from reverie_eval.arrays import Array, frozen
from reverie_eval.facts import Facts, find_jumps, observe
from reverie_eval.ground_truth import GroundTruth, find_ground_truth
from reverie_eval.protocol import DEFAULT_PROTOCOL, protocol_named
from reverie_eval.reading import Submission, read_predictions
from reverie_eval.scores import Scores, Validation


def evaluate(
    submission: Submission,
    *,
    split: str,
    ground_truth: str | PathLike[str] | GroundTruth | None = None,
    protocol: str = DEFAULT_PROTOCOL,
) -> Scores:
    """Score a submission.

    Parameters
    ----------
    submission : path, bytes, open file, or sequence of records
        The result file (plain or gzip, ``-`` for standard input), its content, or its records as
        Python objects: ``{"instr_id", "trajectory", "predObjId"}``.
    split : str
        ``train``, ``val_seen``, ``val_unseen`` or ``test``.
    ground_truth : path or GroundTruth, optional
        A bundle, or a folder of bundles. Without it, what ``REVERIE_EVAL_GROUND_TRUTH`` names,
        and failing that the synthetic demo world that ships with the package.
    protocol : str
        A name in ``PROTOCOLS``.

    Returns
    -------
    Scores
        One value per metric and episode, and their means.

    Raises
    ------
    SubmissionError
        If the submission is wrong; lists every problem with its place.
    GroundTruthError
        If there is no sound ground truth with answers for the split.
    ProtocolError
        If there is no such protocol.
    OSError
        If a file cannot be read.

    Examples
    --------
    >>> scores = evaluate("fixtures/submissions/good.json", split="val_unseen")
    >>> round(scores["success"], 2)
    0.82
    """
    rules = protocol_named(protocol)
    truth = find_ground_truth(ground_truth, split)
    facts = observe(align(read_predictions(submission), truth), truth)
    return Scores(truth, rules, episode_table(facts))


def validate(
    submission: Submission,
    *,
    split: str,
    ground_truth: str | PathLike[str] | GroundTruth | None = None,
) -> Validation:
    """Check a submission as :func:`evaluate` does, without looking at answers.

    A public bundle is enough. Parameters and errors are those of :func:`evaluate`.
    """
    truth = find_ground_truth(ground_truth, split)
    aligned = align(read_predictions(submission), truth)
    return Validation(
        ground_truth=truth,
        abstained=aligned.predicted_object == metrics.ABSTAINED,
        jumps=metrics.jumps(find_jumps(aligned, truth.graph), aligned.offsets),
    )


def episode_table(facts: Facts) -> Mapping[str, Array]:
    """Judge the facts: one read-only column per metric of the CATALOGUE, in its order."""
    success = metrics.success(facts.sees_target, facts.offsets)
    rgs = metrics.candidate_match(facts.predicted_object, facts.target_object)
    walked = metrics.path_length(facts.leg_length, facts.offsets)
    columns = {
        "path_length": walked,
        "success": success,
        "oracle_success": metrics.oracle_success(facts.sees_target, facts.offsets),
        "spl": metrics.spl(success, walked, facts.shortest_length),
        "rgs": rgs,
        "rgspl": metrics.spl(rgs, walked, facts.shortest_length),
        "navigation_error": metrics.navigation_error(facts.goal_distance, facts.offsets),
        "oracle_error": metrics.oracle_error(facts.goal_distance, facts.offsets),
        "shortest_length": facts.shortest_length,
        "steps": metrics.steps(facts.offsets),
        "jumps": metrics.jumps(facts.is_jump, facts.offsets),
    }
    return MappingProxyType(
        {key: frozen(column.astype(np.float64)) for key, column in columns.items()}
    )
