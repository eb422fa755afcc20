"""What may run functions elsewhere: threads, something that pickles, and a cluster of Dask."""

import pickle
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any

from reverie_eval.scoring import Executor


class Pickling:
    """Runs a function here, after all of it has gone through pickle, as to another machine."""

    def __init__(self) -> None:
        self.calls = 0

    def submit(self, function: Any, argument: Any, /) -> Any:
        """Run it, and return what is done already."""
        self.calls += 1
        sent, given = pickle.loads(pickle.dumps((function, argument)))
        done: Future[Any] = Future()
        done.set_result(pickle.loads(pickle.dumps(sent(given))))
        return done


@contextmanager
def _cluster() -> Iterator[Executor]:
    from distributed import Client, LocalCluster  # takes long, in every process of the suite

    with (
        LocalCluster(n_workers=1, processes=False, dashboard_address=None) as cluster,  # type: ignore[no-untyped-call]
        Client(cluster) as client,  # type: ignore[no-untyped-call]
    ):
        yield client


EXECUTORS: Mapping[str, Callable[[], AbstractContextManager[Any]]] = {
    "threads": lambda: ThreadPoolExecutor(2),
    "pickle": lambda: nullcontext(Pickling()),
    "dask": _cluster,
}
