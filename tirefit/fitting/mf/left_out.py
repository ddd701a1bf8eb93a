"""Cross-validate a fit on parts of the data, and set its prediction bands by them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh
from scipy.special import chdtrc

from tirefit.fitting.mf.bins import Setting
from tirefit.fitting.mf.parts import own_coefficients
from tirefit.fitting.mf.rows import ForceRows
from tirefit.fitting.mf.solve import blocks_of, propagated
from tirefit.fitting.mf.stages import Progress, Search, without
from tirefit.fitting.problem.noise import NoiseLaw, beyond_loads, noise_law
from tirefit.fitting.solve.inference import half_width_95

LEAVE_OUT = ("three", "load", "none")
"""Parts that are left out in turn: the bins of three loads (smallest, middle, largest),
the bins of each load, or nothing."""

_ROWS = 1500  # largest number of rows of a force, evenly taken, that a part is judged by
_IN_95 = 1.96
_CHANCE = 0.05  # level of the test for shifts that are larger than the standard errors
_DETERMINED = 0.1
"""Smallest relative growth of a variance without the part, in a direction of the
coefficients that the part determines."""

_ONE_LOAD = 1.06
"""Largest ratio of two neighbouring levels of one load. The levels of a load differ between
forces, as it varies with the slip: twice the scatter of a load that a rig holds."""

_ENDS = (0.01, 0.99)
"""Quantiles of the loads of fitted rows that are the ends of their range: the load of a
rig also falls to zero between settings."""

_BEYOND, _WORTH = 0.04, 1
"""Error of the formula, relative to the force, at e times the largest load or 1/e of the
smallest, before any load is left out; and the number of left-out loads that it counts as.
Chosen on five tires, judged on others (``fits/rig_test/loads.py``)."""


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


class LeftOut(NamedTuple):
    """One part of the data of a force, predicted by a fit to the other parts."""

    label: str
    force: str
    rows: int  # of the part
    rmse: float  # [N, N m] under that fit
    rmse_of_all: float  # under the fit to all rows
    within: float  # share of rows in the 95 % band, which is made without this part


class Band(NamedTuple):
    """The band of a measurement: its noise law, with the error of the formula beyond the
    loads, and the factor by which the standard errors of the coefficients are widened."""

    law: NoiseLaw
    wider: float


class _Sample(NamedTuple):
    """A sample of n rows of one part under one fit."""

    residual: np.ndarray  # (n,) predicted - measured
    fz: np.ndarray
    predicted: np.ndarray
    variance: np.ndarray  # (n,) of the prediction, from the errors of the coefficients
    rows: int  # that it was taken from
    each: float  # rows that count as one
    loads: tuple[float, float]  # ends of the loads of the rows that were fitted
    shift: tuple[float, int] = (0.0, 0)  # see :func:`_shift`

    @property
    def beyond(self) -> np.ndarray:
        """Distance (n,) from the fitted loads."""
        return beyond_loads(self.fz, self.loads)


def cross_validated(
    work: Search,
    rows: Mapping[str, ForceRows],
    settings: Mapping[str, Sequence[Setting]],
    which: str,
    progress: Progress = lambda text: None,
) -> tuple[tuple[LeftOut, ...], dict[str, Band]]:
    """Leave each part out in turn and predict it; the band of each force follows.

    Args:
        settings: by force.
        which: of :data:`LEAVE_OUT`.

    Returns:
        The parts, and by force the band. If nothing is left out, the bands are those of
        the fitted rows. ``within`` of a single part is NaN.
    """
    samples: dict[str, list[tuple[str, _Sample, float]]] = {force: [] for force in rows}
    for label, gone in _parts(settings, which).items():
        progress(f"left out: {label}")
        fitted = without(work, gone)
        for force in fitted.groups:
            is_out = np.isin(rows[force].setting, gone[force])
            if np.any(is_out):
                part = _sample(fitted, rows[force], is_out, ~is_out)
                part = part._replace(shift=_shift(fitted, work, force))
                of_all = _sample(work, rows[force], is_out, ~is_out)
                samples[force].append((label, part, rms(of_all.residual)))
    left_out, bands = [], {}
    for force, parts in samples.items():
        every = np.full(len(rows[force].observed), True)
        fitted_rows = _sample(work, rows[force], every, every)
        for label, part, rmse_of_all in parts:
            others = [other for _, other, _ in parts if other is not part]
            within = float("nan")
            if others:
                band = _band(others, fitted_rows)
                law = band.law._replace(loads=part.loads)
                variance = law.variance(part.fz, part.predicted) + band.wider**2 * part.variance
                within = float(np.mean(np.abs(part.residual) <= _IN_95 * np.sqrt(variance)))
            rmse = rms(part.residual)
            left_out.append(LeftOut(label, force, part.rows, rmse, rmse_of_all, within))
        bands[force] = _band([part for _, part, _ in parts], fitted_rows)
    return tuple(left_out), bands


def _parts(
    settings: Mapping[str, Sequence[Setting]], which: str
) -> dict[str, dict[str, list[int]]]:
    """Label of each part -> by force, the settings that are left out together."""
    fz = np.unique([setting.fz for of_force in settings.values() for setting in of_force])
    loads = np.split(fz, np.flatnonzero(fz[1:] > _ONE_LOAD * fz[:-1]) + 1)
    if which == "none" or len(loads) < 3:  # two others predict a load
        return {}
    if which == "three":
        loads = [loads[k] for k in sorted({0, len(loads) // 2, len(loads) - 1})]
    return {
        f"F_z = {np.median(load):.0f} N": {
            force: [k for k, setting in enumerate(of_force) if setting.fz in load]
            for force, of_force in settings.items()
        }
        for load in loads
    }


def _sample(work: Search, rows: ForceRows, chosen: np.ndarray, fitted: np.ndarray) -> _Sample:
    """A sample of the ``chosen`` rows (n,) under the fit of the ``fitted`` rows (n,)."""
    at = np.flatnonzero(chosen)
    count = len(at)
    at = at[np.linspace(0, count - 1, min(count, _ROWS)).astype(int)]
    some = rows.part(at)
    blocks = blocks_of(rows.force, some.inputs, some.observed, np.full(len(at), 1.0))
    problem = replace(work.problem, blocks=blocks)
    residual, variance = propagated(problem, work.u, work.covariance)
    each = max(work.rows_per_one(rows.force) * len(at) / count, 1.0)
    predicted = residual + some.observed
    fz, ends = some.column("fz"), np.quantile(rows.column("fz")[fitted], _ENDS).tolist()
    return _Sample(residual, fz, predicted, variance, count, each, (ends[0], ends[1]))


def _shift(fitted: Search, whole: Search, force: str) -> tuple[float, int]:
    """Sum of squares of the shift of the coefficients of a force when a part is left out, over
    its variance, and the number of directions, of those that the part determines. The
    difference of two estimates, one of them from part of the data of the other, has a
    covariance that is the difference of theirs (Hausman 1978)."""
    names, moved = whole.problem.names, whole.moved - whole.held
    coefficients = own_coefficients(whole.problem.tire.version, force)
    at = np.flatnonzero(np.isin(names, [name for name in coefficients if name in moved]))
    sizes, axes = eigh(fitted.covariance[np.ix_(at, at)], whole.covariance[np.ix_(at, at)])
    determined = sizes - 1 > _DETERMINED
    shift = (axes.T @ (fitted.u - whole.u)[at])[determined]
    return float(np.sum(shift**2 / (sizes[determined] - 1))), len(shift)


def _band(parts: Sequence[_Sample], fitted: _Sample) -> Band:
    """The band that rows of left-out parts follow.

    Standard errors are widened to the size of the shifts if these are larger than the errors
    at the level of 5 %. The noise of the ``fitted`` rows is raised if fewer than 95 % of them
    would be in the band, as the rows of one load may scatter more than the law.
    """
    shift, count = np.sum([(0.0, 0), *(part.shift for part in parts)], axis=0)
    is_clear = count > 0 and chdtrc(count, shift) < _CHANCE
    wider = float(np.sqrt(shift / count)) if is_clear else 1.0
    known = wider**2 * fitted.variance
    law = noise_law(fitted.residual, fitted.fz, fitted.predicted, known, fitted.each)
    # In each outer part: mean square of the relative error of the formula over the distance
    # of its load, without the noise and the standard errors of the coefficients.
    squares = []
    for part in (part for part in parts if np.median(part.beyond) > 0):
        noise = law._replace(loads=part.loads).variance(part.fz, part.predicted)
        excess = np.mean(part.residual**2 - part.variance - noise)
        squares.append(max(float(excess / np.mean(part.beyond * part.predicted**2)), 0.0))
    beyond = beyond_of(squares)
    needed = (fitted.residual / _IN_95) ** 2 - known
    needed = needed / np.maximum(law.variance(fitted.fz, fitted.predicted), 1e-200)
    raised = float(np.sqrt(max(np.quantile(needed, 0.95), 1.0)))
    constant, share, of_force = (raised * x for x in law[:3])
    return Band(NoiseLaw(constant, share, of_force, beyond, fitted.loads), wider)


def beyond_of(squares: Sequence[float]) -> float:
    """The error of the formula beyond the loads, from its ``squares`` in outer loads.

    It is one number per load, as all rows of a load are wrong alike. Its variance is
    therefore that of few draws, to which the prior adds one, and its distribution is
    Student's t: the error is scaled so that 1.96 times it is the interval of 95 %.
    """
    count = len(squares) + _WORTH
    variance = (sum(squares) + _WORTH * _BEYOND**2) / count
    return float(np.sqrt(variance)) * half_width_95(True, count) / _IN_95
