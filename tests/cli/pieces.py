"""Work for the workers of ``test_cli_fleet.py``, apart from it: a worker that is started
anew imports no more than this."""

import os
import time


def doubled(number):
    return 2 * number, os.getpid()


def fatal(worker_of, number):
    """Piece 3 kills every worker that takes it; piece 5 only the first one."""
    if number == 3 or (number == 5 and not (worker_of / "5").exists()):
        (worker_of / str(number)).touch()
        os._exit(7)
    return number


def held(folder, number):
    """Piece 0 is done at once; the others run until they are released."""
    (folder / f"begun{number}").touch()
    while number and not (folder / "go").exists():
        time.sleep(0.01)
    return number


def received(keys, dask_worker):
    """Whether the worker has received one of these tasks."""
    return not dask_worker.state.tasks.keys().isdisjoint(keys)
