"""The workers of a Dask cluster, and the work that they share.

Each piece is a task that carries all it needs. Dask runs it again, on another worker, if the
worker that had it died; it gives the task up after four deaths.
"""

import logging
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from itertools import count
from typing import Any

from tirefit.results import InputProblem, UsageError

_CONNECT = 30.0  # seconds to wait for a scheduler and its first worker

_LOCAL = {
    # Other tasks wait at the scheduler, not at a worker, whose death would fail them too.
    "distributed.scheduler.worker-saturation": 1.0,
    # Without any worker for so long, the tasks fail instead of waiting. On a machine with
    # six times as many busy processes as cores, a worker was restarted in 10 s.
    "distributed.scheduler.no-workers-timeout": "300s",
    # A worker's nanny restarts it. Dask would end the nanny if the worker had died and was
    # just restarting so long after an earlier death, 15 s by default.
    "distributed.deploy.lost-worker-timeout": "1 day",
    # A fit needs all of its memory at once: spilling or pausing would not help it.
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.profile.enabled": False,
}
"""Settings of the workers on this machine."""


@contextmanager
def cluster(jobs: int, scheduler: str | None = None) -> Iterator[Any]:
    """Open a client of the cluster at an address, or of a new one on this machine.

    Args:
        jobs: number of workers of a new cluster, which end with the block.
        scheduler: address of a running scheduler; None starts a cluster.

    Raises:
        UsageError: no ``distributed``, or no scheduler or worker at the address.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError as error:
        reason = "--jobs and --scheduler need distributed, which is not installed"
        raise UsageError(InputProblem(reason, "pip install 'tirefit[cluster]'")) from error
    # Its messages are for the administrator of a cluster; the errors below are for users.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    if scheduler is not None:
        with _connected(scheduler) as client:
            yield client
        return
    with (
        dask.config.set(_LOCAL),
        LocalCluster(
            n_workers=jobs,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        ) as workers,
        Client(workers, set_as_default=False) as client,
    ):
        yield client


def _connected(address: str) -> Any:
    from distributed import Client

    remedy = "start one with `dask scheduler`; it prints its address"
    try:
        client = Client(address, timeout=_CONNECT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise UsageError(f"--scheduler: no scheduler answers at {address}", remedy) from error
    try:
        client.wait_for_workers(1, timeout=_CONNECT)
    except TimeoutError:
        client.close()
        reason = f"--scheduler: the scheduler at {address} has no worker"
        remedy = f"start some: dask worker {address} --nthreads 1 --nworkers auto"
        raise UsageError(reason, remedy) from None
    return client


def shared(
    work: Callable[..., Any], pieces: Sequence[Any], client: Any
) -> Generator[tuple[int, Any]]:
    """Yield (number, ``work(piece)``) of every piece, in the order of completion; None of one
    whose workers died.

    When the iteration stops early, or is interrupted, pieces that have not begun are cancelled.

    Args:
        work: a function that can be pickled, as its arguments and results can; it never
            returns None.
        pieces: the arguments.
        client: of :func:`cluster`.

    Raises:
        UsageError: the scheduler, or every worker, is gone.
    """
    from distributed import as_completed
    from distributed.scheduler import KilledWorker, NoValidWorkerError, NoWorkerError

    futures: dict[Any, int] = {}
    try:
        futures = dict(zip(client.map(work, pieces, pure=False), count()))
        for future in as_completed(list(futures), loop=client.loop):
            number = futures.pop(future)
            try:
                result = future.result()
            except KilledWorker:
                result = None
            yield number, result
    except (CancelledError, NoWorkerError, NoValidWorkerError) as error:
        lost = "connection to the scheduler is lost"
        reason = lost if isinstance(error, CancelledError) else "workers are all gone"
        raise UsageError(f"the {reason}", "start it again, then --resume") from None
    finally:
        if futures and client.status == "running":
            client.cancel(list(futures), force=True)
