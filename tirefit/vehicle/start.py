"""Tires with which a search over trajectories begins."""

from dataclasses import replace

import numpy as np

from tirefit.data.read import read_frame
from tirefit.data.table import TireData
from tirefit.fitting.problem.build import build
from tirefit.fitting.problem.config import FitConfig
from tirefit.fitting.solve.multistart import solve_problem
from tirefit.fitting.source import GivenTire
from tirefit.fitting.store import at_estimate
from tirefit.models import MODELS
from tirefit.vehicle.shooting import AT_BOUND

_ORDINARY_MU, _ORDINARY_SLOPE = 0.8, 8.0
"""Friction, and slope of force over load [1/rad], of an ordinary tire."""


def started(tire: GivenTire, rows: TireData) -> GivenTire:
    """The tire of a fit; a model given by name is fitted to these rows."""
    if tire.fit is not None or tire.name not in MODELS:
        return tire
    solved = solve_problem(build(rows, tire.name, FitConfig()), FitConfig())
    problem = solved.problem
    fit = problem.layout, solved.z, solved.covariance
    made = at_estimate(problem.model, problem.layout, solved.z)
    return replace(tire, tire=made, fit=fit)


def within(first: GivenTire, given: GivenTire, rows: TireData) -> GivenTire:
    """The first tire of a search; if a fit to the derived rows left it at a bound, the same
    model fitted to an ordinary curve.

    An unknown delay or ratio of the steering makes derived slip angles of the front axle so wrong
    that the force seems to fall with slip: the stiffness ends at its lower bound, from where the
    search does not come back.
    """
    if given.fit is not None or first.fit is None or np.all(np.abs(first.fit[1]) < AT_BOUND):
        return first
    alpha, fz = np.linspace(-0.4, 0.4, 81), float(rows["fz"][0])
    force = _ORDINARY_MU * fz * np.tanh(_ORDINARY_SLOPE / _ORDINARY_MU * alpha)
    cells = {"alpha": alpha, "fy": force, "fz": np.full(81, fz), "v": np.full(81, rows["v"].mean())}
    return started(given, read_frame(cells, "an ordinary curve"))
