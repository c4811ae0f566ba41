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
from itertools import groupby, islice
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from hybrid.errors import HybridError
from hybrid.extras import check_extra
from hybrid.fleets.worker import LOST, UNIT, ask_each, end_children

if TYPE_CHECKING:
    from distributed import Client

_QUEUED = 4  # tasks per thread at the scheduler
_CONNECT = 30.0  # s
# A task of Dask costs some milliseconds: short units go together.
_WORTH, _MOST = 0.3, 32  # s of a task, and most units of one
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

    A job has a name, a message and a baseline, and takes no longer than ``limit``, [s].
    The module answers, see :func:`hybrid.fleets.worker.serve`.
    """
    from distributed import as_completed

    source, names, size = iter(jobs), {}, 1
    models: dict[str, Any] = {}

    def send() -> list[Any]:
        new = []
        # Jobs are sorted by arm, and those of one task have one baseline.
        for model, own in groupby(islice(source, size), key=itemgetter(2)):
            if model is not None and model not in models:
                models.clear()
                # Dask repeats a task of a lost worker, but does not scatter data again.
                models[model] = client.submit(str, model)
            those, told, _ = zip(*own, strict=True)
            question = told, models.get(model or ""), limit, module
            new.append(client.submit(ask_each, *question, pure=False, retries=2))
            names[new[-1]] = those
        return new

    most = _QUEUED * max(1, sum(client.nthreads().values()))
    first = [x for _ in range(most) for x in send()]
    running = as_completed(first, with_results=True, raise_errors=False)
    for future, result in running:
        own = names.pop(future)
        found, seconds = _answers(result, len(own))
        size = int(np.clip(_WORTH * len(own) / max(seconds, 1e-3), 1, _MOST))
        if len(names) < most:
            running.update(send())
        yield from zip(own, found, strict=True)


def _answers(result: Any, count: int) -> tuple[list[dict[str, Any]], float]:
    """Answers and seconds of a task; an error of its worker is an answer too."""
    if isinstance(result, CancelledError):
        raise result
    if isinstance(result[0], type):  # of an exception
        reason = " ".join(str(result[1]).split())
        return [{"failed": LOST, "reason": reason}] * count, np.inf
    found, seconds = result
    return found, seconds
