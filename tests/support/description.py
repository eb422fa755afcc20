"""Holding what a server replies against what it says of itself."""

import re
from collections.abc import Iterator
from typing import Any, ClassVar

import httpx
from jsonschema import Draft202012Validator, FormatChecker

from tests.support.serving import Serving

API = "/api/v1"


class Description:
    """The OpenAPI document of a server."""

    _documents: ClassVar[dict[str, dict[str, Any]]] = {}
    """By the title, which alone differs between servers: FastAPI takes long to write one."""

    def __init__(self, server: Serving) -> None:
        title = server.state.settings.title
        if title not in self._documents:
            self._documents[title] = server.ask(None, "GET", "/openapi.json").json()
        self.document = self._documents[title]

    def operations(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """Return every operation, by its method and path below the API's."""
        for path, operations in self.document["paths"].items():
            for method, operation in operations.items():
                yield f"{method.upper()} {path.removeprefix(API)}", operation

    def check(self, reply: httpx.Response) -> None:
        """Fail unless the document tells of such a reply: its status, its form, its content."""
        declared = self._operation(reply.request)["responses"]
        assert str(reply.status_code) in declared, reply.text
        content = declared[str(reply.status_code)].get("content")
        if content is None:
            assert reply.content == b""
            return
        media_type = reply.headers["content-type"].partition(";")[0]
        assert media_type in content
        if media_type.endswith("json"):
            self.check_value(content[media_type].get("schema", {}), reply.json())

    def check_value(self, schema: dict[str, Any], value: Any) -> None:
        """Fail unless a value is of a schema of the document."""
        whole = {**schema, "components": self.document["components"]}
        Draft202012Validator(whole, format_checker=FormatChecker()).validate(value)

    def _operation(self, request: httpx.Request) -> dict[str, Any]:
        for path, operations in self.document["paths"].items():
            pattern = re.sub(r"\\{\w+\\}", "[^/]+", re.escape(path))
            if re.fullmatch(pattern, request.url.path):
                operation: dict[str, Any] = operations[request.method.lower()]
                return operation
        raise AssertionError(f"{request.url.path} is not described")
