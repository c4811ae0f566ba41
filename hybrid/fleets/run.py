"""Messages to workers on Dask, and answers as they come.

Workers get the location of files and give back a few rows; only the process that
started the fleet writes. Few units are with the scheduler at any time, so that its
memory does not grow with the fleet.
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
from hybrid.fleets.worker import LOST, ask, end_children

if TYPE_CHECKING:
    from distributed import Client

_WAITING = 4  # units per thread that wait at the scheduler
_CONNECT = 30.0  # s


@contextmanager
def connected(scheduler: str | None, workers: int) -> Iterator[Client]:
    """A Dask client of a cluster, or of threads here that own a process each.

    Raises:
        HybridError: Dask is not installed, or no scheduler answers.
    """
    check_extra("distributed", "fleet", "A fleet")
    from distributed import Client, LocalCluster

    try:
        if scheduler:
            with _reached(scheduler) as client:
                yield client
            return
        logging.getLogger("distributed").setLevel(logging.ERROR)
        with (
            LocalCluster(
                n_workers=1,
                threads_per_worker=workers,
                processes=False,
                dashboard_address="127.0.0.1:0",  # its server cannot be left out
            ) as cluster,
            Client(cluster) as client,
        ):
            yield client
    except (OSError, TimeoutError, CancelledError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise  # a disk's
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
    client: Client, jobs: Iterable[tuple[Any, dict[str, Any], str | None]], limit: float
) -> Iterator[tuple[Any, dict[str, Any]]]:
    """Answers to messages, in the order in which they come.

    Args:
        client: Of the cluster.
        jobs: Name, message and baseline of each.
        limit: Time that one may take, [s].

    Yields:
        Name and answer.
    """
    from distributed import as_completed

    source, names = iter(jobs), {}
    models: dict[str, Any] = {}

    def send(count: int) -> list[Any]:
        new = []
        for name, message, model in islice(source, count):
            if model is not None and model not in models:
                models.clear()  # jobs come arm by arm
                # A task is done again where a worker is lost; what is scattered is not.
                models[model] = client.submit(str, model)
            future = client.submit(
                ask, message, models.get(model or ""), limit, pure=False, retries=2
            )
            names[future] = name
            new.append(future)
        return new

    threads = max(1, sum(client.nthreads().values()))
    first = send(_WAITING * threads)
    running = as_completed(first, with_results=True, raise_errors=False)
    for future, result in running:
        running.update(send(1))
        yield names.pop(future), _answer(result)


def _answer(result: Any) -> dict[str, Any]:
    """What a unit gave; what its workers died of is an answer, too."""
    if isinstance(result, CancelledError):
        raise result
    if isinstance(result, tuple):
        _, error, _ = result
        return {"failed": LOST, "reason": " ".join(str(error).split())}
    return dict(result)
