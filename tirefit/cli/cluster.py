"""Distribute many pieces of work over the workers of a Dask cluster.

Each piece is a task that carries all it needs, so the death of a worker costs a retry.
"""

import importlib
import logging
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from queue import Empty, SimpleQueue
from types import ModuleType
from typing import Any, NamedTuple

from tirefit.results import InputProblem, UsageError

_AHEAD = 2  # tasks at a time for each thread of a worker: one at work and one that waits

_CONNECT, _ABSENT = 30.0, 60.0
"""Seconds to wait for a scheduler and its first worker, and for lost workers to return."""

_LOCAL = {
    # A worker may die for another reason; two deaths are taken for the task's doing.
    "distributed.scheduler.allowed-failures": 1,
    # A fit needs all of its memory at once: spilling or pausing would not help it.
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.profile.enabled": False,
}
"""Settings of the workers on this machine."""


class Ended(NamedTuple):
    """Stands for the result of a piece that ended every worker that ran it alone."""

    workers: int


def _library(name: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        reason = f"--jobs and --scheduler need {name.split('.')[0]}"
        remedy = "pip install 'tirefit[cluster]'"
        problem = InputProblem(f"{reason}, which is not installed", remedy)
        raise UsageError(problem) from error


@contextmanager
def cluster(jobs: int, scheduler: str | None = None) -> Iterator[Any]:
    """Open a client of the cluster at an address, or of a new one on this machine.

    The workers of a new cluster end with the block, even in the middle of a task.

    Args:
        jobs: number of workers of a new cluster.
        scheduler: address of a running scheduler; None starts a cluster.

    Raises:
        UsageError: no ``distributed``, or no scheduler or worker at the address.
    """
    distributed = _library("distributed")
    # Its messages are for the administrator of a cluster; the errors below are for users.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    with ExitStack() as open_till_the_end:
        enter = open_till_the_end.enter_context
        if scheduler is None:
            workers = enter(_local(distributed, jobs))
            client = distributed.Client(workers, set_as_default=False)
        else:
            client = _connected(distributed, scheduler)
        open_till_the_end.callback(_closed, client)
        yield client


def _closed(client: Any) -> None:
    with suppress(TimeoutError):  # the connection is then cut
        client.close(timeout=5)


def _connected(distributed: ModuleType, address: str) -> Any:
    reason = f"no scheduler answers at {address}"
    remedy = "start one with `dask scheduler`; it prints its address"
    try:
        client = distributed.Client(address, timeout=_CONNECT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise UsageError(f"--scheduler: {reason}", remedy) from error
    try:
        client.wait_for_workers(1, timeout=_CONNECT)
    except TimeoutError:
        client.close()
        reason = f"the scheduler at {address} has no worker"
        remedy = f"start some: dask worker {address} --nthreads 1 --nworkers auto"
        raise UsageError(f"--scheduler: {reason}", remedy) from None
    return client


@contextmanager
def _local(distributed: ModuleType, jobs: int) -> Iterator[Any]:
    dask = _library("dask")
    # Idle threads of OpenBLAS keep the cores of other processes busy.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with dask.config.set(_LOCAL):
        workers = distributed.LocalCluster(
            n_workers=jobs,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        )
    try:
        yield workers
    finally:
        # Every file that they wrote is whole, so there is no need to wait for them.
        for nanny in workers.workers.values():
            nanny.auto_restart = False
            if nanny.pid is not None:
                with suppress(ProcessLookupError):
                    os.kill(nanny.pid, signal.SIGTERM)
        with suppress(TimeoutError):
            workers.close(timeout=20)


def shared(work: Callable, pieces: Sequence, client: Any) -> Generator[tuple[int, Any]]:
    """Yield (number, ``work(piece)``) of every piece, in the order of completion.

    A piece that ends its workers even when it runs alone yields :class:`Ended`. When the
    iteration stops early, or is interrupted, pieces that have not begun are cancelled.

    Args:
        work: a function that can be pickled, as its arguments and results can.
        pieces: the arguments.
        client: of :func:`cluster`.

    Raises:
        UsageError: the scheduler, or every worker, is gone.
    """
    suspects = []
    with closing(_done(work, pieces, range(len(pieces)), client)) as results:
        for number, result in results:
            if isinstance(result, Ended):
                suspects.append(number)
            else:
                yield number, result
    # A piece that waits at a worker when another piece ends it is counted as guilty too.
    for number in suspects:
        yield from _done(work, pieces, [number], client)


def _done(work, pieces, numbers, client) -> Generator[tuple[int, Any]]:
    at_work: dict[str, tuple[Any, int]] = {}  # future and number, by key of the task
    waiting, ended = deque(numbers), SimpleQueue[Any]()
    threads = _threads(client)
    try:
        while waiting or at_work:
            ahead = _AHEAD * next(threads)
            while waiting and len(at_work) < ahead:
                number = waiting.popleft()
                future = client.submit(_run, work, pieces[number], pure=False)
                at_work[future.key] = future, number
                future.add_done_callback(ended.put)
            try:
                future = ended.get(timeout=1.0)
            except Empty:
                continue
            _, number = at_work.pop(future.key)
            yield number, _result(future)
    finally:
        if at_work and client.status == "running":
            client.cancel([future for future, _ in at_work.values()], force=True)


def _threads(client) -> Iterator[int]:
    """Yield the number of threads of all workers, counted once a second.

    Raises:
        UsageError: the scheduler is gone, or no worker has been there for a minute.
    """
    counted, seen, threads = 0.0, time.monotonic(), 0
    while True:
        now = time.monotonic()
        if now - counted >= 1.0:
            if client.status != "running":
                raise _gone("the connection to the scheduler is lost")
            counted, threads = now, sum(client.nthreads().values())
            seen = now if threads else seen
            if now - seen > _ABSENT:
                raise _gone("all workers are gone")
        yield threads


def _result(future: Any) -> Any:
    try:
        return future.result()
    except _library("distributed").scheduler.KilledWorker as error:
        return Ended(error.allowed_failures + 1)
    except _library("concurrent.futures").CancelledError:
        raise _gone("the scheduler has dropped the work") from None


def _gone(reason: str) -> UsageError:
    return UsageError(reason, "start it again, then --resume")


_ALONE = threading.Lock()


def _run(work: Callable, piece: Any) -> Any:
    """``work(piece)`` in a worker, one piece at a time: output is redirected per process."""
    with _ALONE:
        return work(piece)
