"""What a server does by itself, beside answering requests."""

import logging

from anyio import sleep
from anyio.to_thread import run_sync

from reverie_eval.server.state import ServerState

LOGGER = logging.getLogger("reverie_eval.server")

SECONDS_BETWEEN = 60


async def take_snapshots(server: ServerState) -> None:
    """Take the snapshots of phases that have ended, each minute, until it is cancelled.

    Every worker does so; the first one takes them. Whatever fails is tried again.
    """
    while True:
        try:
            await run_sync(server.snapshots.take_if_due, server.transactions)
        except Exception:
            LOGGER.exception("a snapshot could not be taken")
        await sleep(SECONDS_BETWEEN)
