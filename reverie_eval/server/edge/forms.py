"""In which letters a form may come: UTF-8, as browsers send it.

The framework decodes a form's fields by whatever codec the content type names, while everybody
else waits. Of Python's codecs some take minutes for a megabyte, and some are none of text.
"""

from python_multipart.multipart import parse_options_header
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from reverie_eval.server.errors import MalformedError

_MULTIPART = b"multipart/form-data"
_FORMS = frozenset({_MULTIPART, b"application/x-www-form-urlencoded"})
_UTF_8 = b"utf-8"
_NAMES_OF_UTF_8 = frozenset({_UTF_8, b"utf8", b"us-ascii"})
"""The last is a part of it."""


class FormCharsets:
    """Refuses forms in other letters, before anybody reads them."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request that is no form, or one in UTF-8.

        Raises
        ------
        MalformedError
            If its content type names another charset.
        """
        if scope["type"] == "http":
            _demand_utf_8(Headers(scope=scope))
        await self._app(scope, receive, send)


def is_multipart(headers: Headers) -> bool:
    """Whether a request is a form that may hold files."""
    return _content_type(headers)[0] == _MULTIPART


def _demand_utf_8(headers: Headers) -> None:
    media_type, options = _content_type(headers)
    if media_type in _FORMS and options.get(b"charset", _UTF_8).lower() not in _NAMES_OF_UTF_8:
        raise MalformedError(
            "the form's content type names another charset than UTF-8; leave `charset` out, and "
            "send the fields in UTF-8"
        )


def _content_type(headers: Headers) -> tuple[bytes, dict[bytes, bytes]]:
    """Return media type and parameters as the framework takes them apart; another may differ."""
    return parse_options_header(headers.get("content-type"))
