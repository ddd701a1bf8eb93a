"""Friction that changes with the temperature of the tire, as a covariate of a fit.

The friction is mu (1 + b (T - T_ref)). The coefficients hold at T_ref: with b, the
measured forces are corrected to T_ref before the fit. F_x and F_y together determine b.
Its slope is made orthogonal to those of the coefficients (Frisch and Waugh), so b and
the coefficients are estimated jointly. The covariance of the coefficients of pure slip
includes that of b.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tirefit.data.table import TireData
from tirefit.fitting.mf.parts import coefficients_of
from tirefit.fitting.mf.rows import ForceRows
from tirefit.fitting.mf.solve import row_gradients, row_values
from tirefit.fitting.mf.stages import Search, problem_of
from tirefit.models.base import TireInputs
from tirefit.params import parameter_values, with_values
from tirefit.results import DataError

_ROUNDS = 6
_SETTLED = 0.1
"""Limit of fits, and the change of b in standard errors below which they end."""

_STEP = 0.05  # relative change of friction for the derivatives of a force

UNUSED = "the friction is not fitted over temperature (friction_temperature = true)"
_LEAST = 1.0
"""Smallest range of temperatures [K]. At about 0.5 % per kelvin, a smaller range
changes the friction by less than the noise of a rig."""

_FORCES = ("fx", "fy")

Rows = Mapping[str, ForceRows]


class FrictionTemperature(NamedTuple):
    """Relative change of friction with temperature; zero at ``reference``."""

    b: float  # [1/K]
    std: float  # standard error
    reference: float  # [degC]

    def text(self) -> str:
        """The result as one sentence."""
        value, std = (1e3 * number for number in (self.b, self.std))
        return (
            f"friction changes by {value:.3g} +- {std:.2g} % per 10 K of the column"
            f" temperature; coefficients and figures are at {self.reference:g} degC"
        )


def at_reference(
    data: TireData, rows: Rows, fitted: Callable[[Rows], Search]
) -> tuple[Search, Rows, FrictionTemperature]:
    """Fit rows corrected to the reference temperature: (search, these rows, b).

    Args:
        data: the data of the rows, with a column temperature.
        rows: by force.
        fitted: fits some rows.

    Raises:
        DataError: the temperature varies by less than 1 K.
    """
    column = data.columns["temperature"]
    if np.ptp(column[data.used]) < _LEAST:
        reason = f"temperature varies by less than {_LEAST:g} K, too little to fit"
        remedy = "leave out friction_temperature"
        raise DataError(reason, remedy, data.file)
    reference = float(np.round(np.median(column[data.used])))
    warmth = {
        force: column[np.isfinite(data.columns[force]) & data.used] - reference for force in rows
    }
    now, b = rows, 0.0
    for _ in range(_ROUNDS):
        work = fitted(now)
        step, std, shift = _step(work, now, warmth)
        b += step
        now = {}
        for force, of in rows.items():
            slope, half = _expanded(work, force, of.inputs)
            change = b * warmth[force]
            now[force] = replace(of, observed=of.observed - change * (slope + change * half))
        if abs(step) < _SETTLED * std:
            break
    work = replace(work, covariance=work.covariance + std**2 * np.outer(shift, shift))
    return work, now, FrictionTemperature(b, std, reference)


def _expanded(work: Search, force: str, inputs: TireInputs) -> tuple[np.ndarray, np.ndarray]:
    """First and half the second derivative (n,) of a force in the friction."""
    tire = work.problem.tire
    scales = {k: parameter_values(tire)[k] for k in ("LMUX", "LMUY")}

    def at(change: float) -> np.ndarray:
        other = with_values(tire, {k: (1 + change) * v for k, v in scales.items()})
        return row_values(replace(work.problem, tire=other), work.u, force, inputs)

    low, middle, high = at(-_STEP), at(0.0), at(_STEP)
    return (high - low) / (2 * _STEP), (high + low - 2 * middle) / (2 * _STEP**2)


def _step(
    work: Search, rows: Rows, warmth: Mapping[str, np.ndarray]
) -> tuple[float, float, np.ndarray]:
    """The Gauss-Newton step of b, its standard error, and du/db (p,) of the best fit."""
    information, downhill, shift = 0.0, 0.0, np.zeros(len(work.u))
    of_part = coefficients_of(work.problem.tire.version)
    for force in (force for force in _FORCES if force in work.groups):
        # Pure slip only: its stage ended at the optimum of the coefficients it moved.
        group = work.groups[force][0]
        own = warmth[force][rows[force].chosen([group.pure])]
        std = np.sqrt(group.each * group.variance(group.cells.observed))
        slope = _expanded(work, force, group.cells.inputs)[0]
        slope = group.mean(own) * slope / std
        names = [n for n in work.moved - work.held if of_part[n] == force]
        problem = problem_of(work, [group], names)
        residual, gradient = row_gradients(problem, work.u)
        gradient, u = gradient[:, problem.free], work.u[problem.free]
        normal = gradient.T @ gradient + np.eye(len(u))
        follows = np.linalg.solve(normal, gradient.T @ slope)
        shift[problem.free] -= follows
        alone = slope - gradient @ follows
        information += float(alone @ slope)
        downhill += float(follows @ u - alone @ residual)
    return downhill / information, float(1 / np.sqrt(information)), shift
