"""What a set of effects has earned beside the evidence for it.

The evidence compares the sets of a library with one another. It does not say whether
the best of them is right: several effects together draw nearly any smooth curve. Here
a set is held against what it leaves and against itself.
"""

from typing import NamedTuple

import numpy as np

from tirefit.data.levels import levels
from tirefit.diagnosis.decide.adequacy import UNTESTED, Adequacy, Null, adequacy, null
from tirefit.diagnosis.evidence.base import Base
from tirefit.diagnosis.evidence.search import Hypothesis, amplitudes_of
from tirefit.diagnosis.negligible import ROUNDING, SILENT
from tirefit.diagnosis.noise.memory import correlation
from tirefit.diagnosis.rows.basis import without
from tirefit.diagnosis.rows.patterns import travelled
from tirefit.diagnosis.rows.prepared import Prepared, neighbours
from tirefit.diagnosis.rows.rates import segments

_PARTS = 5, 8
"""Parts of slip and time, between which the size of an effect is compared."""


class Standing(NamedTuple):
    """One refitted set of effects.

    Attributes:
        adequacy: tests of what it leaves, the worst of the channels.
        formulas: the same of what the formulas of its effects leave, where these are
            there in another form; ``in_other_form`` says so.
        errors: amplitude of each effect over its standard error, the variance
            widened by what the set leaves.
        cancels: energy of the effects one by one over that of all together, the base
            parameters taken out: 1 where they are independent, large where one undoes
            the other.
    """

    adequacy: Adequacy
    formulas: Adequacy
    in_other_form: bool
    errors: tuple[float, ...]
    cancels: float


def widening(base: Base, residual) -> float:
    """Factor on the variance of amplitudes: what a set leaves is larger than the noise,
    and neighbours in time agree, where it does not explain everything.

    Args:
        residual: (m,) whitened, of all channels.
    """
    prepared, n = base.prepared, base.prepared.n
    rows_each = max(
        correlation(residual[k * n : (k + 1) * n], prepared.time, prepared.run)
        for k in range(len(prepared.channels))
    )
    return max(float(np.mean(residual**2)), 1.0) * rows_each


def _thirds(values, parts: int = 3) -> np.ndarray:
    return np.searchsorted(np.quantile(values, np.arange(1, parts) / parts), values)


def partitions(
    prepared: Prepared, of_slip: int = 3, of_time: int = 3
) -> list[np.ndarray]:
    """The rows (n,) by load, speed, sign of the slip, direction, size of the slip, time
    and run, as far as the file has them: codes of what belongs together.

    Args:
        of_slip, of_time: parts of as many rows each.
    """
    rows, has = prepared.covariates, prepared.has

    def settings(values):
        distinct = levels(values)
        return distinct.code if distinct.few() else _thirds(values)

    parts = []
    if "loads" in has:
        parts.append(settings(rows.fz))
    if "speeds" in has:
        parts.append(settings(rows.v))
    if "signs" in has:
        parts.append(prepared.slip <= 0)
    if "sweeps" in has:
        parts.append(rows.turning <= 0)
    parts.append(_thirds(np.abs(prepared.slip), of_slip))
    if "time" in has:
        parts.append(_thirds(rows.time, of_time))
    parts.append(prepared.run)
    codes = [np.unique(part, return_inverse=True)[1] for part in parts]
    return [code for code in codes if code.max() > 0]


def regimes(prepared: Prepared) -> list[np.ndarray]:
    """Rows to leave out together, in the order of the slip: each load, speed, sign of
    the slip, direction and run, and each third of slip and time."""
    order = np.argsort(prepared.slip, kind="stable")
    return [
        order[(codes == code)[order]]
        for codes in partitions(prepared)
        for code in range(codes.max() + 1)
    ]


def steadiness(
    base: Base, hypothesis: Hypothesis, used_up
) -> tuple[np.ndarray, np.ndarray]:
    """How steady the effects of a set are over its regimes: (h,) both.

    Each part of each partition of the rows is left out in turn, to first order. What is
    there has one size everywhere; what only imitates something has another wherever one
    looks, and its error by the rows knows nothing of that.

    Args:
        used_up: (m, p) whitened columns of everything that was fitted: parameters,
            effects, and their other forms where these were.

    Returns:
        Amplitude over its error by the jackknife over a partition, the smallest; and
        the largest change of the amplitude by one part, over the amplitude.
    """
    amplitudes = amplitudes_of(base, hypothesis)
    residual = base.residual(hypothesis.z, amplitudes)
    p, h = len(hypothesis.z), len(hypothesis.atoms)
    size = np.abs(hypothesis.amplitude)
    prior = np.ones(used_up.shape[1])
    prior[:p] = ROUNDING
    normal = used_up.T @ used_up + np.diag(prior)
    # The fit is that of the formulas: only their other forms have a score there.
    score = np.zeros(len(prior))
    score[p + h :] = used_up[:, p + h :].T @ residual
    step = np.linalg.lstsq(normal, score, rcond=None)[0]
    steady, moved = np.full(h, np.inf), np.zeros(h)
    for codes in partitions(base.prepared, *_PARTS):
        everywhere = np.tile(codes, len(base.prepared.channels))
        steps = []
        for code in range(codes.max() + 1):
            out = everywhere == code
            own = used_up[out]
            left = score - own.T @ residual[out]
            steps.append(np.linalg.lstsq(normal - own.T @ own, left, rcond=None)[0])
        change = (np.array(steps) - step)[:, p : p + h]
        off = change - change.mean(axis=0)
        error = np.sqrt((1 - 1 / len(change)) * np.sum(off**2, axis=0))
        steady = np.minimum(steady, size / np.maximum(error, ROUNDING))
        moved = np.maximum(moved, np.abs(change).max(axis=0))
    return steady, moved / np.maximum(size, ROUNDING)


def _worst(each: list[Adequacy]) -> Adequacy:
    """The smallest p-value of the channels, times their number (Bonferroni)."""

    def smallest(name):
        values = [getattr(one, name) for one in each if getattr(one, name) is not None]
        return min(1.0, len(each) * min(values)) if values else None

    tests = [name for name in Adequacy._fields if name != "passed"]
    return Adequacy(
        **{name: smallest(name) for name in tests},
        passed=all(one.passed for one in each),
    )


def _misled(base: Base, linear, atoms: list[int]) -> np.ndarray:
    """Standard deviation of amplitudes (h,) from the doubt of the slips."""
    own = without(linear.columns[:, atoms], linear.jacobian)
    moved = np.linalg.solve(own.T @ own + np.eye(len(atoms)), own.T @ base.doubt)
    return np.sqrt(np.sum(moved**2, axis=1))


def _orders(prepared: Prepared, stretches: list[np.ndarray]) -> list[np.ndarray]:
    """Places of the rows in time, and on the way: what turns with the wheel repeats
    with that.

    Args:
        stretches: rows in the order of time, see :func:`segments`.
    """
    orders = [np.argsort(np.concatenate(stretches))]
    if "speeds" in prepared.has:
        way = travelled(prepared)
        if np.ptp(way) > 0:
            steps = (prepared.n - 1) / np.ptp(way)
            orders.append(np.rint((way - way.min()) * steps).astype(int))
    return orders


def _tested(base: Base, residual, used_up, generator) -> Adequacy:
    """The tests of what is left of the rows, the worst of the channels."""
    prepared, n = base.prepared, base.prepared.n
    # As the noise it is held against: without all that was fitted.
    residual = without(residual, used_up)
    keep = np.asarray(base.design.keep[:n]) > 0
    index = np.cumsum(keep) - 1

    def kept(groups):
        parts = [index[group[keep[group]]] for group in groups]
        return [part for part in parts if len(part)]

    in_time, orders = None, []
    if prepared.time is not None:
        stretches = segments(prepared.time, prepared.run)
        in_time = kept(stretches)
        orders = [places[keep] for places in _orders(prepared, stretches)]
    in_slip, groups = kept(neighbours(prepared)), kept(regimes(prepared))
    rows = [np.flatnonzero(keep) + k * n for k in range(len(prepared.channels))]
    stacked = np.split(np.arange(len(rows) * keep.sum()), len(rows))
    kept_rows = np.concatenate(rows)
    of_noise = null(
        used_up[kept_rows], base.doubt[kept_rows], stacked,
        [float(np.sqrt(np.mean(residual[part] ** 2))) for part in rows],
        [base.noise[channel].memory for channel in prepared.channels],
        in_time, generator,
    )  # fmt: skip
    each = [
        adequacy(
            residual[part], Null(of_noise.draws[own], of_noise.unit[own]),
            in_time, in_slip, groups, orders,
        )
        if np.sqrt(np.mean(residual[part] ** 2)) > SILENT
        else UNTESTED._replace(passed=True)
        for part, own in zip(rows, stacked, strict=True)
    ]  # fmt: skip
    return _worst(each)


def standing(base: Base, hypothesis: Hypothesis, used_up, generator) -> Standing:
    """What a refitted set has earned.

    Args:
        used_up: (m, p) whitened columns of everything that was fitted: parameters,
            effects, and their other forms where these were.
        generator: of simulated residuals.
    """
    linear = base.linearised(hypothesis.z, amplitudes_of(base, hypothesis))
    residual = np.asarray(linear.residual)
    p = len(hypothesis.z)
    by_formula = used_up[:, : p + len(hypothesis.atoms)]
    found = _tested(base, residual, used_up, generator)
    in_other_form = used_up.shape[1] > by_formula.shape[1]
    formulas = (
        _tested(base, residual, by_formula, generator) if in_other_form else found
    )
    std = np.sqrt(np.maximum(np.diag(hypothesis.covariance)[p:], 0))
    atoms = list(hypothesis.atoms)
    wide = widening(base, without(residual, used_up))
    std = np.hypot(std * np.sqrt(wide), _misled(base, linear, atoms))
    own = without(linear.columns[:, atoms], linear.jacobian)
    parts = own * hypothesis.amplitude
    together = float(np.sum(parts.sum(axis=1) ** 2))
    return Standing(
        found,
        formulas,
        in_other_form,
        tuple(
            float(a) for a in np.abs(hypothesis.amplitude) / np.maximum(std, ROUNDING)
        ),
        float(np.sum(parts**2)) / max(together, ROUNDING) if parts.size else 1.0,
    )
