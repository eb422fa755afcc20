"""Telling a full disk from everything else that can go wrong with a store."""

import errno
import sqlite3

_FULL = {errno.ENOSPC, errno.EDQUOT}
_FULL_SQLSTATE = "53100"
"""PostgreSQL's ``disk_full``: https://www.postgresql.org/docs/current/errcodes-appendix.html"""


def is_full(error: BaseException | None) -> bool:
    """Whether an error, or what led to it, is that nothing more can be written."""
    if error is None:
        return False
    match error:
        case OSError(errno=code) if code in _FULL:
            return True
        case sqlite3.Error(sqlite_errorcode=sqlite3.SQLITE_FULL):
            return True
        case _ if getattr(error, "sqlstate", None) == _FULL_SQLSTATE:
            return True
    return is_full(error.__cause__ or error.__context__)
