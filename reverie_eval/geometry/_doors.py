"""Openings in walls: doors where somebody can walk, and walls that would mostly be doors."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from reverie_eval.arrays import FloatArray

DOOR_WIDTH = 0.9
"""Metres."""
# Metres beside a door within which another way needs none of its own, and the least metres of a
# wall between two doors, or of one that stands free.
_BESIDE, _POST = 0.25, 1.3
# A wall between rooms is left out if several doors take this share of it, or if a single one leaves
# so few metres of it.
_MOSTLY, _LEFT = 0.5, 0.6


class Border(NamedTuple):
    """A straight wall between two rooms, or between one and the outside."""

    axis: int
    """The axis that it crosses."""
    line: float
    """Where it does, metres."""
    low: float
    """Where it begins along the other axis, metres."""
    high: float
    """Where it ends."""
    is_inner: bool
    """Whether a room is on both sides."""

    def ends(self, span: tuple[float, float]) -> FloatArray:
        """Return the ends of a part of it, shape (2, 2)."""
        found = np.full((2, 2), self.line)
        found[:, 1 - self.axis] = span
        return found


def openings(borders: Sequence[Border], legs: FloatArray) -> Iterator[FloatArray]:
    """Yield the ends of the openings that legs of shape (n, 2, 2) need in walls, shape (2, 2).

    What is left of inner walls between openings is open too if it is short and touches no other.
    Walls come in the order of their lines, and along these.
    """
    standing: list[Border] = []
    for border in borders:
        spans = _spans(border, _passed(border, legs))
        yield from map(border.ends, spans)
        marks = [border.low, *(mark for span in spans for mark in span), border.high]
        for low, high in zip(marks[::2], marks[1::2], strict=True):
            piece = border._replace(low=low, high=high)
            if standing and standing[-1][:2] == piece[:2] and standing[-1].high == low:
                before = standing.pop()
                is_inner = before.is_inner and piece.is_inner
                piece = piece._replace(low=before.low, is_inner=is_inner)
            if piece.low < high:
                standing.append(piece)
    for piece in standing:
        if piece.is_inner and piece.high - piece.low < _POST and not _is_held(piece, standing):
            yield piece.ends((piece.low, piece.high))


def _passed(border: Border, legs: FloatArray) -> FloatArray:
    """Return where legs pass a wall, ascending."""
    axis, other = border.axis, 1 - border.axis
    is_across = (legs[:, 0, axis] < border.line) != (legs[:, 1, axis] < border.line)
    start, end = np.moveaxis(legs[is_across & (legs[..., axis] != border.line).all(axis=1)], 1, 0)
    share = (border.line - start[:, axis]) / (end - start)[:, axis]
    at = start[:, other] + share * (end - start)[:, other]
    return np.sort(at[(at > border.low) & (at <= border.high)])


def _spans(border: Border, passed: FloatArray) -> Sequence[tuple[float, float]]:
    """Return the openings of a wall, from the first to the last; each is within the wall."""
    low, high, half = border.low, border.high, DOOR_WIDTH / 2
    found: list[tuple[float, float]] = []
    for at in passed.tolist():
        if found and at <= found[-1][1] + _BESIDE:
            continue
        middle = min(max(at, low + half), max(high - half, (low + high) / 2))
        begin, end = max(middle - half, low), min(middle + half, high)
        if found and begin - found[-1][1] < _POST:
            begin, _ = found.pop()
        found.append((begin, end))
    width, length = sum(end - begin for begin, end in found), high - low
    is_open = width >= _MOSTLY * length if width > DOOR_WIDTH else length - width < _LEFT
    return [(low, high)] if found and border.is_inner and is_open else found


def _is_held(piece: Border, standing: Sequence[Border]) -> bool:
    """Whether a wall across it touches one of its ends."""
    return any(
        wall.line in (piece.low, piece.high) and wall.low <= piece.line <= wall.high
        for wall in standing
        if wall.axis != piece.axis
    )
