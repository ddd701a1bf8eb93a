"""Simulated drives, each computed once."""

from functools import cache

from tirefit.online.methods import estimator_of
from tirefit.online.run import run
from tirefit.sim.drive import Drive, simulate_drive

STIFFNESS = {"C_f": 11 * 1500 * 9.81 * 1.4 / 2.6, "C_r": 13 * 1500 * 9.81 * 1.2 / 2.6}
"""Cornering stiffness [N/rad] of the simulated car's axles."""

made = cache(lambda items: simulate_drive(Drive(**dict(items))))


def drive(**how):
    """A simulated log; its arrays are shared, so copy them before changing them."""
    return made(tuple(how.items()))


def estimated(name, log, settings=None):
    """Estimates of a method over a log's columns."""
    return run(estimator_of(name, 1.0, settings or {}), log)[1]
