"""Closure of the gap beyond the noise, on the fitted rows, on files held out, and for a car alike;
and the parts of the error: parameters of a simulator, effects, an unexplained part, and noise."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.special import softmax, stdtrit

from tirefit.diagnosis.engine import NONZERO, ROUNDING
from tirefit.diagnosis.engine.fit import Fit, Key
from tirefit.diagnosis.engine.left_out import AS_GIVEN, OWN_MODEL, SMOOTH, Ladder, jackknife_error
from tirefit.diagnosis.rows.prepared import prepare
from tirefit.diagnosis.rows.rig import Rig
from tirefit.diagnosis.rows.subject import on_rows
from tirefit.diagnosis.summary.case import Case, Concluded
from tirefit.diagnosis.summary.result import Change, HeldOut, Part, Shrinkage

DRAWS = 400  # number of draws and bootstrap samples; 20 are beyond each end of 90 %
INTERVAL = (0.05, 0.95)  # quantiles at the ends of a 90 % interval
NORMAL = 1.645  # its ends for a normal law, in standard errors
WORST = -1.0  # lower limit of the closure: the gap has doubled


def _closed(gap: Any, left: Any) -> np.ndarray:
    """1 - root of (remaining energy / energy of the gap), at least -1."""
    ratio = np.asarray(left) / np.maximum(gap, NONZERO)
    return np.maximum(1 - np.sqrt(ratio), WORST)


def closure_of(
    before: np.ndarray,
    after: np.ndarray,
    variance: np.ndarray,
    run: np.ndarray,
    inflation: float,
    generator: np.random.Generator,
) -> Shrinkage:
    """Closure of a gap. The remaining energy, that of the residuals minus that of the noise, has
    a normal error; its root is >= 0, with a flat prior. The gap is resolvable if its energy is
    three standard deviations of that of the noise.

    Args:
        before, after: (n,) residuals [N] of the base and of the extension.
        variance: (n,) noise variance [N^2], less the part that fitted numbers take up.
        run: (n,) runs; blocks of the bootstrap are within a run.
        inflation: rows per independent row.
    """
    terms = np.stack([before**2 - after**2, after**2 - variance], axis=1)
    gained, left = terms.mean(axis=0)
    means = block_means(terms, run, inflation, generator)
    evenly = np.linspace(0, 1, DRAWS + 2)[1:-1]
    independent = max(len(variance) / inflation, 1.0)
    # One or two blocks give no error from their spread; noise causes at least this much.
    of_noise = np.sqrt(2 * np.mean(variance**2) / independent)
    error = max(np.std(means[:, 1]), of_noise, ROUNDING * abs(left), NONZERO)

    def closed(gains: np.ndarray, value: float) -> np.ndarray:
        # An energy is within six standard errors.
        root = np.sqrt(np.maximum(value, 0.0) + 6.0 * error) * evenly
        below = np.cumsum(softmax(-0.5 * ((root**2 - value) / error) ** 2))
        lefts = np.interp(evenly, below, root) ** 2
        return _closed(np.maximum(gains + lefts, 0.0), lefts)

    # The gain varies with the remaining energy as it does between bootstrap samples.
    drawn = closed(means[np.argsort(means[:, 1]), 0], left)
    middle, (low, high) = float(np.median(drawn)), np.quantile(drawn, INTERVAL).tolist()
    if fewer := [np.median(closed(*less)) for less in without_each(terms, run)]:
        low, high = of_so_few_runs(middle, low, high, np.array(fewer))
    energy = gained + left
    resolvable = bool(energy >= 3.0 * np.sqrt(2 / independent) * np.mean(variance))
    rms = float(np.sqrt(max(energy, 0.0)))
    return Shrinkage(
        rms=rms,
        resolvable=resolvable,
        closed=middle if resolvable else None,
        closed_ci=(low, high) if resolvable else (None, None),
        remaining_rms=(1 - middle) * rms,
    )


def gaps_of(case: Case, generator: np.random.Generator) -> dict[str, Shrinkage]:
    """Closure of the gap of every channel on the fitted rows."""
    base, rows, gaps = case.base, case.base.rows, {}
    forces = [base.forces(*numbers) for numbers in (case.before, case.numbers_of(case.chosen))]
    for channel in rows.channels:
        noise, used = base.noise[channel], ~base.noise[channel].outlier
        before, after = ((rows.observed[channel] - of[channel])[used] for of in forces)
        # Fitted numbers take up a part of the noise.
        fitted = len(case.chosen.pull) * noise.inflation / rows.n
        variance = max(1 - fitted, 0.0) * noise.std[used] ** 2
        gaps[channel] = closure_of(
            before, after, variance, rows.run[used], noise.inflation, generator
        )
    return gaps


def block_means(
    terms: np.ndarray, run: np.ndarray, inflation: float, generator: np.random.Generator
) -> np.ndarray:
    """Means of terms (n, k) over rows resampled in blocks: (draws, k)."""
    length = int(max(2 * inflation, len(terms) // 60))  # at most 60 blocks of a record
    blocks = []
    for code in np.unique(run):
        rows = np.flatnonzero(run == code)
        blocks += np.array_split(rows, max(len(rows) // length, 1))
    sizes = np.array([len(rows) for rows in blocks])
    sums = np.array([terms[rows].sum(axis=0) for rows in blocks])
    drawn = generator.multinomial(len(blocks), [1 / len(blocks)] * len(blocks), DRAWS)
    return drawn @ sums / (drawn @ sizes)[:, None]


def without_each(terms: np.ndarray, run: np.ndarray) -> np.ndarray:
    """Means of terms (n, k) with each run left out: (R, k); empty for a single run."""
    codes = np.unique(run)
    if len(codes) < 2:
        return np.zeros((0, terms.shape[1]))
    return np.array([terms[run != code].mean(axis=0) for code in codes])


def of_so_few_runs(
    value: float, low: float, high: float, one_less: np.ndarray
) -> tuple[float, float]:
    """A 90 % interval (low, high) of a value widened to the jackknife's over the runs,
    by Student's t; ``one_less`` (R,) are the values with each run left out."""
    reach = float(stdtrit(len(one_less) - 1, INTERVAL[1]) * jackknife_error(one_less))
    return max(min(low, value - reach), WORST), min(max(high, value + reach), 1.0)


def of_the_ladder(ladder: Ladder) -> HeldOut | None:
    """Closure by the last set of the ladder on the data left out; None without effects."""
    steps = ladder.steps[:-2]
    if not steps or steps[-1].effects in ((), AS_GIVEN):
        return None
    base, floor = steps[0].rms_left_out, ladder.steps[-1].rms_left_out
    rms, closed = float(np.sqrt(max(base**2 - floor**2, 0.0))), steps[-1].closed
    reach = NORMAL * steps[-1].closed_std
    return HeldOut(
        rms=rms,
        resolvable=True,
        closed=closed,
        closed_ci=(max(closed - reach, WORST), min(closed + reach, 1.0)),
        remaining_rms=(1 - closed) * rms,
        on=ladder.on,
    )


def held_out(
    case: Case, holdout: Sequence[Any], rig: Rig, generator: np.random.Generator
) -> tuple[HeldOut | None, Ladder]:
    """Closure by the effects that help on data left out, and the ladder with the closure of
    each step there.

    Args:
        holdout: other files; without them the closure is that of the ladder.
    """
    ladder = case.ladder
    if not holdout:
        return of_the_ladder(ladder), ladder
    base, rows = case.base, case.base.rows
    main, runs = rows.channels[0], 0
    scale = np.median(base.noise[main].std / rows.inputs.fz)
    steps, parts = fits_of(case, ladder), []
    sets = [case.before, *map(case.numbers_of, (case.chosen, *steps.values()))]
    for data in holdout:
        left_out, shown = prepare(data, rig, rows.channels), rows.shown
        if shown is not None and rows.scatter:  # only a part of the scatter is noise
            shown = min(shown, left_out.scatter)
        other = on_rows(base, prepare(data, rig, rows.channels, shown), rig)
        missed = [other.rows.observed[main] - other.forces(*numbers)[main] for numbers in sets]
        parts.append(((scale * other.rows.inputs.fz) ** 2, other.rows.run + runs, *missed))
        runs += len(data.runs)
    variance, run, before, after, *others = map(np.concatenate, zip(*parts, strict=True))
    left = {AS_GIVEN: before, **dict(zip(steps, others, strict=True))}
    closure = closure_of(before, after, variance, run, base.noise[main].inflation, generator)
    return on_files(ladder, closure, left, variance, ", ".join(data.name for data in holdout))


def fits_of(case: Concluded, ladder: Ladder) -> dict[Key, Fit]:
    """The fit of each step of a ladder that is a set of effects."""
    keys = [tuple(sorted(step.effects)) for step in ladder.steps]
    return {k: case.weighed.best_of[k] for k in keys if k in case.weighed.best_of}


def on_files(
    ladder: Ladder,
    closure: Shrinkage,
    missed: Mapping[Key, np.ndarray],
    variance: np.ndarray | float,
    on: str,
) -> tuple[HeldOut, Ladder]:
    """The closure on held-out files, and the ladder with the closure of each step there.

    Args:
        missed: (n,) residuals there of each set, first of the base.
        variance: (n,) or scalar noise variance.
        on: names of the files.
    """
    gap, steps = np.mean(next(iter(missed.values())) ** 2 - variance), []
    for step in ladder.steps:
        residual = missed.get(tuple(sorted(step.effects)))
        if residual is not None:
            share = float(_closed(gap, max(np.mean(residual**2 - variance), 0.0)))
            step = step._replace(
                rms_held_out=float(np.sqrt(np.mean(residual**2))),
                closed_held_out=share if closure.resolvable else None,
            )
        steps.append(step)
    return HeldOut(**vars(closure), on=on), ladder._replace(steps=tuple(steps))


PARAMETERS = "parameters"


def budget_of(ladder: Ladder) -> tuple[Part, ...]:
    """Parts of the mean square error on data left out, with 90 % intervals, in the order of the
    ladder: parameters of a simulator, each effect that helps, what is unexplained, and noise.

    The shares add to one. A step that increases the error counts zero.
    """
    steps = [step for step in ladder.steps if step.effects not in (OWN_MODEL, SMOOTH)]
    if not steps:
        return ()
    left = np.minimum.accumulate([step.rms_left_out**2 for step in steps])
    whole, errors = max(float(left[0]), NONZERO), [step.gain_std for step in steps[1:]]
    added = [[e for e in b.effects if e not in a.effects] for a, b in pairwise(steps[:-1])]
    names = [*(" + ".join(new) or PARAMETERS for new in added), "unexplained", "noise"]
    energies = [*(-np.diff(left)).tolist(), float(left[-1])]
    parts = []
    for name, energy, error in zip(names, energies, [*errors, errors[-1]], strict=True):
        reach = NORMAL * error
        ends = max(energy - reach, 0.0) / whole, min((energy + reach) / whole, 1.0)
        parts.append(Part(name, float(np.sqrt(energy)), energy / whole, ends))
    return tuple(parts)


def parameter_changes(case: Case) -> Mapping[str, Change]:
    """The parameters of the simulator as given, and as measured by :meth:`Case.parameters`; empty
    if a form was fitted."""
    layout, simulator = case.base.tire.layout, case.base.simulator
    if simulator is None:
        return {}
    values = zip(layout.labels, layout.vector(simulator.z), *case.natural, strict=True)
    return {name: changed(*map(float, numbers)) for name, *numbers in values}


def changed(given: float, measured: float, error: float) -> Change:
    """A parameter of a simulator as given and as measured."""
    return Change(given, measured, error, abs(measured - given) > 2.0 * error)
