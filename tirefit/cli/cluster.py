"""Distribute many pieces of work to the workers of a Dask cluster.

A task is a batch of similar pieces, which share compiled programs, and takes a few
seconds, so that neither the time of the scheduler per task nor the loss of a worker costs
much. A task contains all its data, and few tasks wait at a worker, so a worker that dies
costs a retry of its batch. If the workers of a batch die again, its pieces run one by one
at the end, while nothing else runs: a piece whose workers then die is the cause.
"""

import importlib
import logging
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Hashable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from queue import Empty, SimpleQueue
from types import ModuleType
from typing import Any, NamedTuple

from tirefit.results import InputProblem, UsageError

_BATCH, _RATE = 5.0, 100.0
"""Smallest duration [s] of a batch of several pieces, and largest number of batches per
second of all workers; one costs scheduler and client 4 ms."""

_AHEAD = 2  # batches for each worker at a time: one running and one waiting

_CONNECT, _ABSENT = 30.0, 60.0
"""Seconds to wait for a scheduler and its first worker, and for lost workers to return."""

_LOCAL = {
    # A worker may die for another reason; after two deaths the batch is the suspect.
    "distributed.scheduler.allowed-failures": 1,
    # Fits may use much memory; end a worker only if the machine is in danger.
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.profile.enabled": False,
}
"""How the workers of this machine are run."""


class Ended(NamedTuple):
    """Result of a piece that ended all its workers; their number."""

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
    """A client of the cluster at an address, or of a number of workers on this machine.

    Workers of this machine end with the block, even while they run.

    Raises:
        UsageError: no ``distributed``, or no scheduler or worker at the address.
    """
    distributed = _library("distributed")
    # Messages of distributed are for operators of a cluster; relevant ones are here.
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
    # Waiting threads of OpenBLAS would spin on the cores of the other processes.
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
        # The files that they have written are complete, so do not wait for them.
        for nanny in workers.workers.values():
            nanny.auto_restart = False
            if nanny.pid is not None:
                with suppress(ProcessLookupError):
                    os.kill(nanny.pid, signal.SIGTERM)
        with suppress(TimeoutError):
            workers.close(timeout=20)


def shared(
    work: Callable, pieces: Sequence, client: Any, alike: Callable[[Any], Hashable] = lambda _: None
) -> Generator[tuple[int, Any], None, None]:
    """(number, ``work(piece)``) of every piece, in the order of completion.

    The result of a piece whose workers die when it runs alone is :class:`Ended`. If the
    iteration stops early, also by an interrupt, tasks that have not begun are cancelled.

    Args:
        work: a function that can be pickled, as the pieces and results can.
        client: from :func:`cluster`.
        alike: the pieces of a batch have the same of this.

    Raises:
        UsageError: the scheduler, or every worker, is gone.
    """
    yield from _Sharing(work, pieces, client, alike).results()


class _Batch(NamedTuple):
    future: Any
    numbers: list[int]
    alone: bool


class _Sharing:
    """Pieces by their numbers: ``waiting`` by kind, ``suspects`` that must run alone, and
    those ``at_work`` by the key of their task."""

    def __init__(self, work, pieces, client, alike):
        self.work, self.pieces, self.client = work, pieces, client
        self.waiting: dict[Hashable, deque[int]] = {}
        for number, piece in enumerate(pieces):
            self.waiting.setdefault(alike(piece), deque()).append(number)
        self.suspects: deque[int] = deque()
        self.at_work: dict[str, _Batch] = {}
        self.ended: SimpleQueue[Any] = SimpleQueue()
        self.seconds: float | None = None  # duration of a piece
        self.counted, self.threads, self.seen = 0.0, 1, time.monotonic()

    def results(self) -> Generator[tuple[int, Any], None, None]:
        try:
            while self.waiting or self.suspects or self.at_work:
                self._count_workers()
                self._give()
                with suppress(Empty):
                    yield from self._answers(self.ended.get(timeout=1.0))
        finally:
            left = [batch.future for batch in self.at_work.values()]
            if left and self.client.status == "running":
                self.client.cancel(left, force=True)

    def _count_workers(self) -> None:
        """Number of threads of the workers, updated from time to time."""
        now = time.monotonic()
        if now - self.counted < 1.0:
            return
        if self.client.status != "running":
            raise _gone("the connection to the scheduler is lost")
        self.counted, self.threads = now, sum(self.client.nthreads().values())
        self.seen = now if self.threads else self.seen
        if now - self.seen > _ABSENT:
            raise _gone("all workers are gone")

    def _give(self) -> None:
        """Submit batches to idle workers; a suspect if all other pieces are done.

        A piece that waits behind one that kills its worker is a suspect as well.
        """
        while self.waiting and len(self.at_work) < _AHEAD * self.threads:
            self._submit(self._next_batch(), alone=False)
        if self.suspects and not self.waiting and not self.at_work:
            self._submit([self.suspects.popleft()], alone=True)

    def _next_batch(self) -> list[int]:
        kind = min(self.waiting, key=lambda kind: self.waiting[kind][0])
        same, size = self.waiting[kind], 1
        if self.seconds is not None:
            left = sum(map(len, self.waiting.values()))
            fair = left // (_AHEAD * max(self.threads, 1))
            long = max(_BATCH, self.threads / _RATE)
            size = max(1, min(fair, int(long / max(self.seconds, 1e-3))))
        numbers = [same.popleft() for _ in range(min(size, len(same)))]
        if not same:
            del self.waiting[kind]
        return numbers

    def _submit(self, numbers: list[int], alone: bool) -> None:
        future = self.client.submit(
            _batch,
            self.work,
            [self.pieces[number] for number in numbers],
            pure=False,
            key=f"tirefit-{id(self)}-{time.monotonic_ns()}",
        )
        self.at_work[future.key] = _Batch(future, numbers, alone)
        future.add_done_callback(self.ended.put)

    def _answers(self, future: Any) -> Iterator[tuple[int, Any]]:
        killed = _library("distributed").scheduler.KilledWorker
        batch = self.at_work.pop(future.key)
        try:
            seconds, results = future.result()
        except killed as error:
            if batch.alone:
                yield batch.numbers[0], Ended(error.allowed_failures + 1)
            else:
                self.suspects.extend(batch.numbers)
            return
        except _library("concurrent.futures").CancelledError:
            raise _gone("the scheduler has dropped the work") from None
        # The first batch of a kind compiles, so use the duration of later ones.
        self.seconds = seconds / len(results)
        yield from zip(batch.numbers, results, strict=True)


def _gone(reason: str) -> UsageError:
    return UsageError(reason, "start it again, then --resume")


_ALONE = threading.Lock()


def _batch(work: Callable, pieces: Sequence) -> tuple[float, list]:
    """Duration and results of pieces, in a worker, one batch at a time."""
    with _ALONE:
        begun = time.monotonic()
        results = [work(piece) for piece in pieces]
        return time.monotonic() - begun, results
