"""Forces of a fitted Magic Formula, with the variance of its coefficients."""

from collections.abc import Sequence

import numpy as np

from tirefit.fitting.mf.parts import coefficients_of
from tirefit.fitting.mf.solve import Problem, blocks_of, propagated
from tirefit.fitting.store import StoredFit
from tirefit.models import TireInputs
from tirefit.models.mf import MFTire
from tirefit.params import parameter_values


def magic_formula_forces(
    fit: StoredFit, forces: Sequence[str], inputs: TireInputs
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Forces, and their variance from the posterior of the coefficients.

    The variance is linear in the covariance of all coefficients (Laplace); coefficients
    that the data do not identify have the variance of their priors.

    Args:
        fit: of an :class:`MFTire`.
        forces: of fx, fy, mz, mx and my.
        inputs: arrays (n,).

    Returns:
        (force, variance): dicts of arrays (n,).
    """
    tire = fit.at_estimate()
    assert isinstance(tire, MFTire)
    names = tuple(coefficients_of(tire.version))
    at = [names.index(p.name) for p in fit.layout.free]
    slope = np.array([(p.spec.upper - p.spec.lower) / 4 for p in fit.layout.free])
    covariance = np.zeros((len(names), len(names)))
    covariance[np.ix_(at, at)] = fit.covariance * np.outer(slope, slope)
    values = parameter_values(tire)
    centre = np.array([values[name] for name in names])
    one = np.full(len(names), 1.0)
    mean, variance = {}, {}
    for force in forces:
        nothing = np.zeros(np.shape(inputs.fz))
        blocks = blocks_of(force, inputs, nothing, nothing + 1.0)
        problem = Problem(tire, names, centre, one, one < 0, one > 0, blocks)
        mean[force], variance[force] = propagated(problem, 0 * one, covariance)
    return mean, variance
