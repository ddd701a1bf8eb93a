"""Predict data left out of the fit with each set of effects. One partition of a file is
used for naming, for the ladder and for the errors of amplitudes."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import softmax

from tirefit.data.levels import levels
from tirefit.diagnosis.evidence.base import Base
from tirefit.diagnosis.evidence.changes import MOST_EFFECTS
from tirefit.diagnosis.evidence.posterior import Key
from tirefit.diagnosis.evidence.search import Hypothesis, Search
from tirefit.diagnosis.negligible import FLAT, NONZERO
from tirefit.diagnosis.rows.basis import SCALES
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.diagnosis.rows.slips import shown_runs

LEAST_RUNS = 4
"""Smallest number of runs for leaving out whole runs: three measured circles, two to one
side, do not show a slip offset that four logs show at 14 standard errors."""

_BLOCKS, _LEAST_ROWS = 8, 12
"""Largest number of blocks of time or parts of the slip; smallest number of rows of a fold."""

_UNRESOLVED = 0.01
"""Energy of the smallest gap that is resolved, over the energy of the noise."""

_SINGLES, _SETS = 8, 12
"""Numbers of the most probable single effects and sets whose effects the climb tries."""

AS_GIVEN: Key = ("as given",)
"""``Step.effects`` of a simulator as given, the first step of its ladder."""

SMOOTH: Key = ("anything smooth",)
NOISE: Key = ("noise",)
"""``Step.effects`` of the last two steps of a ladder: the part that the discrepancy
closes, and the noise floor."""


class Folds(NamedTuple):
    """A partition of the rows. ``code`` (n,) is the fold of each row, -1 for a row that
    is never left out; ``on`` names the parts for the report; ``across_runs``: whether
    the parts are whole runs."""

    code: np.ndarray
    on: str
    across_runs: bool = False

    @property
    def number(self) -> int:
        return int(self.code.max()) + 1


class Predicted(NamedTuple):
    """Sets of effects fitted without each fold, and their errors on it.

    ``on`` and ``across_runs`` are those of the :class:`Folds`. ``loss`` (F, S) is the
    mean squared error [N^2] of set s in the first channel of fold f, ``whitened`` (F, S)
    the sum of squares of all channels over the noise, ``rows`` (F,) the number in the
    fold, ``amplitude`` the refitted amplitudes by set: (F, k), in prior scales.
    ``smooth`` (F,) is the loss of "anything smooth", ``climbed`` the set found by the
    climb over whole runs, ``as_given`` (F,) the loss of a simulator whose parameters are
    not refitted.
    """

    on: str
    across_runs: bool
    effects: tuple[Key, ...]
    loss: np.ndarray
    whitened: np.ndarray
    rows: np.ndarray
    amplitude: tuple[np.ndarray, ...]
    smooth: np.ndarray
    climbed: Key = ()
    as_given: np.ndarray | None = None


class Gain(NamedTuple):
    """The gain of a set of effects over another on data left out: the difference of the sums of
    squares over the noise (all channels), and the share of the gap beyond the noise that it closes
    (first channel), with standard errors over the ``parts`` that were left out."""

    gain: float
    std: float
    closed: float
    closed_std: float
    parts: int


class Step(NamedTuple):
    """One step of the ladder.

    Attributes:
        effects: ids of the set; ("as given",) first, of a simulator whose parameters
            are not refitted; ("anything smooth",) and ("noise",) at the end.
        rms_left_out: of observed minus predicted on the rows left out [N].
        closed: share of what the first step leaves beyond the noise that is closed there.
        closed_std: its standard error over the parts left out.
        gain: decrease of the mean square by the step [N^2]; the last two steps are
            compared with the last set of effects.
        gain_std: its standard error.
        rms_held_out: rms on the held-out files [N]; None without such files, for a set
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


def folds_of(prepared: Prepared, rows_each: float, across_runs: bool = True) -> Folds:
    """The partition of the used rows: whole runs if there are four or more, else blocks of
    time, else settings and parts of the slip.

    Args:
        rows_each: rows per independent row of the noise; a block of time holds several
            times as many.
        across_runs: whether runs may be left out; an effect that belongs to one run
            cannot be predicted from the others.
    """
    runs = shown_runs(prepared.run, prepared.data.runs)
    if across_runs and len(runs) >= LEAST_RUNS:
        code = np.full(prepared.n, -1)
        for number, run in enumerate(runs):
            code[prepared.run == run] = number
        return Folds(code, f"{len(runs)} runs left out in turn", True)
    most = int(prepared.n // max(_LEAST_ROWS, 4 * rows_each))
    count = max(min(_BLOCKS, most), 2)
    if prepared.time is not None and np.ptp(prepared.time) and not prepared.random_order:
        # Order runs by name, as their codes follow the order of the rows.
        place = np.argsort(np.argsort(prepared.data.runs))
        code = _in_parts(np.lexsort((prepared.time, place[prepared.run])), count)
        return Folds(code, f"{count} blocks of time left out in turn")
    settings = [levels(prepared.inputs.fz), levels(prepared.covariates.v)]
    each = [found.code for found in settings if found.few()]
    if each:
        _, code, sizes = np.unique(each, axis=1, return_inverse=True, return_counts=True)
        if len(sizes) > 2 and sizes.min() >= _LEAST_ROWS:
            on = f"{len(sizes)} settings of load and speed left out in turn"
            return Folds(code, on)
    parts = _in_parts(np.argsort(prepared.slip, kind="stable"), 2 * count) % count
    return Folds(parts, f"{count} parts of the slip range left out in turn")


def _in_parts(order: np.ndarray, count: int) -> np.ndarray:
    code = np.empty(len(order), int)
    code[order] = np.arange(len(order)) * count // len(order)
    return code


def _judged_on(base: Base, out: np.ndarray) -> np.ndarray:
    """Rows of a fold (n,) without outliers; all of them if all are outliers."""
    good = out & (base.design.keep[: base.rows.n] > 0)
    return good if good.any() else out


def predicted(base: Base, sets: Sequence[Hypothesis], folds: Folds) -> Predicted:
    """Refit every set without each fold in turn, from its fit to all rows."""
    n, main = base.rows.n, base.rows.channels[0]
    names = sorted(base.rows.observed)
    observed = np.stack([base.rows.observed[c] for c in names])
    scale = np.stack([np.asarray(base.design.scale[c])[:n] for c in names])
    starts, atoms = [(h.z, h.amplitude) for h in sets], [h.atoms for h in sets]
    outs = [folds.code == fold for fold in range(folds.number)]
    refit = base.refit_folds(starts, atoms, [~out for out in outs])
    loss = np.empty((folds.number, len(sets)))
    whitened, rows = np.empty_like(loss), np.empty(folds.number, int)
    as_given = np.empty(folds.number)
    given = base.rows.observed[main] - base.forces(base.as_given, base.amplitudes())[main]
    for f, out in enumerate(outs):
        good = _judged_on(base, out)
        rows[f] = good.sum()
        fits = [
            (refit.z[f, k], base.amplitudes(own, refit.amplitude[f, k]))
            for k, own in enumerate(atoms)
        ]
        missed = (observed - base.forces_each(fits))[:, :, good]
        loss[f] = np.mean(missed[:, names.index(main)] ** 2, axis=1)
        whitened[f] = np.sum((missed / scale[:, good]) ** 2, axis=(1, 2))
        as_given[f] = np.mean(given[good] ** 2)
    sizes = tuple(refit.amplitude[:, k, : len(own)] for k, own in enumerate(atoms))
    keys = tuple(tuple(sorted(h.effects)) for h in sets)
    smooth = np.array([_smooth_loss(base, out) for out in outs])
    return Predicted(
        folds.on,
        folds.across_runs,
        keys,
        loss,
        whitened,
        rows,
        sizes,
        smooth,
        as_given=as_given if base.simulator else None,
    )


def _smooth_loss(base: Base, out: np.ndarray) -> float:
    """Mean squared error [N^2] of "anything smooth" in a fold (n,): the smooth functions
    of the discrepancy added to the base model, linearised at its fit, averaged over
    their scale by its evidence on the other rows."""
    n, channels = base.rows.n, base.rows.channels
    residual, jacobian, *_ = base.at_null
    columns, p = np.concatenate([jacobian, base.generic.smooth], 1), jacobian.shape[1]
    inside = np.tile((base.design.keep[:n] > 0) & ~out, len(channels))
    own, rest = columns[inside], residual[inside]
    gram, score = own.T @ own, own.T @ rest
    logs, fits = [], []
    for size in SCALES:
        ridge = np.full(columns.shape[1], size**-2.0)
        ridge[:p] = FLAT
        factor = cho_factor(gram + np.diag(ridge))
        found = cho_solve(factor, score)
        log = 0.5 * score @ found - np.sum(np.log(np.diag(factor[0])))
        logs.append(log + 0.5 * np.sum(np.log(ridge[p:])))
        fits.append(found)
    left = residual[:n] - columns[:n] @ (softmax(logs) @ np.array(fits))
    left = left * base.design.scale[channels[0]][:n]
    return float(np.mean(left[_judged_on(base, out)] ** 2))


def _error(parts) -> float:
    """Standard error of a sum of independent parts (F,)."""
    return float(np.sqrt(len(parts)) * np.std(parts, ddof=1))


def gained(out: Predicted, new: int, old: int, floor: float) -> Gain:
    """The gain of set ``new`` over set ``old``.

    Args:
        floor: mean square of the noise of the first channel [N^2].
    """
    parts = out.whitened[:, old] - out.whitened[:, new]
    closed, error = _closed(out.rows, out.loss[:, new], out.loss[:, old], floor)
    return Gain(float(parts.sum()), _error(parts), closed, error, len(parts))


def jackknife_error(values) -> np.ndarray | np.floating:
    """Standard error of an estimate by the jackknife, of shape (...).

    Args:
        values: (parts, ...) the estimate with each part of the data left out.
    """
    return np.sqrt(len(values) - 1) * np.std(values, axis=0)


def _closed(rows, after, before, floor: float) -> tuple[float, float]:
    """1 - rms(after) / rms(before) beyond the noise, and its error by the jackknife
    over the parts left out."""
    weights = rows * np.vstack([np.ones(len(rows)), 1 - np.eye(len(rows))])
    shares = weights / weights.sum(axis=1, keepdims=True)
    gap = np.maximum(shares @ before - floor, max(_UNRESOLVED * floor, NONZERO))
    left = np.maximum(shares @ after - floor, 0.0)
    whole, *each = np.clip(1 - np.sqrt(left / gap), -1.0, 1.0)
    return float(whole), float(jackknife_error(each))


def ladder_of(out: Predicted, key: Key, floor: float) -> Ladder:
    """The steps from no effect to a set of effects, then the limits of any model.

    Each step adds the effect that predicts the rows left out best.

    Args:
        key: the named effects; the step to a set that was not refitted is left out.
        floor: mean square of the noise of the first channel [N^2].
    """
    share = out.rows / out.rows.sum()
    loss = dict(zip(out.effects, out.loss.T, strict=True))
    total = dict(zip(out.effects, out.whitened.sum(axis=0), strict=True))

    first = loss[()] if out.as_given is None else out.as_given

    def step(effects: Key, after, before) -> Step:
        parts, rms = share * (before - after), float(np.sqrt(share @ after))
        closed = (1.0, 0.0)
        if effects != NOISE:
            closed = _closed(out.rows, after, first, floor)
        return Step(effects, rms, *closed, float(parts.sum()), _error(parts))

    now: Key = ()
    order: Key = ()
    steps = [step((), loss[()], first)]
    if out.as_given is not None:
        steps.insert(0, step(AS_GIVEN, first, first))
    for size in range(1, len(key) + 1):
        larger = [k for k in loss if len(k) == size and {*now} < {*k} <= {*key}]
        if larger:
            best = min(larger, key=lambda k: total[k])
            order += tuple(e for e in best if e not in order)
            steps.append(step(order, loss[best], loss[now]))
            now = best
    steps.append(step(SMOOTH, out.smooth, loss[now]))
    steps.append(step(NOISE, np.full(len(share), floor), loss[now]))
    return Ladder(out.on, tuple(steps))


def climbed(base: Base, search: Search, folds: Folds, needed: float) -> Hypothesis:
    """The set that predicts whole runs best, found by adding one effect at a time; every
    set on the way is refitted to all rows.

    A step adds the effect that predicts the runs left out best; then each of the others
    may be replaced by one that predicts them better. Among sets that differ by less than
    ``needed`` standard errors, the most probable by evidence is taken. The climb ends if
    no step gains more than that.
    """
    atoms = _steps(base, search)

    def better(now: Hypothesis, kept: tuple[int, ...]) -> Hypothesis:
        """The best of ``now`` and the sets of ``kept`` atoms and one more."""
        there = {base.atoms[k].effect.id for k in kept}
        new = [k for effect, k in atoms.items() if effect not in there]
        sets = [tuple(sorted((*kept, k))) for k in new]
        # A refit starts from the known amplitudes of its effects.
        singles = (h for h in search.fitted if len(h.atoms) == 1)
        sizes = {h.atoms[0]: h.amplitude[0] for h in singles}
        sizes |= dict(zip(now.atoms, now.amplitude, strict=True))
        known = [s for s in sets if sizes.keys() >= {*s}]
        search.refit(sets, {s: (now.z, np.array([sizes[k] for k in s])) for s in known})
        fits = [search.tried[s] for s in sets if s in search.tried]
        tried = [now, *(h for h in fits if h.refitted)]
        out = predicted(base, tried, folds)
        best = int(np.argmin(out.whitened.sum(axis=0)))

        def beats(new: int, old: int) -> bool:
            gain = gained(out, new, old, 0.0)
            return gain.gain > needed * gain.std

        steps = [k for k in range(len(tried)) if beats(k, 0) and not beats(best, k)]
        return tried[max(steps, key=lambda k: tried[k].log_weight, default=0)]

    now, size = search.tried[()], 0
    while size == len(now.atoms) < MOST_EFFECTS:
        now, size = better(now, now.atoms), size + 1
        for gone in now.atoms if size == len(now.atoms) > 1 else ():
            now = better(now, tuple(k for k in now.atoms if k != gone))
    return now


def of_one_run(base: Base) -> set[str]:
    """Effects of a single run or of one time in it, which other runs cannot show."""
    effects = [atom.effect for atom in base.atoms]
    return {e.id for e in effects if "runs" in e.needs or e.scans_time}


def _steps(base: Base, search: Search) -> dict[str, int]:
    """Effects that may be steps, each with its atom in the best set that contains it."""
    ranked = search.fitted
    singles = [h for h in ranked if len(h.atoms) == 1][:_SINGLES]
    atoms: dict[str, int] = {}
    own = of_one_run(base)
    for hypothesis in (*ranked[:_SETS], *singles):
        for k, effect in zip(hypothesis.atoms, hypothesis.effects, strict=True):
            if effect not in own:
                atoms.setdefault(effect, k)
    return atoms
