"""How the documentation site is built: ``scripts/docs``."""

import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.addnodes import toctree
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

from reverie_eval.version import __version__

DOCS = Path(__file__).parent
sys.path[:0] = [str(DOCS / "extensions"), str(DOCS.parent)]

project = "reverie-eval"
author = "the reverie-eval developers"
project_copyright = author
version = release = __version__

extensions = [
    "checked",
    "generated",
    "myst_nb",
    "sphinx.ext.autodoc",
    "numpydoc",
    "sphinx_copybutton",
]
exclude_patterns = ["_build"]

# Search: for who uses the package; what its developers wrote down for each other is not found.

UNSEARCHED = (
    "decisions/",
    "project/",
    *(f"explanation/{page}" for page in ("architecture", "evidence", "speed")),
)
html_search_scorer = str(DOCS / "static" / "scorer.js")


def setup(app: Sphinx) -> None:
    """Leave pages out of the search, and lead each page to all others in less time."""
    app.connect("doctree-read", _leave_out)
    app.connect("env-updated", _shorten)
    app.connect("html-page-context", _lead_by_titles, priority=0)  # before the theme asks


def _leave_out(app: Sphinx, _: nodes.document) -> None:
    if app.env.docname.startswith(UNSEARCHED):
        app.env.metadata[app.env.docname]["nosearch"] = "true"


# The theme lists the titles of all pages beside each. Sphinx copies all headings and names of the
# Python reference for that, and drops them again, which took a quarter of the time of a build.

_titles: dict[str, nodes.bullet_list] = {}
"""The contents of each page without what is below its title, but for lists of pages."""


def _shorten(_: Sphinx, env: BuildEnvironment) -> None:
    for docname, contents in env.tocs.items():
        _titles[docname] = short = contents.deepcopy()
        for entry in short.children:
            lists = [*entry.findall(toctree)]
            if lists:
                entry[1][:] = lists
            else:
                del entry[1:]


def _lead_by_titles(app: Sphinx, _: str, __: str, context: dict[str, Any], ___: object) -> None:
    whole, resolve = app.env.tocs, context["toctree"]

    def by_titles(**options: Any) -> str:
        app.env.tocs = _titles
        try:
            return resolve(**options)
        finally:
            app.env.tocs = whole

    context["toctree"] = by_titles


# Pages.

myst_enable_extensions = ["attrs_inline", "deflist"]
myst_heading_anchors = 4
myst_links_external_new_tab = False
suppress_warnings = [
    "myst.header",  # pages of the repository are included below a heading of their own
]
nb_execution_mode = "off"  # notebooks are shown with the outputs that they are stored with

# The Python reference.

autodoc_class_signature = "separated"
autodoc_default_options = {"exclude-members": "__init__, __new__"}
toc_object_entries_show_parents = "hide"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_typehints = "none"
numpydoc_show_class_members = False

# Looks. Nothing is asked of another host.

html_theme = "furo"
html_favicon = "../reverie_eval/server/http/static/icon.svg"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_js_files = [("site.js", {"defer": "defer"})]
html_copy_source = False
html_show_sourcelink = False
html_show_sphinx = False
html_use_opensearch = ""
html_theme_options = {"navigation_with_keys": False}
smartquotes = False  # which would make a dash of "--"
highlight_language = "none"  # what commands print is not Python
pygments_style = "a11y-high-contrast-light"
pygments_dark_style = "a11y-high-contrast-dark"
copybutton_prompt_text = r"\$ "
copybutton_prompt_is_regexp = True
