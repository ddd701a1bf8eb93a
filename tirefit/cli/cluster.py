"""Work of many pieces shared by the workers of a Dask cluster.

A task is a batch of pieces: few seconds of work, so that neither the scheduler's own
time per task nor the loss of a worker costs much, and pieces that are alike, so that
one compiled program serves them. What a task needs goes with it, and nothing waits on
a worker but what is done there, so a worker that dies costs a retry of its batch. A
batch whose workers die again is taken apart at the end, one piece at a time and nothing
beside it: what dies then has itself to blame.
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
"""Seconds that a batch of several pieces is to take, at least, and batches a second of
all workers, at most: one costs scheduler and client 4 ms."""

_AHEAD = 2  # batches at a time for each worker: one at work and one that waits for it

_CONNECT, _ABSENT = 30.0, 60.0
"""Seconds to wait for a scheduler and its first worker, and for lost ones to return."""

_LOCAL = {
    # One worker's death may be another's doing; twice is taken for the batch's.
    "distributed.scheduler.allowed-failures": 1,
    # A fit holds what it needs; only what would end the machine ends a worker.
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.profile.enabled": False,
}
"""How the workers of this machine are run."""


class Ended(NamedTuple):
    """In the place of a result: so many workers that it was given to alone died."""

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
    """A client of the cluster at that address, or of so many workers of this machine.

    Those of this machine end with the block, whatever they are at.

    Raises:
        UsageError: no ``distributed``, or no scheduler or worker at the address.
    """
    distributed = _library("distributed")
    # Its own words are for who runs a cluster; what matters is said here.
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
    with suppress(TimeoutError):  # it is cut off then
        client.close(timeout=5)


def _connected(distributed: ModuleType, address: str) -> Any:
    reason = f"no scheduler answers at {address}"
    remedy = "start one with `dask scheduler`; its first lines say its address"
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
    # Threads of OpenBLAS spin while they wait, on the cores of the other processes.
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
        # What they have written is whole: nothing is gained by waiting for them.
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
    """(number, ``work(piece)``) of every piece, as they come.

    A piece whose workers die every time it is alone costs itself, :class:`Ended`. When
    the iteration stops early, by an interrupt too, what has not begun is cancelled.

    Args:
        work: a function that can be pickled, as the pieces and results can.
        client: of :func:`cluster`.
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
    """Pieces by their numbers: ``waiting`` by kind, ``suspects`` that wait to be alone,
    and those ``at_work`` by the key of their task."""

    def __init__(self, work, pieces, client, alike):
        self.work, self.pieces, self.client = work, pieces, client
        self.waiting: dict[Hashable, deque[int]] = {}
        for number, piece in enumerate(pieces):
            self.waiting.setdefault(alike(piece), deque()).append(number)
        self.suspects: deque[int] = deque()
        self.at_work: dict[str, _Batch] = {}
        self.ended: SimpleQueue[Any] = SimpleQueue()
        self.seconds: float | None = None  # that a piece takes
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
        """Threads of the workers, now and then."""
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
        """Batches for all who have nothing to do; a suspect when all others are done.

        Whoever waits behind a piece that kills its worker looks as guilty as that.
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
        # The first one of a kind compiles: later ones say what a piece takes.
        self.seconds = seconds / len(results)
        yield from zip(batch.numbers, results, strict=True)


def _gone(reason: str) -> UsageError:
    return UsageError(reason, "start it again, then --resume")


_ALONE = threading.Lock()


def _batch(work: Callable, pieces: Sequence) -> tuple[float, list]:
    """Seconds and results of pieces; in a worker, whose other threads wait."""
    with _ALONE:
        begun = time.monotonic()
        results = [work(piece) for piece in pieces]
        return time.monotonic() - begun, results
