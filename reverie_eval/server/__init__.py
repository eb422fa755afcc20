"""The evaluation server: scores uploads within the request and keeps what it accepted.

Imported by the commands ``serve`` and ``server`` only.
"""

import sys
from importlib.util import find_spec

from reverie_eval.errors import MissingPartError, ReverieEvalError

if sys.version_info < (3, 11):  # noqa: UP036  # the package needs 3.10
    raise ReverieEvalError("the server needs Python 3.11 or newer")
if not find_spec("fastapi"):
    raise MissingPartError("the server needs: pip install 'reverie-eval[server]'")
