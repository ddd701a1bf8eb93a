"""Refits of hypotheses: damped Gauss-Newton, many at once, by NumPy."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from tirefit.diagnosis.evidence.changes import MOST_EFFECTS
from tirefit.diagnosis.evidence.forward import Design, ForwardModel
from tirefit.diagnosis.negligible import FLAT
from tirefit.fitting import least_squares as one_start

_STEPS = 26
"""Steps of a refit, at most."""

_TOLERANCE = 1e-3
"""Chi-squared that one more step of a refit could still gain: evidence is counted in
whole units."""

_FARTHEST = 20.0
"""Amplitudes, in prior scales, beyond which no refit goes."""


class Refit(NamedTuple):
    """Hypotheses refitted: parameters, amplitudes in prior scales, sum of squares, log
    determinant of the curvature, covariance of (z, amplitudes), and the squared
    distance of the amplitudes from what is expected."""

    z: np.ndarray
    amplitude: np.ndarray
    chi2: np.ndarray
    log_det: np.ndarray
    covariance: np.ndarray
    penalty: np.ndarray


def one_of(every: Refit, k: int) -> Refit:
    """One of the hypotheses."""
    return Refit(*(np.asarray(part)[k] for part in every))


class Normal(NamedTuple):
    """Sums of squares (h,), half their curvatures (h, w, w) and gradients (h, w)."""

    cost: np.ndarray
    normal: np.ndarray
    gradient: np.ndarray


class _Hypotheses:
    """Sets of atoms, each on some sets of rows, to be refitted from ``starts`` (h, w);
    sets smaller than the largest are filled with amplitudes of nothing."""

    def __init__(self, model: ForwardModel, starts, sets, keeps, design: Design):
        self.model, self.design, self.p = model, design, len(starts[0][0])
        begin = np.zeros((len(sets), self.p + MOST_EFFECTS))
        for row, (z, amplitude) in zip(begin, starts, strict=True):
            row[: self.p + len(amplitude)] = *z, *amplitude
        self.starts = np.tile(begin, (len(keeps), 1))
        self.sets = [tuple(atoms) for _ in keeps for atoms in sets]
        self.weights = [w for w in map(design.weights, keeps) for _ in sets]
        self.forces, none = design.forces, len(design.prior_scale)
        index = [[*s, *[none] * (MOST_EFFECTS - len(s))] for s in self.sets]
        self.center = np.append(design.prior_center, 0.0)[index]
        self.low = np.maximum(np.append(design.low, -np.inf), -_FARTHEST)[index]
        self.high = np.minimum(np.append(design.high, np.inf), _FARTHEST)[index]

    def allowed(self, numbers, points) -> np.ndarray:
        """The nearest points (k, w) that may be tried."""
        amplitudes = np.clip(points[:, self.p :], self.low[numbers], self.high[numbers])
        return np.concatenate([points[:, : self.p], amplitudes], axis=1)

    def at(self, numbers, points) -> Normal:
        """Around points (k, w), with what pulls on the parameters."""
        held, center = self.starts[numbers, : self.p], self.center[numbers]
        pull = np.ones(points.shape[1])
        pull[: self.p] = float(self.design.hold) ** 2
        off = points - np.concatenate([held, center], axis=1)
        cost, gradient = np.sum(pull * off**2, axis=1), pull * off
        normal = np.tile(np.diag(pull), (len(points), 1, 1))
        sets = [self.sets[number] for number in numbers]
        found = self.model.slopes(points, sets, self.design)
        for k, (mean, columns) in enumerate(found):
            weight, own = self.weights[numbers[k]], slice(len(columns))
            rows = (columns * weight).reshape(len(columns), -1)
            missed = ((self.forces - mean) * weight).reshape(-1)
            cost[k] += missed @ missed
            normal[k, own, own] += rows @ rows.T
            gradient[k, own] -= rows @ missed
        return Normal(cost, normal, gradient)


def refit_folds(model: ForwardModel, starts, sets, keeps, design: Design) -> Refit:
    """Sets of atoms refitted from starts (z, amplitudes in prior scales), each on every
    set of rows ``keeps`` (f, n), 0 or 1: leading axes (f, sets)."""
    those = _Hypotheses(model, starts, sets, keeps, design)
    z, best = minimised(those.at, those.starts, those.allowed, 0.0, _TOLERANCE, _STEPS)
    p, shape = those.p, (len(keeps), len(sets))
    penalty = np.sum((z[:, p:] - those.center) ** 2, axis=1)
    # A parameter at its bound has no curvature; what is left of it cancels.
    curvature = best.normal + FLAT * np.eye(z.shape[1])
    found = (
        z[:, :p], z[:, p:], best.cost - penalty, np.linalg.slogdet(curvature)[1],
        np.linalg.inv(curvature), penalty,
    )  # fmt: skip
    return Refit(*(values.reshape(*shape, *values.shape[1:]) for values in found))


def refit(model: ForwardModel, starts, sets, design: Design) -> Refit:
    """The same on the rows of the design: leading axis (sets,)."""
    return one_of(refit_folds(model, starts, sets, [design.keep], design), 0)


def _after_step(z, at: Normal, allowed: Callable, damping, longest: float):
    """As that of :mod:`tirefit.fitting.least_squares`, of each of many."""

    def limited(system, right):
        move = np.linalg.solve(system, right[..., None])[..., 0]
        asked = z + np.clip(move, -longest, longest)
        reached = allowed(asked)
        return reached, (reached == asked) & (np.abs(move) <= longest)

    size, one = np.diagonal(at.normal, axis1=1, axis2=2), np.eye(z.shape[1])
    size = np.maximum(size, one_start.LEAST_SCALE * size.max(axis=1, keepdims=True))
    size = (size + one_start.NO_CURVATURE) * damping[:, None]
    system = at.normal + size[:, :, None] * one
    reached, free = limited(system, -at.gradient)
    if free.all():
        return reached
    fixed = np.where(free, 0.0, reached - z)
    both = free[:, :, None] & free[:, None, :]
    steep = at.gradient + (at.normal @ fixed[:, :, None])[..., 0]
    beside = np.where(free, -steep, fixed)
    return limited(np.where(both, system, one), beside)[0]


def _gain(move, at: Normal):
    """By how much the costs would fall, were the residuals straight."""
    straight = 2 * at.gradient + (at.normal @ move[:, :, None])[..., 0]
    return -np.sum(move * straight, axis=1)


def minimised(
    at: Callable, starts, allowed: Callable, relative: float, absolute: float, most: int
) -> tuple[np.ndarray, Normal]:
    """``least_squares.damped_gauss_newton`` from each of some starts (h, w): ``at`` and
    ``allowed`` take numbers of these (k,) and points (k, w)."""
    going, law = np.arange(len(starts)), one_start
    h, w = starts.shape
    best = Normal(np.full(h, np.inf), np.tile(np.eye(w), (h, 1, 1)), np.zeros((h, w)))
    trial = allowed(going, starts)
    z, damping, promised = trial.copy(), np.full(h, law.FIRST_DAMPING), np.ones(h)
    for _ in range(most):
        new = at(going, trial[going])
        better = new.cost < best.cost[going]
        with np.errstate(all="ignore"):
            share = (best.cost[going] - new.cost) / promised[going]
        mine = going[better]
        z[mine] = trial[mine]
        for old, here in zip(best, new, strict=True):
            old[mine] = here[better]
        eased = np.where(share > law.GOOD, law.EASE, law.EASE_A_LITTLE)
        factor = np.where(better & (share > law.FAIR), eased, law.STIFFEN)
        damping[going] = np.maximum(damping[going] * factor, law.LEAST_DAMPING)
        around, here = Normal(*(part[going] for part in best)), z[going]
        step = partial(_after_step, here, around, partial(allowed, going))
        whole = step(np.full(len(going), law.LEAST_DAMPING), np.inf)
        gain = np.abs(_gain(whole - here, around))
        trial[going] = step(damping[going], law.LONGEST_STEP)
        promised[going] = _gain(trial[going] - here, around)
        settled = gain <= relative * around.cost + absolute
        going = going[~(settled | (damping[going] > law.STUCK))]
        if not len(going):
            break
    return z, best
