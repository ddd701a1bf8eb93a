"""Work shared by the workers of a cluster: order, losses and end."""

import os
import time
from contextlib import closing
from functools import partial

import pytest

from tirefit.cli.cluster import Ended, cluster, shared
from tirefit.results import UsageError


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


def left_waiting(dask_worker):
    return len(dask_worker.state.ready)


def test_every_piece_runs_once_in_the_requested_number_of_processes(two):
    results = dict(shared(doubled, range(40), two))
    assert {number: value for number, (value, _) in results.items()} == {
        number: 2 * number for number in range(40)
    }
    processes = {process for _, process in results.values()}
    assert os.getpid() not in processes and len(processes) <= 2


def test_a_piece_that_kills_workers_fails_alone(two, tmp_path):
    results = list(shared(partial(fatal, tmp_path), range(8), two))
    numbers = [number for number, _ in results]
    assert sorted(numbers) == list(range(8))
    assert dict(results) == {k: k for k in range(8)} | {3: Ended(2)}
    assert (tmp_path / "5").exists()


def test_an_early_end_cancels_pending_pieces(two, tmp_path):
    """Of four pieces one is done, two are running and one waits."""
    with closing(shared(partial(held, tmp_path), range(30), two)) as results:
        assert next(results) == (0, 0)
    for _ in range(1000):  # until the workers know
        if not any(two.run(left_waiting).values()):
            break
        time.sleep(0.01)
    (tmp_path / "go").touch()
    # What waited still would have its turn before these.
    assert len(dict(shared(doubled, range(8), two))) == 8
    assert len(list(tmp_path.glob("begun*"))) <= 3


def test_a_missing_scheduler_is_a_usage_error(monkeypatch):
    monkeypatch.setattr("tirefit.cli.cluster._CONNECT", 0.2)
    with pytest.raises(UsageError, match="no scheduler answers at 127.0.0.1:1"):
        with cluster(1, "127.0.0.1:1"):
            pass
