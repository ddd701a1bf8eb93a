"""The workers of a Dask cluster, and the work that they share.

Each piece is a task that carries all it needs: Dask repeats the tasks of a worker that died.
"""

import logging
import os
import signal
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from itertools import islice
from typing import Any, NamedTuple

from tirefit.results import InputProblem, UsageError

_CONNECT = 30.0  # seconds to wait for a scheduler and its first worker

_LOCAL = {
    # A worker may die for another reason: a task is given up when two died while it ran.
    "distributed.scheduler.allowed-failures": 1,
    # Without any worker for so long, the tasks fail instead of waiting.
    "distributed.scheduler.no-workers-timeout": "60s",
    # A fit needs all of its memory at once: spilling or pausing would not help it.
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.profile.enabled": False,
}
"""Settings of the workers on this machine."""


class Ended(NamedTuple):
    """Stands for the result of a piece that ended every worker that ran it."""

    workers: int


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
        import distributed
    except ImportError as error:
        reason = "--jobs and --scheduler need distributed, which is not installed"
        raise UsageError(InputProblem(reason, "pip install 'tirefit[cluster]'")) from error
    # Its messages are for the administrator of a cluster; the errors below are for users.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    if scheduler is not None:
        with _connected(scheduler) as client:
            yield client
        return
    # Idle threads of OpenBLAS keep the cores of other processes busy.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with dask.config.set(_LOCAL):
        workers = distributed.LocalCluster(
            n_workers=jobs,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        )
    try:
        with distributed.Client(workers, set_as_default=False) as client:
            yield client
    finally:
        # Every file that they wrote is whole, so there is no need to wait for them.
        for nanny in workers.workers.values():
            nanny.auto_restart = False
            if nanny.pid is not None:
                with suppress(ProcessLookupError):
                    os.kill(nanny.pid, signal.SIGTERM)
        with suppress(TimeoutError):
            workers.close(timeout=20)


def _connected(address: str) -> Any:
    from distributed import Client

    try:
        client = Client(address, timeout=_CONNECT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        reason = f"--scheduler: no scheduler answers at {address}"
        remedy = "start one with `dask scheduler`; it prints its address"
        raise UsageError(reason, remedy) from error
    try:
        client.wait_for_workers(1, timeout=_CONNECT)
    except TimeoutError:
        client.close()
        reason = f"--scheduler: the scheduler at {address} has no worker"
        remedy = f"start some: dask worker {address} --nthreads 1 --nworkers auto"
        raise UsageError(reason, remedy) from None
    return client


def shared(work: Callable, pieces: Sequence, client: Any) -> Generator[tuple[int, Any]]:
    """Yield (number, ``work(piece)``) of every piece, in the order of completion.

    A piece that ends its workers again and again yields :class:`Ended`. When the iteration
    stops early, or is interrupted, pieces that have not begun are cancelled.

    Args:
        work: a function that can be pickled, as its arguments and results can.
        pieces: the arguments.
        client: of :func:`cluster`.

    Raises:
        UsageError: the scheduler, or every worker, is gone.
    """
    from distributed import as_completed
    from distributed.scheduler import KilledWorker, NoValidWorkerError, NoWorkerError

    waiting, running, numbers = enumerate(pieces), as_completed(loop=client.loop), dict[Any, int]()

    def submit() -> None:
        """Submit a piece for each free thread, and one if none is at work.

        A piece that waited at a worker would count as a cause of its death.
        """
        room = sum(client.nthreads().values()) - len(numbers)
        for number, piece in islice(waiting, max(room, not numbers)):
            future = client.submit(work, piece, pure=False)
            numbers[future] = number
            running.add(future)

    try:
        submit()
        for future in running:
            number = numbers.pop(future)
            try:
                result = future.result()
            except KilledWorker as error:
                result = Ended(error.allowed_failures + 1)
            submit()
            yield number, result
    except (CancelledError, NoWorkerError, NoValidWorkerError) as error:
        lost = "connection to the scheduler is lost"
        reason = lost if isinstance(error, CancelledError) else "workers are all gone"
        raise UsageError(f"the {reason}", "start it again, then --resume") from None
    finally:
        if numbers and client.status == "running":
            client.cancel(list(numbers), force=True)
