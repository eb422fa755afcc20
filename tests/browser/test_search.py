"""A newcomer's searches of the documentation lead to the right page."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page

from tests.conftest import REPOSITORY, unavailable
from tests.support.browser import new_page

pytestmark = pytest.mark.browser
SITE = REPOSITORY / "build" / "docs" / "latest"
"""Where `scripts/docs` builds the site; in CI, before the tests."""
FOUND = """
query => {
  document.querySelector('input[name="q"]').value = query
  return Search._performSearch(...Search._parseQuery(query)).reverse().map(([page]) => page)
}
"""
"""What the search page does, which shows the last one first."""
SEARCHES = {
    "install": "how-to/install",
    "score a file": "tutorials/score",
    "submission format": "reference/submission-format",
    "rejected": "reference/submission-format",
    "RGSPL": "reference/metrics",
    "protocol": "reference/protocols",
    "number differs from paper": "explanation/why-numbers-differ",
    "confidence interval": "how-to/uncertainty",
    "significant difference": "how-to/uncertainty",
    "compare two methods": "how-to/uncertainty",
    "training loop": "how-to/training",
    "wandb": "how-to/training",
    "slurm": "how-to/cluster",
    "cite": "how-to/cite",
    "failure modes": "how-to/report",
    "figure": "how-to/report",
    "language model": "how-to/chat",
    "MatterSim": "how-to/simulator",
    "run a server": "tutorials/server",
    "leaderboard": "tutorials/submit",
}


@pytest.fixture(scope="module")
def page(browser: Browser) -> Iterator[Page]:
    """Open a page in which the site is searched."""
    if not (SITE / "search.html").exists():
        unavailable("the site is not built: scripts/docs")
    page = new_page(browser)
    page.goto((SITE / "search.html").as_uri())
    page.wait_for_function("Search.hasIndex()")
    yield page
    page.close()


@pytest.mark.parametrize(("query", "right"), SEARCHES.items(), ids=SEARCHES)
def test_a_search_finds_the_right_page(query: str, right: str, page: Page) -> None:
    assert right in page.evaluate(FOUND, query)[:3]


@pytest.mark.parametrize("query", ["decision", "evidence", "Ed25519", "parsers"])
def test_what_developers_wrote_for_each_other_is_not_found(query: str, page: Page) -> None:
    internal = [f"explanation/{each}" for each in ("architecture", "evidence", "speed")]
    left_out = ("decisions/", "project/", *internal)
    assert [each for each in page.evaluate(FOUND, query) if each.startswith(left_out)] == []
