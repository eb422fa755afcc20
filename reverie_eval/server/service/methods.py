"""What a submission says of its method."""

from collections.abc import Collection

from reverie_eval.schemas.service import Method
from reverie_eval.server.errors import MalformedError


def demand_metadata(method: Method, required: Collection[str]) -> None:
    """Make sure that everything is said that the organiser asks for.

    Raises
    ------
    MalformedError
        Naming what is missing.
    """
    said = {name for name in method.model_fields_set if getattr(method, name) not in {"", None}}
    missing = [name for name in required if name not in said]
    if missing:
        raise MalformedError(f"the organiser asks for more on the method: {', '.join(missing)}")
