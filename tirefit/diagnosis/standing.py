"""What a set of effects has earned beside the evidence for it.

The evidence compares the sets of a library with one another. It does not say whether
the best of them is right: several effects together draw nearly any smooth curve. Here
a set is held against what it leaves and against itself.
"""

from typing import NamedTuple

import numpy as np

from tirefit.data.levels import levels
from tirefit.diagnosis.adequacy import Adequacy, Null, adequacy, null
from tirefit.diagnosis.base import Base
from tirefit.diagnosis.basis import without
from tirefit.diagnosis.negligible import ROUNDING
from tirefit.diagnosis.noise import correlation
from tirefit.diagnosis.rates import segments
from tirefit.diagnosis.rows import Prepared, neighbours
from tirefit.diagnosis.search import Hypothesis, amplitudes_of

__all__ = ["Standing", "regimes", "standing", "widening"]


class Standing(NamedTuple):
    """One refitted set of effects.

    Attributes:
        adequacy: tests of what it leaves, the worst of the channels.
        errors: amplitude of each effect over its standard error, the variance
            widened by what the set leaves.
        cancels: energy of the effects one by one over that of all together, the base
            parameters taken out: 1 where they are independent, large where one undoes
            the other.
    """

    adequacy: Adequacy
    errors: tuple[float, ...]
    cancels: float


def widening(base: Base, hypothesis: Hypothesis) -> float:
    """Factor on the variance of amplitudes: what a hypothesis leaves is larger than
    the noise, and neighbours in time agree, where it does not explain everything."""
    prepared, n = base.prepared, base.prepared.n
    residual = base.residual(hypothesis.z, amplitudes_of(base, hypothesis))
    rows_each = max(
        correlation(residual[k * n : (k + 1) * n], prepared.time, prepared.run)
        for k in range(len(prepared.channels))
    )
    return max(float(np.mean(residual**2)), 1.0) * rows_each


def regimes(prepared: Prepared) -> list[np.ndarray]:
    """Rows to leave out together, in the order of the slip: each load, speed, sign of
    the slip, direction and run, and each third of slip and time."""
    rows, has = prepared.covariates, prepared.has
    order = np.argsort(prepared.slip, kind="stable")
    groups = []

    def add(inside):
        if 0 < np.count_nonzero(inside) < len(inside):
            groups.append(order[inside[order]])

    def thirds(values):
        third = np.searchsorted(np.quantile(values, [1 / 3, 2 / 3]), values)
        for number in range(3):
            add(third == number)

    def settings(values):
        distinct = levels(values)
        if not distinct.few():
            thirds(values)
        for code in range(len(distinct.center) if distinct.few() else 0):
            add(distinct.code == code)

    if "loads" in has:
        settings(rows.fz)
    if "speeds" in has:
        settings(rows.v)
    if "signs" in has:
        add(prepared.slip > 0)
        add(prepared.slip <= 0)
    if "sweeps" in has:
        add(rows.turning > 0)
        add(rows.turning <= 0)
    thirds(np.abs(prepared.slip))
    if "time" in has:
        thirds(rows.time)
    for code in np.unique(prepared.run) if np.ptp(prepared.run) else ():
        add(prepared.run == code)
    return groups


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


def standing(base: Base, hypothesis: Hypothesis, used_up, generator) -> Standing:
    """What a refitted set has earned.

    Args:
        used_up: (m, p) whitened columns of everything that was fitted: parameters,
            effects, and their other forms where these were.
        generator: of simulated residuals.
    """
    prepared, n = base.prepared, base.prepared.n
    amplitudes = amplitudes_of(base, hypothesis)
    linear = base.linearised(hypothesis.z, amplitudes, hypothesis.atoms)
    residual = np.asarray(linear.residual)
    keep = np.asarray(base.design.keep[:n]) > 0
    index = np.cumsum(keep) - 1

    def kept(groups):
        parts = [index[group[keep[group]]] for group in groups]
        return [part for part in parts if len(part)]

    in_time = (
        None if prepared.time is None else kept(segments(prepared.time, prepared.run))
    )
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
            in_time, in_slip, groups,
        )
        for part, own in zip(rows, stacked, strict=True)
    ]  # fmt: skip
    p = len(hypothesis.z)
    std = np.sqrt(np.maximum(np.diag(hypothesis.covariance)[p:], 0))
    atoms = list(hypothesis.atoms)
    std = np.hypot(
        std * np.sqrt(widening(base, hypothesis)), _misled(base, linear, atoms)
    )
    own = without(linear.columns[:, atoms], linear.jacobian)
    parts = own * hypothesis.amplitude
    together = float(np.sum(parts.sum(axis=1) ** 2))
    return Standing(
        _worst(each),
        tuple(
            float(a) for a in np.abs(hypothesis.amplitude) / np.maximum(std, ROUNDING)
        ),
        float(np.sum(parts**2)) / max(together, ROUNDING) if parts.size else 1.0,
    )
