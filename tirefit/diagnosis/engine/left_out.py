"""Predict data left out by each set of effects: one linear step from the fit to all data. One
partition serves naming, the ladder and the errors of amplitudes.

Does one size fit all? A cause has the same size at every load, speed, slip and time; an
effect that stands in for another one needs other sizes in other places."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import softmax

from tirefit.diagnosis.engine import FLAT, NONZERO, ROUNDING, UNSEEN
from tirefit.diagnosis.engine.discrepancy import SIZES
from tirefit.diagnosis.engine.fit import Fit, Folds, Forward, Key, without

AS_GIVEN: Key = ("as given",)
"""``Step.effects`` of a simulator as given, the first step of its ladder."""

OWN_MODEL: Key = ("own model",)
"""``Step.effects`` of the library's own model with effects, fitted to the measured rows, in the
ladder of a simulator; its gain is over the simulator with parameters and effects changed."""

SMOOTH: Key = ("anything smooth",)
NOISE: Key = ("noise",)
"""``Step.effects`` of the last two steps of a ladder: the part that smooth functions
close, and the noise floor."""


class LeftOut(NamedTuple):
    """Errors of a model on each part that it was not fitted to: the mean square of the first
    channel, in its unit (F,); the sum of squares of all channels over the noise (F,); and the
    parameters (F, p) and amplitudes in prior scales (F, k) without each part."""

    loss: np.ndarray
    whitened: np.ndarray
    parameters: np.ndarray
    amplitude: np.ndarray


class Predicted(NamedTuple):
    """Sets of effects on each part of the ``folds``, with the number of values (F,) of the first
    channel; ``smooth`` is "anything smooth", ``as_given`` a simulator whose parameters are not
    refitted: both without parameters."""

    folds: Folds
    rows: np.ndarray
    sets: Mapping[Key, LeftOut]
    smooth: LeftOut
    as_given: LeftOut | None = None

    @property
    def first(self) -> np.ndarray:
        """Loss (F,) of the first step of the ladder."""
        return (self.as_given or self.sets[()]).loss


class Gain(NamedTuple):
    """The gain of a set of effects over another on data left out: the difference of the sums of
    squares over the noise (all channels), and the share of the gap beyond the noise that it closes
    (first channel), with standard errors over the parts that were left out."""

    gain: float
    std: float
    closed: float
    closed_std: float


class Step(NamedTuple):
    """One step of the ladder.

    Attributes:
        effects: ids of the set; ("as given",) first, of a simulator whose parameters
            are not refitted; ("own model",) after those of a simulator, ("anything smooth",)
            and ("noise",) at the end.
        rms_left_out: of observed minus predicted on the data left out.
        closed: share of what the first step leaves beyond the noise that is closed there.
        closed_std: its standard error over the parts left out.
        gain: decrease of the mean square by the step; the last two steps are compared
            with the last set of effects.
        gain_std: its standard error.
        rms_held_out: rms on the held-out files; None without such files, for a set
            that was not refitted, and for the last two steps.
        closed_held_out: share of the gap closed there, beyond the noise.
    """

    effects: Key
    rms_left_out: float
    closed: float
    closed_std: float
    gain: float
    gain_std: float
    rms_held_out: float | None = None
    closed_held_out: float | None = None


class Ladder(NamedTuple):
    """The steps, and in ``on`` what was left out; no steps if nothing could be."""

    on: str = ""
    steps: tuple[Step, ...] = ()


def predicted(subject: Forward, sets: Sequence[Fit], null: Fit, folds: Folds) -> Predicted:
    """Errors of every set on each part, by a linear step to the other parts."""
    unit = subject.unit
    outs = [folds.code == number for number in range(folds.number)]
    first = [out & (unit > 0) for out in outs]

    def errors(left: Sequence[np.ndarray]) -> np.ndarray:
        """Loss, and whitened sum of squares, of residuals (m,) for each part: (2, F)."""
        mean = [np.mean((x * unit)[rows] ** 2) for x, rows in zip(left, first, strict=True)]
        return np.array([mean, [np.sum(x[out] ** 2) for x, out in zip(left, outs, strict=True)]])

    each, none = {}, np.zeros((2, len(outs), 0))
    every = np.empty((2, len(outs), len(sets)))
    for s, fit in enumerate(sets):
        moved, p = np.array([fit.without(out) for out in outs]), len(fit.z)
        every[..., s] = errors([fit.residual - fit.columns @ step for step in moved])
        mean, total = every[..., s]
        ends = fit.z + moved[:, :p], fit.amplitude + moved[:, p:]
        each[fit.key] = LeftOut(mean, total, *ends)
    given = subject.given_residual
    return Predicted(
        folds,
        np.array([rows.sum() for rows in first]),
        each,
        LeftOut(*errors(_smooth(subject, null, outs)), *none),
        None if given is None else LeftOut(*errors([given] * len(outs)), *none),
    )


def _smooth(subject: Forward, null: Fit, outs: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Residuals (m,), for each part, of the model without effects plus smooth functions that are
    fitted to the other parts; averaged over the sizes of the functions by their evidence."""
    columns = np.concatenate([null.columns, subject.discrepancy.additive], axis=1)
    p, whole = null.columns.shape[1], np.column_stack([columns, null.residual])
    parts = [whole[out] for out in (*outs, ~np.any(outs, axis=0))]
    products = np.array([part.T @ part for part in parts])
    ridges = np.repeat(SIZES[:, None] ** -2.0, columns.shape[1], axis=1)
    ridges[:, :p] = np.maximum(null.pull**2, FLAT)
    left = []
    for f in range(len(outs)):
        others = np.delete(products, f, axis=0).sum(axis=0)
        gram, score, logs, fits = others[:-1, :-1], others[:-1, -1], [], []
        for ridge in ridges:
            factor = cho_factor(gram + np.diag(ridge), lower=True, check_finite=False)
            fitted = cho_solve(factor, score, check_finite=False)
            curvature = 2 * np.sum(np.log(np.diag(factor[0])))
            logs.append(0.5 * (score @ fitted - curvature + np.sum(np.log(ridge[p:]))))
            fits.append(fitted)
        left.append(null.residual - columns @ (softmax(logs) @ np.array(fits)))
    return left


def _error(parts: np.ndarray) -> float:
    """Standard error of a sum of independent parts (F,)."""
    return float(np.sqrt(len(parts)) * np.std(parts, ddof=1))


def gained(out: Predicted, new: Key, old: Key, floor: float) -> Gain:
    """The gain of set ``new`` over set ``old``.

    Args:
        floor: mean square of the noise of the first channel.
    """
    after, before = out.sets[new], out.sets[old]
    parts = before.whitened - after.whitened
    closed, error = closed_share(out.rows, after.loss, before.loss, floor)
    return Gain(float(parts.sum()), _error(parts), closed, error)


def jackknife_error(values: np.ndarray | Sequence[float]) -> np.ndarray | np.floating:
    """Standard error of an estimate by the jackknife, of shape (...).

    Args:
        values: (parts, ...) the estimate with each part of the data left out.
    """
    return np.sqrt(len(values) - 1) * np.std(values, axis=0)


def closed_share(
    rows: np.ndarray, after: np.ndarray, before: np.ndarray, floor: float
) -> tuple[float, float]:
    """1 - rms(after) / rms(before) beyond the noise, and its error by the jackknife
    over the parts left out."""
    weights = rows * np.vstack([np.ones(len(rows)), 1 - np.eye(len(rows))])
    shares = weights / weights.sum(axis=1, keepdims=True)
    # A gap of less than a hundredth of the energy of the noise is not resolved.
    gap = np.maximum(shares @ before - floor, max(0.01 * floor, NONZERO))
    left = np.maximum(shares @ after - floor, 0.0)
    whole, *each = np.clip(1 - np.sqrt(left / gap), -1.0, 1.0)
    return float(whole), float(jackknife_error(each))


def ladder_of(out: Predicted, key: Key, floor: float) -> Ladder:
    """The steps from no effect to a set of effects, then the limits of any model.

    Each step adds the effect that predicts the data left out best.

    Args:
        key: the named effects; the step to a set that was not refitted is left out.
        floor: mean square of the noise of the first channel.
    """
    share = out.rows / out.rows.sum()
    first, loss = out.first, {k: left.loss for k, left in out.sets.items()}

    def step(effects: Key, after: np.ndarray, before: np.ndarray) -> Step:
        parts, rms = share * (before - after), float(np.sqrt(share @ after))
        closed = closed_share(out.rows, after, first, floor) if effects != NOISE else (1.0, 0.0)
        return Step(effects, rms, *closed, float(parts.sum()), _error(parts))

    now: Key = ()
    order: Key = ()
    steps = [step((), loss[()], first)]
    if out.as_given is not None:
        steps.insert(0, step(AS_GIVEN, first, first))
    for size in range(1, len(key) + 1):
        larger = [k for k in loss if len(k) == size and {*now} < {*k} <= {*key}]
        if larger:
            best = min(larger, key=lambda k: out.sets[k].whitened.sum())
            order += tuple(e for e in best if e not in order)
            steps.append(step(order, loss[best], loss[now]))
            now = best
    steps.append(step(SMOOTH, out.smooth.loss, loss[now]))
    steps.append(step(NOISE, np.full(len(share), floor), loss[now]))
    return Ladder(out.folds.on, tuple(steps))


class SizeByGroup(NamedTuple):
    """The size of an effect in groups of one covariate, in ascending order of the covariate.

    Attributes:
        covariate: of the groups; ``at`` its median in each.
        size: in the unit of the amplitude; ``std`` their standard errors.
        spread: standard deviation of the sizes beyond that of their errors, over the size
            that fits all: near zero for a cause, often a quarter and more for an effect that
            stands in for another one.
        explains: share of the mean square of the remainder that unequal sizes explain.
    """

    covariate: str
    at: tuple[float, ...]
    size: tuple[float, ...]
    std: tuple[float, ...]
    spread: float
    explains: float = 0.0


def grouped(values: np.ndarray) -> np.ndarray:
    """Group (n,) of each value: its settings if there are up to four, else quarters of the rows."""
    settings = np.unique(values)
    if len(settings) <= 4:
        return np.searchsorted(settings, values)
    edges = np.unique(np.quantile(values, [0.25, 0.5, 0.75]))
    return np.searchsorted(edges, values, side="right")


def sizes_by_group(
    fit: Fit, atom: int, groups: Mapping[str, np.ndarray], noise: float = 1.0, unit: float = 1.0
) -> list[SizeByGroup]:
    """The size of one effect of a fit in the groups of each covariate, most unequal first.

    Args:
        atom: number of the effect's atom in the fit.
        groups: values (m,) of each covariate for the residuals.
        noise: mean square of the remainder, at least one, that widens the errors.
        unit: prior scale of the amplitude in its own unit.
    """
    place, every = fit.atoms.index(atom), groups.items()
    sizes = [_sizes(fit, place, name, values, noise, unit) for name, values in every]
    return sorted((size for size in sizes if size is not None), key=lambda size: -size.spread)


def _sizes(
    fit: Fit, place: int, name: str, values: np.ndarray, noise: float, unit: float
) -> SizeByGroup | None:
    """:func:`sizes_by_group` for one covariate; None for a single group."""
    code, column = grouped(values), len(fit.z) + place
    whole, amplitude = fit.columns[:, column], float(fit.amplitude[place])
    felt = np.bincount(code, whole**2) > UNSEEN * float(whole @ whole)
    groups = np.flatnonzero(felt)
    if len(groups) < 2:
        return None
    split = whole[:, None] * (code[:, None] == groups)
    # Unequal sizes beside everything that is in the fit.
    left, rest = fit.remainder(split), fit.remainder()
    score = left.T @ rest
    gained = score @ np.linalg.pinv(left.T @ left, hermitian=True, rcond=UNSEEN) @ score
    # Each size, beside the others of the set.
    pull = np.delete(fit.pull, column)
    others = np.concatenate([np.delete(fit.columns, column, axis=1), np.diag(pull)])
    target = np.concatenate([fit.residual + whole * amplitude, np.zeros(len(pull))])
    split = without(np.concatenate([split, np.zeros((len(pull), len(groups)))]), others)
    inverse = np.linalg.inv(split.T @ split + ROUNDING * np.eye(len(groups)))
    size = inverse @ (split.T @ target)
    std = np.sqrt(np.maximum(np.diag(inverse), 0.0) * max(noise, 1.0))
    return SizeByGroup(
        name,
        tuple(float(np.median(values[code == k])) for k in groups),
        tuple((unit * size).tolist()),
        tuple((abs(unit) * std).tolist()),
        _spread(size, std, amplitude),
        float(gained) / max(float(rest @ rest), NONZERO),
    )


def _spread(size: np.ndarray, std: np.ndarray, whole: float) -> float:
    """Spread of sizes beyond their errors over the whole size; by the groups that know it to
    three times itself."""
    known = (std > 0) & (std < 3.0 * max(abs(whole), NONZERO))
    if known.sum() < 2:
        return 0.0
    weight = 1 / std[known] ** 2
    mean = float(weight @ size[known]) / float(weight.sum())
    # DerSimonian and Laird (1986): variance between groups beyond their errors.
    square = float(weight @ (size[known] - mean) ** 2)
    scale = weight.sum() - np.sum(weight**2) / weight.sum()
    between = max(square - (known.sum() - 1), 0.0) / max(float(scale), NONZERO)
    return float(np.sqrt(between)) / max(abs(whole), NONZERO)
