"""List the versions of the documentation site: ``scripts/docs`` does.

::

    SITE/versions.js   the pages of each version, which `static/site.js` makes its menu from
    SITE/index.html    leads to the newest release
    SITE/latest/       the working copy
    SITE/0.1.0/        a release, as it was built when it was made

The list is a script, because a page that is opened as a file may not read JSON.
"""

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from packaging.version import Version

_LATEST = "latest"
_REDIRECT = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<title>reverie-eval</title>
<meta http-equiv="refresh" content="0; url={name}/index.html">
<a href="{name}/index.html">reverie-eval {name}</a>
</html>
"""


def list_versions(site: Path) -> None:
    """Write the list of a site's versions, and the page that leads to the newest release."""
    pages = _pages(site)
    (site / "versions.js").write_text(f"window.siteVersions = {json.dumps(pages)};\n")
    newest = next((name for name in pages if name != _LATEST), _LATEST)
    (site / "index.html").write_text(_REDIRECT.format(name=newest))


def _pages(site: Path) -> Mapping[str, Sequence[str]]:
    """Return the pages of each version: of the working copy, then of releases from the newest."""
    names = {path.parent.name for path in site.glob("*/objects.inv")}
    releases = sorted(names - {_LATEST}, key=Version, reverse=True)
    return {
        name: sorted(
            path.relative_to(site / name).as_posix() for path in (site / name).rglob("*.html")
        )
        for name in (*(names & {_LATEST}), *releases)
    }


if __name__ == "__main__":
    list_versions(Path(sys.argv[1]))
