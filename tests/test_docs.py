"""The documentation says what the code does."""

import re
from pathlib import Path

import pytest

from reverie_eval import CATALOGUE, evaluate
from reverie_eval.metrics import Metric
from reverie_eval.reporting.tables import plain
from tests.conftest import REPOSITORY, SAMPLES

DOCS = REPOSITORY / "docs"


def codes_in(*sources: Path) -> set[str]:
    """Collect the codes of problems that are built in source files."""
    pattern = re.compile(r'(?:_in_\w+|_report|report|Problem)\(\s*(?:sources,\s*)?"([a-z-]+)"')
    return {code for source in sources for code in pattern.findall(source.read_text())}


def codes_documented(page: str) -> set[str]:
    """Collect the codes that a page's table explains."""
    table = (DOCS / page).read_text().partition("| code |")[2]
    return set(re.findall(r"^\| `([a-z-]+)` \|", table, re.MULTILINE))


def test_readme_shows_the_score_table_as_it_is_printed() -> None:
    scores = evaluate(SAMPLES / "good.json", split="val_unseen")
    assert f"```\n{plain(scores)}\n```" in (REPOSITORY / "README.md").read_text()


@pytest.mark.parametrize("metric", CATALOGUE.values(), ids=list(CATALOGUE))
def test_every_metric_is_documented_in_the_catalogue_s_words(metric: Metric) -> None:
    cells = (f"`{metric.key}`", metric.label, metric.unit, metric.better, metric.definition)
    assert f"| {' | '.join(cells)} |" in (DOCS / "metrics.md").read_text()


def test_every_problem_of_a_submission_is_documented() -> None:
    built = codes_in(REPOSITORY / "reverie_eval" / "reading" / "problems.py")
    assert built == codes_documented("submission-format.md")


def test_every_problem_of_a_dataset_is_documented() -> None:
    built = codes_in(*(REPOSITORY / "reverie_eval" / "ground_truth").glob("*.py"))
    assert built == codes_documented("ground-truth.md")


@pytest.mark.parametrize("page", sorted(DOCS.rglob("*.md")), ids=lambda page: page.name)
def test_links_between_pages_lead_somewhere(page: Path) -> None:
    targets = re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text())
    assert [target for target in targets if not (page.parent / target).exists()] == []
