"""Work of many pieces shared by processes, its results in order."""

import os
import signal
from collections import deque
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from typing import Any, NamedTuple

__all__ = ["Ended", "shared"]

_PATIENCE = 5.0
"""Seconds that an interrupted process has to tidy up after itself."""


class Ended(NamedTuple):
    """In the place of a result: the process that worked at it is gone, with this exit
    code (minus the number of the signal, where one ended it)."""

    exit_code: int | None


def _interrupt(*_: object) -> None:
    # The terminal sends Ctrl-C to every process, and the parent once more.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    raise KeyboardInterrupt


def _serve(pipe: Connection, work: Callable) -> None:
    """Answers one piece after the other, until None or the parent's end."""
    with suppress(KeyboardInterrupt, EOFError, BrokenPipeError):
        signal.signal(signal.SIGINT, _interrupt)
        for piece in iter(pipe.recv, None):
            pipe.send(work(piece))


class _Worker:
    """One process; ``number`` is of the piece that it works at, None if of none."""

    def __init__(self, work: Callable):
        context = get_context("spawn")
        self.pipe, there = context.Pipe()
        self.number: int | None = None
        self.process = context.Process(target=_serve, args=(there, work), daemon=True)
        # An interrupt while it starts would end in a traceback of its imports.
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            self.process.start()
        finally:
            signal.signal(signal.SIGINT, before)
        there.close()

    def give(self, number: int, piece: Any) -> None:
        self.number = number
        with suppress(BrokenPipeError):  # it is gone, which the answer will say
            self.pipe.send(piece)

    def answer(self) -> Any:
        """Its result, or :class:`Ended`."""
        self.number = None
        try:
            return self.pipe.recv()
        except (EOFError, ConnectionResetError):
            self.process.join()
            return Ended(self.process.exitcode)

    def interrupt(self) -> None:
        pid = self.process.pid
        if self.number is not None and pid is not None and self.process.is_alive():
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGINT)

    def end(self) -> None:
        self.pipe.close()  # which ends it, once it has nothing to do
        self.process.join(_PATIENCE)
        if self.process.is_alive():
            self.process.terminate()
            self.process.join()


def shared(work: Callable, pieces: Sequence, jobs: int) -> Generator[Any, None, None]:
    """``work(piece)`` of every piece, in order, by so many processes.

    A process that ends before its time costs the piece that it worked at,
    :class:`Ended`, and another takes its place. When the iteration stops early, by an
    interrupt too, the processes end.

    Args:
        work: a function that can be pickled, as the pieces and results can.
    """
    # Threads of OpenBLAS spin while they wait, on the cores of the other processes.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    waiting, done = deque(enumerate(pieces)), {}
    workers: list[_Worker] = []
    try:
        for number in range(len(pieces)):
            while number not in done:
                workers = _at_work(workers, work, waiting, jobs)
                ready = wait([worker.pipe for worker in workers])
                for worker in [w for w in workers if w.pipe in ready]:
                    which = worker.number
                    done[which] = worker.answer()
            yield done.pop(number)
    finally:
        for worker in workers:
            worker.interrupt()
        for worker in workers:
            worker.end()


def _at_work(workers, work, waiting: deque, jobs: int) -> list[_Worker]:
    """Every worker that is left with a piece to work at; new ones where they lack."""
    alive = []
    for worker in workers:
        if worker.number is None and waiting and worker.process.is_alive():
            worker.give(*waiting.popleft())
        if worker.number is None:
            worker.end()
        else:
            alive.append(worker)
    while waiting and len(alive) < jobs:
        alive.append(_Worker(work))
        alive[-1].give(*waiting.popleft())
    return alive
