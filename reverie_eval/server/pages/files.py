"""Styles and scripts, at addresses under which they never change."""

from starlette.responses import Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

SHELVES = (
    ("reverie_eval.server.pages", "static"),
    ("reverie_eval.reporting", "resources/shared"),
)
"""Packages with the folders in them where the files are; the second has what reports use too."""
_FOR_A_YEAR = "public, max-age=31536000, immutable"


class StaticPages(StaticFiles):
    """Serves the package's files; browsers keep them."""

    def __init__(self) -> None:
        super().__init__(packages=[*SHELVES])

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Return a file, to be kept if its address names its content."""
        reply = await super().get_response(path, scope)
        if scope["query_string"]:
            reply.headers["Cache-Control"] = _FOR_A_YEAR
        return reply
