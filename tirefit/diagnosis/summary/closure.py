"""Closure of the gap. On the fitted rows it is computed from draws of the true force, as
a remaining gap may be below the noise; on data not used, from the energies there."""

from collections.abc import Sequence

import numpy as np
from scipy.special import softmax, stdtrit

from tirefit.diagnosis.engine.discrepancy import Beside
from tirefit.diagnosis.engine.fit import Fit
from tirefit.diagnosis.engine.left_out import AS_GIVEN, Ladder, jackknife_error
from tirefit.diagnosis.negligible import NONZERO, ROUNDING
from tirefit.diagnosis.rows.prepared import prepare
from tirefit.diagnosis.rows.subject import Base, on_rows
from tirefit.diagnosis.summary.case import Case, beside
from tirefit.diagnosis.summary.records import HeldOut, Shrinkage

DRAWS = 400  # number of draws and bootstrap samples; 20 are beyond each end of 90 %
INTERVAL = (0.05, 0.95)  # quantiles at the ends of a 90 % interval
_RESOLVED = 3.0
"""A gap is resolved if its energy exceeds noise by this many standard deviations."""
WORST = -1.0  # lower limit of the closure: the gap has doubled
_BLOCKS = 60  # largest number of blocks of a record
_SETS = 3  # number of the most probable sets of effects in the draws
_SIZES = np.geomspace(0.03, 30, 16)
"""Sizes of a smooth remainder, in usual changes, all equally likely."""
_UNDRAWN, _FACTOR = 0.4, 1.5
"""Remainder of other shapes, over the smooth one: median, and standard deviation of the
logarithm. Development trials have .2 to .6."""
_FAR = 6.0  # range of an energy, in standard errors
_NINETY = 1.645  # standard errors on both sides of a 90 % interval


def plausible_forces(case: Case, generator: np.random.Generator) -> dict[str, np.ndarray]:
    """Draws of the true force of every used row at its measured slip: (n, draws) by
    channel. Each is of one set of effects, by its probability in a ``Case``, with an
    error of its parameters and a smooth remainder."""
    base, weighed, at = case.base, case.weighed, case.base.measured
    total = {k: alone + weighed.beside.get(k, 0.0) for k, alone in weighed.sets.items()}
    likely = sorted(total, key=lambda key: -total[key])[:_SETS]
    chances = np.array([total[key] for key in likely])
    counts = generator.multinomial(DRAWS, chances / chances.sum())
    drawn: dict[str, list] = {channel: [] for channel in base.rows.channels}
    for key, count in zip(likely, counts, strict=True):
        if not count:
            continue
        fit = weighed.best_of[key]
        force = at.forces(fit.z, base.amplitudes(fit.atoms, fit.amplitude))
        off = np.split(_off(base, fit, count, generator), len(drawn))
        for (channel, parts), own in zip(drawn.items(), off, strict=True):
            scale = np.asarray(base.design.scale[channel])[: base.rows.n, None]
            parts.append(force[channel][:, None] + scale * own)
    return {channel: np.concatenate(parts, axis=1) for channel, parts in drawn.items()}


def _off(base: Base, fit: Fit, count: int, generator: np.random.Generator) -> np.ndarray:
    """Draws (m, count) of the error of a fit, whitened: of its parameters and amplitudes, of
    a smooth remainder, and of one of other shapes."""
    values, vectors = np.linalg.eigh(fit.covariance)
    # A symmetric root, so that the signs of eigenvectors do not change the draws.
    spread = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    own = base.columns_at(fit) @ (spread @ generator.standard_normal((len(spread), count)))
    smooth = Beside(base.discrepancy.additive, fit, _SIZES).drawn(count, generator)
    discrepancy = beside(base, fit) @ smooth
    share = _UNDRAWN * np.exp(_FACTOR * generator.standard_normal(count))
    rms = share * np.sqrt(np.mean(discrepancy**2, axis=0))
    return own + discrepancy + rms * generator.standard_normal(discrepancy.shape)


def _closed(gap, left) -> np.ndarray:
    """1 - root of (remaining energy / energy of the gap), at least -1."""
    ratio = np.asarray(left) / np.maximum(gap, NONZERO)
    return np.maximum(1 - np.sqrt(ratio), WORST)


def _is_resolvable(gap, variance, inflation) -> bool:
    effective = max(len(variance) / inflation, 1.0)
    return bool(gap >= _RESOLVED * np.sqrt(2 / effective) * np.mean(variance))


def _shrinkage(rms, closed, fewer, resolvable: bool) -> Shrinkage:
    """From the rms [N] of the gap, its closure in draws (d,), and the median closure
    with each run left out (R,)."""
    middle, (low, high) = float(np.median(closed)), np.quantile(closed, INTERVAL)
    if len(fewer):
        low, high = of_so_few_runs(middle, low, high, np.asarray(fewer))
    return Shrinkage(
        rms=rms,
        resolvable=resolvable,
        closed=middle if resolvable else None,
        closed_ci=(float(low), float(high)) if resolvable else (None, None),
        remaining_rms=(1 - middle) * rms,
    )


def closure_on_rows(truth, before, after, variance, run, inflation) -> Shrinkage:
    """Closure on the fitted rows: median and interval of its draws. The gap is resolvable if at
    most one draw in twenty is below 3 sqrt(2 / n_effective) of the energy of the noise.

    Args:
        truth: (n, draws) of :func:`plausible_forces` [N].
        before, after: (n,) forces [N] of the base and of the extension.
        variance: (n,) noise variance [N^2].
        run: (n,) runs.
        inflation: rows per independent row.
    """
    gaps, rests = (truth - before[:, None]) ** 2, (truth - after[:, None]) ** 2
    gap = gaps.mean(axis=0)
    one_less = zip(without_each(gaps, run), without_each(rests, run), strict=True)
    return _shrinkage(
        float(np.sqrt(np.median(gap))),
        _closed(gap, rests.mean(axis=0)),
        [np.median(_closed(*means)) for means in one_less],
        _is_resolvable(np.quantile(gap, INTERVAL[0]), variance, inflation),
    )


def closure_elsewhere(before, after, variance, run, inflation, generator) -> Shrinkage:
    """Closure on rows that neither fit used. The remaining energy, that of the residuals
    minus that of the noise, has a normal error; its root is >= 0, with a flat prior.

    Args:
        before, after: (n,) residuals [N] of the base and of the extension.
        variance, inflation: as in :func:`closure_on_rows`.
        run: (n,) runs; blocks of the bootstrap are within a run.
    """
    terms = np.stack([before**2 - after**2, after**2 - variance], axis=1)
    gained, left = terms.mean(axis=0)
    means = block_means(terms, run, inflation, generator)
    evenly = np.linspace(0, 1, DRAWS + 2)[1:-1]
    # One or two blocks give no error from their spread; noise causes at least this much.
    of_noise = np.sqrt(2 * np.mean(variance**2) * inflation / len(variance))
    error = max(np.std(means[:, 1]), of_noise, ROUNDING * abs(left), NONZERO)

    def closed(gains, value):
        root = np.sqrt(np.maximum(value, 0.0) + _FAR * error) * evenly
        below = np.cumsum(softmax(-0.5 * ((root**2 - value) / error) ** 2))
        lefts = np.interp(evenly, below, root) ** 2
        return _closed(np.maximum(gains + lefts, 0.0), lefts)

    # The gain varies with the remaining energy as it does between bootstrap samples.
    return _shrinkage(
        float(np.sqrt(max(gained + left, 0.0))),
        closed(means[np.argsort(means[:, 1]), 0], left),
        [np.median(closed(*means)) for means in without_each(terms, run)],
        _is_resolvable(gained + left, variance, inflation),
    )


def block_means(terms, run, inflation, generator) -> np.ndarray:
    """Means of terms (n, k) over rows resampled in blocks: (draws, k)."""
    length = int(max(2 * inflation, len(terms) // _BLOCKS))
    blocks = []
    for code in np.unique(run):
        rows = np.flatnonzero(run == code)
        blocks += np.array_split(rows, max(len(rows) // length, 1))
    sizes = np.array([len(rows) for rows in blocks])
    sums = np.array([terms[rows].sum(axis=0) for rows in blocks])
    drawn = generator.multinomial(len(blocks), [1 / len(blocks)] * len(blocks), DRAWS)
    return drawn @ sums / (drawn @ sizes)[:, None]


def without_each(terms, run) -> np.ndarray:
    """Means of terms (n, k) with each run left out: (R, k); empty for a single run."""
    codes = np.unique(run)
    if len(codes) < 2:
        return np.zeros((0, terms.shape[1]))
    return np.array([terms[run != code].mean(axis=0) for code in codes])


def of_so_few_runs(value, low, high, one_less):
    """A 90 % interval (low, high) of a value widened to the jackknife's over the runs,
    by Student's t; ``one_less`` (R, ...) are the values with each run left out."""
    count = len(one_less)
    reach = float(stdtrit(count - 1, INTERVAL[1])) * jackknife_error(one_less)
    low = np.maximum(np.minimum(low, value - reach), WORST)
    return low, np.minimum(np.maximum(high, value + reach), 1.0)


def held_out(case: Case, holdout: Sequence, rig, ladder: Ladder, generator):
    """Closure by the named effects on data left out, and the ladder with the closure of
    each step there.

    Args:
        holdout: other files; without them the closure is that of the last set of the
            ladder, and None if no effect is named.
    """
    if holdout:
        return _on_files(case, holdout, rig, ladder, generator)
    steps = ladder.steps[:-2]
    if not case.verdict.key or not steps or not steps[-1].effects:
        return None, ladder
    base, step, floor = steps[0], steps[-1], ladder.steps[-1]
    rms = np.sqrt(max(base.rms_left_out**2 - floor.rms_left_out**2, 0.0))
    reach = _NINETY * step.closed_std
    return HeldOut(
        rms=float(rms),
        resolvable=True,
        closed=step.closed,
        closed_ci=(max(step.closed - reach, WORST), min(step.closed + reach, 1.0)),
        remaining_rms=float((1 - step.closed) * rms),
        on=ladder.on,
    ), ladder


def _on_files(case: Case, holdout: Sequence, rig, ladder: Ladder, generator):
    base, rows = case.base, case.base.rows
    main, runs = rows.channels[0], 0
    scale = np.median(base.noise[main].std / rows.inputs.fz)
    keys = [tuple(sorted(step.effects)) for step in ladder.steps]
    steps = {k: case.weighed.best_of[k] for k in keys if k in case.weighed.best_of}
    sets = [(base.as_given, base.amplitudes())]
    sets += [
        (one.z, base.amplitudes(one.atoms, one.amplitude)) for one in (case.chosen, *steps.values())
    ]
    parts = []
    for data in holdout:
        left_out, shown = prepare(data, rig, rows.channels), rows.shown
        if shown is not None and rows.scatter:  # only a part of the scatter is noise
            shown = min(shown, left_out.scatter)
        other = on_rows(base, prepare(data, rig, rows.channels, shown), rig)
        observed = other.rows.observed[main]
        missed = [observed - other.forces(*one)[main] for one in sets]
        variance, run = (scale * other.rows.inputs.fz) ** 2, other.rows.run + runs
        parts.append((variance, run, *missed))
        runs += len(data.runs)
    variance, run, before, after, *others = map(np.concatenate, zip(*parts, strict=True))
    inflation = base.noise[main].inflation
    closure = closure_elsewhere(before, after, variance, run, inflation, generator)
    gap = np.mean(before**2 - variance)

    def extended(step, missed):
        left = np.array([max(np.mean(missed**2 - variance), 0.0)])
        share = float(_closed(gap, left)[0])
        rms = float(np.sqrt(np.mean(missed**2)))
        closed = share if closure.resolvable else None
        return step._replace(rms_held_out=rms, closed_held_out=closed)

    missed_by = {(): before, AS_GIVEN: before}
    missed_by |= dict(zip(steps, others, strict=True))
    added = [
        extended(step, missed_by[key]) if key in missed_by else step
        for step, key in zip(ladder.steps, keys, strict=True)
    ]
    on = ", ".join(data.name for data in holdout)
    return HeldOut(**vars(closure), on=on), ladder._replace(steps=tuple(added))
