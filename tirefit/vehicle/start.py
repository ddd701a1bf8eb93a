"""Unknowns of a car, and tires, with which a search over trajectories begins."""

from dataclasses import replace
from typing import NamedTuple

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


class Unknown(NamedTuple):
    """An unknown of the car."""

    unit: str
    prior: float  # standard error of a weak prior at zero; of a factor's logarithm
    is_factor: bool
    meaning: str


UNKNOWNS = {
    "yaw_inertia": Unknown("kg m2", 0.5, True, "about the cg"),
    "cg_ahead": Unknown("m", 0.05, False, "than in vehicle.toml"),
    "steering_ratio": Unknown("-", 0.3, True, "of wheel to map"),
    "steering_offset": Unknown("rad", 0.1, False, "added to the angle"),
    "steering_delay": Unknown("s", 0.1, False, "wheels after the log"),
    "sideslip_zero": Unknown("rad", 0.05, False, "logged less the car's"),
}
"""Parameters that may be estimated with the tires; the prior of ``cg_ahead`` is a share of
the wheelbase."""

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
