"""What a server's database holds, read with SQL of our own instead of the server's code."""

import json
import sqlite3
from collections.abc import Mapping, Sequence
from contextlib import closing
from typing import Any, NamedTuple


class StoredSubmission(NamedTuple):
    """A row of submissions."""

    id: str
    team: str
    split: str
    sha256: str
    scores: Mapping[str, float]
    receipt: Mapping[str, Any]


class StoredEntry(NamedTuple):
    """A row of the audit log."""

    action: str
    subject: str
    previous: str
    digest: str


class Stored(NamedTuple):
    """Everything that an upload leaves in a database, at one moment."""

    submissions: Sequence[StoredSubmission]
    audit: Sequence[StoredEntry]
    """In the order in which it was written."""


_SUBMISSIONS = """
SELECT submission.id, team.name, split, sha256, CAST(report AS TEXT), CAST(receipt AS TEXT)
FROM submission LEFT JOIN team ON team.id = team_id
"""
_AUDIT = "SELECT action, subject, previous, digest FROM audit ORDER BY id"


def stored(url: str) -> Stored:
    """Read a database, given its URL as in a server's settings."""
    with closing(_connection(url)) as connection:
        submissions = connection.execute(_SUBMISSIONS).fetchall()
        audit = connection.execute(_AUDIT).fetchall()
    return Stored([_submission(*row) for row in submissions], [StoredEntry(*row) for row in audit])


def _connection(url: str) -> Any:
    kind, _, place = url.partition(":///")
    if kind == "sqlite":
        return sqlite3.connect(place)
    import psycopg

    return psycopg.connect(url.replace("+psycopg", ""))


def _submission(*columns: str) -> StoredSubmission:
    id_, team, split, sha256, report, receipt = columns
    scores = json.loads(report)["scores"]
    return StoredSubmission(id_, team, split, sha256, scores, json.loads(receipt))
