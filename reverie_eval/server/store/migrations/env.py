"""Runs migrations in the connection that :mod:`reverie_eval.server.store.database` gives."""

from typing import Any, Literal

from alembic import context

from reverie_eval.server.store.tables import Base, UtcDateTime


def _plain(kind: str, item: Any, _: Any) -> str | Literal[False]:
    """Write our types as what they are in the database: migrations do not change with them."""
    is_instant = kind == "type" and isinstance(item, UtcDateTime)
    return "sa.DateTime(timezone=True)" if is_instant else False


context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=Base.metadata,
    render_as_batch=True,
    render_item=_plain,
)
with context.begin_transaction():
    context.run_migrations()
