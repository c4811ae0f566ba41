"""Distribution of units to Dask workers.

Workers receive paths of files and return a few rows; only the process that started the
fleet writes. The scheduler has few units at any time, so its memory does not grow with
the fleet.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from itertools import islice
from typing import TYPE_CHECKING, Any

from hybrid.errors import HybridError
from hybrid.extras import check_extra
from hybrid.fleets.worker import LOST, UNIT, ask, end_children

if TYPE_CHECKING:
    from distributed import Client

_QUEUED = 4  # units per thread at the scheduler
_CONNECT = 30.0  # s
# What a local cluster does beside its work takes a share of a core, busy or not:
# samples of stacks each 10 ms, ticks each 20 ms, the state of the machine each 0.5 s.
_QUIET = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
}


@contextmanager
def connected(scheduler: str | None, workers: int) -> Iterator[Client]:
    """A Dask client of a cluster, or of local threads that own a process each.

    Raises:
        HybridError: Dask or pyarrow is not installed, or no scheduler answers.
    """
    for library in ("distributed", "pyarrow"):
        check_extra(library, "fleet", "A fleet")
    import dask
    from distributed import Client, LocalCluster

    try:
        if scheduler:
            with _reached(scheduler) as client:
                yield client
            return
        logging.getLogger("distributed").setLevel(logging.ERROR)
        with (
            dask.config.set(_QUIET),
            LocalCluster(
                n_workers=1,
                threads_per_worker=workers,
                processes=False,
                dashboard_address="127.0.0.1:0",  # the server cannot be switched off
            ) as cluster,
            Client(cluster) as client,
        ):
            yield client
    except (OSError, TimeoutError, CancelledError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise  # an error of the disk
        raise HybridError(
            f"scheduler {scheduler or 'here'}: lost ({type(error).__name__}); results "
            "up to now are stored, the same command goes on from there"
        ) from error
    finally:
        end_children()


def _reached(scheduler: str) -> Client:
    from distributed import Client

    try:
        return Client(scheduler, timeout=_CONNECT)
    except ValueError as error:
        raise HybridError(
            f"scheduler {scheduler}: valid is an address as tcp://10.0.0.1:8786 "
            f"({error})"
        ) from error


def answers(
    client: Client,
    jobs: Iterable[tuple[Any, dict[str, Any], str | None]],
    limit: float,
    module: str = UNIT,
) -> Iterator[tuple[Any, dict[str, Any]]]:
    """Send messages to the workers, and yield name and answer as they arrive.

    Args:
        client: Client of the cluster.
        jobs: Name, message and baseline of each job.
        limit: Longest time for one job, [s].
        module: Module that answers, see :func:`hybrid.fleets.serving.serve`.
    """
    from distributed import as_completed

    source, names = iter(jobs), {}
    models: dict[str, Any] = {}

    def send(count: int) -> list[Any]:
        new = []
        for name, message, model in islice(source, count):
            if model is not None and model not in models:
                models.clear()  # jobs are sorted by arm
                # Dask repeats a task of a lost worker, but does not scatter data again.
                models[model] = client.submit(str, model)
            question = message, models.get(model or ""), limit, module
            future = client.submit(ask, *question, pure=False, retries=2)
            names[future] = name
            new.append(future)
        return new

    threads = max(1, sum(client.nthreads().values()))
    first = send(_QUEUED * threads)
    running = as_completed(first, with_results=True, raise_errors=False)
    for future, result in running:
        running.update(send(1))
        yield names.pop(future), _answer(result)


def _answer(result: Any) -> dict[str, Any]:
    """The answer of a unit; an error of its worker is an answer too."""
    if isinstance(result, CancelledError):
        raise result
    if isinstance(result, tuple):
        _, error, _ = result
        return {"failed": LOST, "reason": " ".join(str(error).split())}
    return dict(result)
