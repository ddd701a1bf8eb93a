"""Closure of the gap, and its parts. On the fitted rows the closure is computed from draws of
the true force, as a remaining gap may be below the noise; on data not used, from the
energies there. The parts are parameters of a simulator, effects, an unexplained part, and
noise; their squares add up."""

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from math import comb
from typing import Any

import numpy as np
from scipy.special import softmax, stdtrit

from tirefit.diagnosis.engine import NONZERO, ROUNDING
from tirefit.diagnosis.engine.discrepancy import Beside
from tirefit.diagnosis.engine.fit import Fit, Key
from tirefit.diagnosis.engine.left_out import AS_GIVEN, Ladder, jackknife_error
from tirefit.diagnosis.rows.fits import refit
from tirefit.diagnosis.rows.prepared import prepare
from tirefit.diagnosis.rows.rig import Rig
from tirefit.diagnosis.rows.subject import Base, on_rows
from tirefit.diagnosis.summary.case import Case, Concluded, beside
from tirefit.diagnosis.summary.result import Change, HeldOut, Part, Shrinkage

DRAWS = 400  # number of draws and bootstrap samples; 20 are beyond each end of 90 %
INTERVAL = (0.05, 0.95)  # quantiles at the ends of a 90 % interval
_RESOLVED = 3.0  # a gap is resolved if its energy exceeds noise by this many standard deviations
WORST = -1.0  # lower limit of the closure: the gap has doubled
_BLOCKS = 60  # largest number of blocks of a record
_SETS = 3  # number of the most probable sets of effects in the draws
_SIZES = np.geomspace(0.03, 30, 16)  # of a smooth remainder, in usual changes, equally likely
_UNDRAWN, _FACTOR = 0.4, 1.5
"""Remainder of other shapes, over the smooth one: median, and standard deviation of the
logarithm. Development trials have .2 to .6."""
_FAR = 6.0  # range of an energy, in standard errors
_NINETY = 1.645  # standard errors on both sides of a 90 % interval


def plausible_forces(case: Case, generator: np.random.Generator) -> dict[str, np.ndarray]:
    """Draws of the true force of every used row at its measured slip: (n, draws) by
    channel. Each is of one set of effects, by its probability in a ``Case``, with an
    error of its parameters and a smooth remainder."""
    base, weighed, channels = case.base, case.weighed, case.base.rows.channels
    total = {k: alone + weighed.beside.get(k, 0.0) for k, alone in weighed.sets.items()}
    likely = sorted(total, key=lambda key: -total[key])[:_SETS]
    chances = np.array([total[key] for key in likely])
    counts, drawn = generator.multinomial(DRAWS, chances / chances.sum()), []
    for key, count in zip(likely, counts, strict=True):
        if count:
            fit = weighed.best_of[key]
            force = base.measured.forces(fit.z, base.amplitudes(fit.atoms, fit.amplitude))
            off = np.split(_off(base, fit, count, generator), len(channels))
            scales = (np.asarray(base.design.scale[c])[: base.rows.n, None] for c in channels)
            pairs = zip(channels, scales, off, strict=True)
            drawn.append([force[c][:, None] + scale * own for c, scale, own in pairs])
    return {c: np.concatenate(x, axis=1) for c, *x in zip(channels, *drawn, strict=True)}


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


def _closed(gap: Any, left: Any) -> np.ndarray:
    """1 - root of (remaining energy / energy of the gap), at least -1."""
    ratio = np.asarray(left) / np.maximum(gap, NONZERO)
    return np.maximum(1 - np.sqrt(ratio), WORST)


def _shrinkage(
    energy: float,
    closed: np.ndarray,
    fewer: Sequence[float],
    least: float,
    variance: np.ndarray,
    inflation: float,
) -> Shrinkage:
    """From the mean square [N^2] of the gap, its closure in draws (d,), the median closure
    with each run left out (R,), and the ``least`` energy by which the gap is resolved."""
    effective = max(len(variance) / inflation, 1.0)
    resolvable = bool(least >= _RESOLVED * np.sqrt(2 / effective) * np.mean(variance))
    middle, (low, high) = float(np.median(closed)), np.quantile(closed, INTERVAL)
    if len(fewer):
        low, high = of_so_few_runs(middle, low, high, np.asarray(fewer))
    rms = float(np.sqrt(max(energy, 0.0)))
    return Shrinkage(
        rms=rms,
        resolvable=resolvable,
        closed=middle if resolvable else None,
        closed_ci=(float(low), float(high)) if resolvable else (None, None),
        remaining_rms=(1 - middle) * rms,
    )


def closure_on_rows(
    truth: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    variance: np.ndarray,
    run: np.ndarray,
    inflation: float,
) -> Shrinkage:
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
    fewer = [np.median(_closed(*means)) for means in one_less]
    least, closed = float(np.quantile(gap, INTERVAL[0])), _closed(gap, rests.mean(axis=0))
    return _shrinkage(float(np.median(gap)), closed, fewer, least, variance, inflation)


def closure_elsewhere(
    before: np.ndarray,
    after: np.ndarray,
    variance: np.ndarray,
    run: np.ndarray,
    inflation: float,
    generator: np.random.Generator,
) -> Shrinkage:
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

    def closed(gains: np.ndarray, value: float) -> np.ndarray:
        root = np.sqrt(np.maximum(value, 0.0) + _FAR * error) * evenly
        below = np.cumsum(softmax(-0.5 * ((root**2 - value) / error) ** 2))
        lefts = np.interp(evenly, below, root) ** 2
        return _closed(np.maximum(gains + lefts, 0.0), lefts)

    # The gain varies with the remaining energy as it does between bootstrap samples.
    drawn = closed(means[np.argsort(means[:, 1]), 0], left)
    fewer = [np.median(closed(*means)) for means in without_each(terms, run)]
    return _shrinkage(gained + left, drawn, fewer, gained + left, variance, inflation)


def block_means(
    terms: np.ndarray, run: np.ndarray, inflation: float, generator: np.random.Generator
) -> np.ndarray:
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


def without_each(terms: np.ndarray, run: np.ndarray) -> np.ndarray:
    """Means of terms (n, k) with each run left out: (R, k); empty for a single run."""
    codes = np.unique(run)
    if len(codes) < 2:
        return np.zeros((0, terms.shape[1]))
    return np.array([terms[run != code].mean(axis=0) for code in codes])


def of_so_few_runs(
    value: np.ndarray | float,
    low: np.ndarray | float,
    high: np.ndarray | float,
    one_less: np.ndarray,
) -> tuple[np.ndarray | float, np.ndarray | float]:
    """A 90 % interval (low, high) of a value widened to the jackknife's over the runs,
    by Student's t; ``one_less`` (R, ...) are the values with each run left out."""
    count = len(one_less)
    reach = float(stdtrit(count - 1, INTERVAL[1])) * jackknife_error(one_less)
    low = np.maximum(np.minimum(low, value - reach), WORST)
    return low, np.minimum(np.maximum(high, value + reach), 1.0)


def of_the_ladder(ladder: Ladder) -> HeldOut | None:
    """Closure by the last set of the ladder on the data left out; None without effects."""
    steps = ladder.steps[:-2]
    if not steps or steps[-1].effects in ((), AS_GIVEN):
        return None
    base, floor = steps[0].rms_left_out, ladder.steps[-1].rms_left_out
    rms, closed = float(np.sqrt(max(base**2 - floor**2, 0.0))), steps[-1].closed
    reach = _NINETY * steps[-1].closed_std
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
    sets = [(base.as_given, base.amplitudes())]
    sets += [
        (one.z, base.amplitudes(one.atoms, one.amplitude)) for one in (case.chosen, *steps.values())
    ]
    for data in holdout:
        left_out, shown = prepare(data, rig, rows.channels), rows.shown
        if shown is not None and rows.scatter:  # only a part of the scatter is noise
            shown = min(shown, left_out.scatter)
        other = on_rows(base, prepare(data, rig, rows.channels, shown), rig)
        missed = [other.rows.observed[main] - other.forces(*one)[main] for one in sets]
        parts.append(((scale * other.rows.inputs.fz) ** 2, other.rows.run + runs, *missed))
        runs += len(data.runs)
    variance, run, before, after, *others = map(np.concatenate, zip(*parts, strict=True))
    left = {AS_GIVEN: before, **dict(zip(steps, others, strict=True))}
    closure = closure_elsewhere(before, after, variance, run, base.noise[main].inflation, generator)
    return on_files(ladder, closure, left, variance, ", ".join(one.name for one in holdout))


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
        own = missed.get(tuple(sorted(step.effects)))
        if own is not None:
            share = float(_closed(gap, max(np.mean(own**2 - variance), 0.0)))
            closed, rms = share if closure.resolvable else None, float(np.sqrt(np.mean(own**2)))
            step = step._replace(rms_held_out=rms, closed_held_out=closed)
        steps.append(step)
    return HeldOut(**vars(closure), on=on), ladder._replace(steps=tuple(steps))


PARAMETERS = "parameters"
_DIFFERS = 2.0  # standard errors from which a parameter of a simulator counts as different
_HELD = 1e4  # stiffness that holds parameters z: they move by 1e-8 of the gradient


def subsets(players: tuple[Any, ...]) -> list[tuple[Any, ...]]:
    """All subsets of the players, the empty one first, each in the order of players."""
    return [x for size in range(len(players) + 1) for x in combinations(players, size)]


def shapley(players: tuple[Any, ...], worth: Callable[[tuple[Any, ...]], float]) -> dict[Any, Any]:
    """Shapley value of every player: its mean gain over all orders. ``worth`` takes
    each of the :func:`subsets`."""
    count, known = len(players), {chosen: worth(chosen) for chosen in subsets(players)}
    values = dict.fromkeys(players, 0.0)
    for player in players:
        for without in (chosen for chosen in known if player not in chosen):
            joined = tuple(p for p in players if p in (*without, player))
            # Share of the orders in which exactly this subset precedes the player.
            share = 1 / (count * comb(count - 1, len(without)))
            values[player] += share * (known[joined] - known[without])
    return values


def budgets_of(case: Case, generator: np.random.Generator) -> dict[str, tuple[Part, ...]]:
    """Parts of the energy of every channel: parameters (of a simulator), each named
    effect, unexplained, noise; their shares add to one."""
    base, found = case.base, {}
    players = ((PARAMETERS,) if base.simulator else ()) + case.chosen.atoms
    for channel, missed in _missed(base, case.chosen).items():
        noise = base.noise[channel]
        used = ~noise.outlier
        kept = {key: own[used] for key, own in missed.items()}
        whole, rest = kept[()] ** 2, kept[players] ** 2
        closed = {subset: whole - own**2 for subset, own in kept.items()}
        parts = shapley(players, closed.__getitem__)
        named = {p if p == PARAMETERS else base.atoms[p].effect.id: x for p, x in parts.items()}
        fitted = len(case.chosen.pull) * noise.inflation / base.rows.n
        energies = rest, max(1 - fitted, 0.0) * noise.std[used] ** 2, whole
        found[channel] = budget(named, energies, base.rows.run[used], noise.inflation, generator)
    return found


def budget(
    parts: Mapping[str, np.ndarray],
    rest: tuple[np.ndarray, np.ndarray, np.ndarray],
    run: np.ndarray,
    inflation: float,
    generator: np.random.Generator,
) -> tuple[Part, ...]:
    """Parts of the energy of a channel with 90 % intervals; their shares add to one.

    Args:
        parts: (n,) energy that each part closes.
        rest: (n,) energies of the remainder, of the noise in it, and of the whole.
        run, inflation: as in :func:`closure_elsewhere`.
    """
    terms = np.stack([*parts.values(), *rest], axis=1)
    energies = _energies(terms.mean(axis=0))

    def shares(energies: np.ndarray) -> np.ndarray:
        return energies[..., :-1] / energies[..., -1:]

    drawn = shares(_energies(block_means(terms, run, inflation, generator)))
    low, high = np.quantile(drawn, INTERVAL, axis=0)
    if len(fewer := without_each(terms, run)):
        low, high = of_so_few_runs(shares(energies), low, high, shares(_energies(fewer)))
    ends = np.clip([low, high], 0.0, 1.0).T.tolist()
    columns = np.sqrt(energies[:-1]).tolist(), shares(energies).tolist(), map(tuple, ends)
    return tuple(map(Part, [*parts, "unexplained", "noise"], *columns))


def _energies(means: np.ndarray) -> np.ndarray:
    """Convert means (..., parts + 3) of the parts, the remainder, the noise and the whole
    to non-negative ones that add up to the whole, with the remainder beyond the noise and
    the remaining noise. A part that increases the error counts zero; the others share the
    energy that was closed."""
    parts = np.maximum(means[..., :-3], 0.0)
    left, noise, whole = np.moveaxis(means[..., -3:], -1, 0)
    whole = np.maximum(whole, NONZERO)
    total = np.sum(parts, axis=-1)
    left = np.where(total > 0, np.minimum(left, whole), whole)
    parts = parts * ((whole - left) / np.where(total > 0, total, 1.0))[..., None]
    noise = np.minimum(left, noise)
    rest = np.stack([left - noise, noise, whole], axis=-1)
    return np.concatenate([parts, rest], axis=-1)


def _missed(base: Base, chosen: Fit) -> dict[str, dict[tuple[Any, ...], np.ndarray]]:
    """Residual (n,) of every channel for each subset of the players. All subsets are
    refitted; the parameters of the simulator are held unless they are in the subset."""
    atoms, sets = chosen.atoms, subsets(chosen.atoms)
    guess = [chosen.amplitude[[atoms.index(k) for k in s]] for s in sets]
    freed = refit(base.tire, [(chosen.z, a) for a in guess], sets, base.design)
    free = dict(zip(sets, zip(freed.z, freed.amplitude, strict=True), strict=True))
    free[atoms] = chosen.z, chosen.amplitude
    fits: dict[tuple[Any, ...], tuple[Any, ...]] = {**free}
    if base.simulator is not None:
        start, held = base.simulator.z, base.design._replace(hold=np.array(_HELD))
        stuck = refit(base.tire, [(start, a) for a in guess], sets, held)
        fits = {(PARAMETERS, *s): fit for s, fit in free.items()}
        fits |= {s: (start, a) for s, a in zip(sets, stuck.amplitude, strict=True)}
    forces = {
        subset: base.forces(z, base.amplitudes([k for k in subset if k != PARAMETERS], amplitude))
        for subset, (z, amplitude) in fits.items()
    }
    return {
        channel: {k: base.rows.observed[channel] - own[channel] for k, own in forces.items()}
        for channel in base.rows.channels
    }


def parameter_changes(case: Case) -> Mapping[str, Change]:
    """The parameters of the simulator as given, and as measured by :meth:`Case.parameters`; empty
    if a form was fitted."""
    layout, simulator = case.base.tire.layout, case.base.simulator
    if simulator is None:
        return {}
    values = zip(layout.labels, layout.vector(simulator.z), *case.natural, strict=True)
    return {name: changed(*map(float, one)) for name, *one in values}


def changed(given: float, measured: float, error: float) -> Change:
    """A parameter of a simulator as given and as measured."""
    return Change(given, measured, error, abs(measured - given) > _DIFFERS * error)
