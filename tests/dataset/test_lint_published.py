"""Checking REVERIE v1: every known number about the released files.

Each number was first measured by other code: structure, ranges, agreement of views, distances,
targets and graphs.
"""

from itertools import chain
from pathlib import Path

import pytest

from reverie_eval.dataset import DatasetFiles, Finding, LintReport, Spread, lint_dataset
from reverie_eval.reporting.datasets import lint_printout
from tests.conftest import REPOSITORY

pytestmark = pytest.mark.dataset


@pytest.fixture(scope="module")
def report(published: Path, published_centres: Path) -> LintReport:
    """Check the published files with the centres of all objects."""
    root = published / "reverie-v1"
    return lint_dataset(DatasetFiles.find(root, object_positions=published_centres))


def count_of(report: LintReport, code: str, split: str | None) -> Finding:
    """Return the one count of that code."""
    sections = [section for section in report.sections if section.split == split]
    counts = chain.from_iterable(section.counts for section in sections)
    (count,) = [count for count in counts if count.code == code]
    return count


def spread_of(report: LintReport, code: str, split: str | None) -> Spread:
    """Return the one measurement of that code."""
    sections = [section for section in report.sections if section.split == split]
    spreads = chain.from_iterable(section.spreads for section in sections)
    (spread,) = [spread for spread in spreads if spread.code == code]
    return spread


def test_the_release_is_sound(report: LintReport) -> None:
    assert report.sound


@pytest.mark.parametrize(
    ("code", "number", "of"),
    [
        # Structure: one file per included viewpoint, one name per object.
        ("scans", 90, None),
        ("viewpoints", 10_800, None),
        ("included-viewpoints", 10_567, 10_800),
        ("viewpoints-with-boxes", 10_567, None),
        ("missing-boxes", 0, 10_567),
        ("boxes-of-excluded-viewpoint", 0, 10_567),
        ("misnamed-boxes", 0, 10_567),
        ("malformed-entry", 0, 38_293),
        ("unequal-lists", 0, 38_293),
        ("duplicate-view", 0, 38_293),
        ("unsorted-views", 0, 38_293),
        ("several-names", 0, 21_863),
        ("listed", 38_293, None),
        ("boxes", 210_198, None),
        # 2,385 empty files.
        ("listing-viewpoints", 8_182, 10_567),
        ("seeing-viewpoints", 7_009, 10_567),
        ("objects", 21_863, None),
        ("visible-objects", 17_289, 21_863),
        ("never-visible", 4_574, 21_863),
        ("listed-not-visible", 10_233, 38_293),
        ("hidden-name", 13, 64),
        ("visible", 28_060, 38_293),
        # 57 % of the visible objects from one viewpoint, 30 % from two, 9 % from three.
        ("seen-once", 9_774, 17_289),
        ("seen-twice", 5_229, 17_289),
        ("seen-thrice", 1_603, 17_289),
        ("in-all-views", 7, 28_060),
        # Ranges: always inside the image; there is no minimum size.
        ("view-out-of-range", 0, 210_198),
        ("box-without-area", 0, 210_198),
        ("box-outside", 0, 210_198),
        ("full-image", 1_184, 210_198),
        ("sliver", 3_201, 210_198),
        ("speck", 99, 28_060),
        # Neighbouring level views, both boxes not cut.
        ("edges-apart", 449, 6_215),
        ("views-disagree", 0, 6_215),
        # Objects are listed within 2 m of the camera, but for ten.
        ("measured", 38_293, 38_293),
        ("beyond-reach", 10, 38_293),
        ("beyond-success", 9, 38_293),
        # Graphs.
        ("asymmetric-edge", 0, 21_468),
        ("isolated-viewpoint", 8, 10_567),
        ("graph-in-parts", 6, 90),
    ],
)
def test_counts(code: str, number: int, of: int | None, report: LintReport) -> None:
    found = count_of(report, code, split=None).found
    assert (found.number, found.of) == (number, of)


@pytest.mark.parametrize(
    ("split", "code", "number", "of"),
    [
        ("val_seen", "items", 515, None),
        ("val_seen", "episodes", 1_423, None),
        ("val_seen", "targets", 440, None),
        ("val_seen", "target-not-listed", 0, 515),
        ("val_seen", "target-not-visible", 0, 515),
        ("val_seen", "target-at-start", 0, 515),
        ("val_seen", "unreachable-goal", 0, 515),
        ("val_seen", "path-off-edges", 0, 515),
        ("val_seen", "single-goal", 211, 515),  # 41 %
        ("val_unseen", "items", 1_328, None),
        ("val_unseen", "episodes", 3_521, None),
        ("val_unseen", "targets", 513, None),
        ("val_unseen", "target-not-listed", 0, 1_328),
        ("val_unseen", "target-not-visible", 0, 1_328),
        ("val_unseen", "target-at-start", 0, 1_328),
        ("val_unseen", "unreachable-goal", 0, 1_328),
        ("val_unseen", "path-off-edges", 0, 1_328),
        ("val_unseen", "single-goal", 496, 1_328),  # 37 %
        ("test", "items", 2_304, None),
        ("test", "episodes", 6_292, None),
        ("test", "shared-episode", 0, 6_292),
    ],
)
def test_counts_of_a_split(
    split: str, code: str, number: int, of: int | None, report: LintReport
) -> None:
    found = count_of(report, code, split).found
    assert (found.number, found.of) == (number, of)


@pytest.mark.parametrize(
    ("code", "number", "percentiles"),
    [
        ("box-left", 210_198, {"0": 0, "100": 639}),
        ("box-top", 210_198, {"0": 0, "100": 479}),
        ("box-width", 210_198, {"0": 1, "100": 640}),
        ("box-height", 210_198, {"0": 1, "100": 480}),
        ("box-right", 210_198, {"100": 640}),
        ("box-bottom", 210_198, {"100": 480}),
        ("box-area", 210_198, {"1": 33, "5": 630, "50": 21_080, "100": 307_200}),
        ("viewpoints-per-object", 17_289, {"50": 1, "100": 10}),
        ("views-per-sighting", 28_060, {"5": 4, "50": 7, "75": 9, "100": 36}),
        (
            "left-edge-agreement",
            6_215,
            {"50": 0.037, "75": 0.069, "90": 0.103, "95": 0.132, "99": 7.298},
        ),
        (
            "right-edge-agreement",
            6_215,
            {"50": 0.038, "75": 0.070, "90": 0.103, "95": 0.133, "99": 4.866},
        ),
        (
            "object-distance",
            38_293,
            {"5": 0.810, "25": 1.232, "50": 1.510, "75": 1.751, "95": 1.948, "99": 1.990}
            | {"99.9": 1.999, "100": 4.896},
        ),
        ("target-distance", 1_843, {"100": 1.999}),
        ("edge-length", 21_468, {"0": 0.000}),
    ],
)
def test_distributions(
    code: str, number: int, percentiles: dict[str, float], report: LintReport
) -> None:
    spread = spread_of(report, code, split=None)
    found = {percent: round(spread.percentiles[percent], 3) for percent in percentiles}
    assert (spread.number, found) == (number, percentiles)


def test_the_shortest_edge_is_a_fraction_of_a_millimetre_and_an_edge(report: LintReport) -> None:
    shortest = spread_of(report, "edge-length", split=None).percentiles["0"]
    assert shortest == pytest.approx(0.000175, abs=1e-6)


@pytest.mark.parametrize(
    ("split", "code", "mean", "percentiles"),
    [
        ("val_seen", "viewpoints-per-target", 1.84, {"0": 1, "100": 5}),
        ("val_seen", "views-per-target", 6.60, {"0": 1, "50": 6, "100": 23}),
        ("val_seen", "target-area", 40_172.57, {"0": 35}),
        ("val_seen", "objects-at-goal", 8.25, {"0": 2}),
        ("val_seen", "boxes-at-goal", 53.30, {"0": 3}),
        ("val_unseen", "viewpoints-per-target", 1.98, {"0": 1, "100": 6}),
        ("val_unseen", "views-per-target", 7.46, {"0": 2, "50": 7, "100": 22}),
        ("val_unseen", "target-area", 56_138.52, {"0": 459}),
        ("val_unseen", "objects-at-goal", 7.30, {"0": 1}),
        ("val_unseen", "boxes-at-goal", 53.83, {"0": 8}),
    ],
)
def test_distributions_of_a_split(
    split: str, code: str, mean: float, percentiles: dict[str, float], report: LintReport
) -> None:
    spread = spread_of(report, code, split)
    assert round(spread.mean or 0, 2) == mean
    assert {percent: spread.percentiles[percent] for percent in percentiles} == percentiles


def test_graphs_in_parts(report: LintReport) -> None:
    assert count_of(report, "graph-in-parts", split=None).found.examples == (
        "B6ByNegPMKs in 4",
        "JF19kD82Mey in 2",
        "PuKPg4mmafe in 2",
        "SN83YJsR3w2 in 2",
        "q9vSo1VnCiC in 2",
        "r1Q1Z4BcV1o in 2",
    )


def test_objects_beyond_reach(report: LintReport) -> None:
    examples = count_of(report, "beyond-reach", split=None).found.examples
    assert sorted(float(example.split()[-2]) for example in examples) == [
        *(2.01, 3.13, 3.33, 3.56, 3.67, 3.69, 4.01, 4.11, 4.27, 4.90)
    ]
    assert len({example.split()[0] for example in examples}) == 4


def test_names_that_are_mostly_not_visible(report: LintReport) -> None:
    """Shower walls 92 %, refrigerators 90, columns 87, curtains 83, ... windows 55."""
    assert count_of(report, "hidden-name", split=None).found.examples == (
        "shower wall: 228 of 248",
        "refrigerator: 100 of 111",
        "column: 237 of 271",
        "curtain: 728 of 874",
        "pillar: 164 of 204",
        "bookshelf: 81 of 107",
        "stair: 268 of 364",
        "fireplace: 109 of 165",
        "bed: 245 of 376",
        "shelves: 73 of 116",
        "window frame: 319 of 556",
        "window: 1163 of 2110",
        "kitchen cabinet: 177 of 352",
    )


def test_the_documented_tables_are_those_that_are_printed(report: LintReport) -> None:
    page = REPOSITORY / "docs" / "reference" / "reverie-v1-lint.txt"
    assert page.read_text() == f"{lint_printout(report).text('text')}\n"
