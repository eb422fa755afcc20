"""The client of an evaluation server: ``Client(url, token).submit(...)``."""

from reverie_eval.errors import naming_missing_parts
from reverie_eval.schemas.service import Method, SubmissionChange

with naming_missing_parts():
    from reverie_eval.client._client import Client
    from reverie_eval.client.sending import (
        NotAServerError,
        QuotaSpentError,
        RefusedError,
        ServiceError,
        UnreachableError,
    )

__all__ = [
    "Client",
    "Method",
    "NotAServerError",
    "QuotaSpentError",
    "RefusedError",
    "ServiceError",
    "SubmissionChange",
    "UnreachableError",
]
