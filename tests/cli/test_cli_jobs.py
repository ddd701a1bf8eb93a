"""Work shared by processes: its order, its losses and its end."""

import os
import time
from contextlib import closing
from functools import partial
from multiprocessing import active_children

from tirefit.cli.jobs import Ended, shared


def doubled(number):
    return 2 * number, os.getpid()


def fatal(number):
    if number == 1:
        os._exit(7)
    return number


def long(folder, number):
    """The first waits for the second to begin; that one would take ten minutes."""
    begun, tidied = folder / "begun", folder / "tidied"
    if number == 0:
        while not begun.exists():
            time.sleep(0.01)
        return "first"
    try:
        begun.touch()
        time.sleep(600)
    finally:
        tidied.touch()


def test_results_come_in_order_from_so_many_processes():
    values, processes = zip(*shared(doubled, range(7), 2), strict=True)
    assert values == tuple(range(0, 14, 2))
    assert os.getpid() not in processes and len(set(processes)) <= 2


def test_a_process_that_ends_costs_one_piece():
    assert list(shared(fatal, range(4), 2)) == [0, Ended(7), 2, 3]


def test_an_early_end_interrupts_what_is_at_work(tmp_path):
    with closing(shared(partial(long, tmp_path), range(2), 2)) as results:
        assert next(results) == "first"
    assert (tmp_path / "tidied").exists()
    assert not active_children()
