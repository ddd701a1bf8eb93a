"""Search for sets of effects of a car, and compute the inputs of its verdict."""

from collections import Counter
from collections.abc import Mapping
from math import factorial

import numpy as np
from scipy.special import logsumexp, softmax, stdtr

from tirefit.diagnosis.decide.findings import gains_of, parts_of, probability_by_tests
from tirefit.diagnosis.decide.verdict import Findings, Fitted, Tests, no_gap_shows
from tirefit.diagnosis.evidence.posterior import Key, Weighed
from tirefit.diagnosis.evidence.search import PRIOR_OF_SIZE, PRIOR_OF_UNKNOWN
from tirefit.diagnosis.left_out import LEAST_RUNS, Predicted
from tirefit.diagnosis.negligible import FLAT, NONZERO
from tirefit.diagnosis.rows.basis import SCALES
from tirefit.vehicle.evidence import MOST, PARAMETERS, SHAPES, Base, Fit

_SINGLES, _WIDE, _DEEP = 8, 3, 2
"""Numbers of single effects that are refitted first; of further effects that are added to
each of the most probable sets of a size; and of these sets."""

_WEAK = 3.0
"""Log evidence with which data must show an effect: 20 to 1."""

_LOST = 10.0
"""A further effect that costs more log evidence has not reached the minimum of its fit."""

_FAR = 0.7
"""Logarithm of a factor on the tires from which a fit with one effect more is tried
from the tires as given, too."""

_BLOCKS = 8
"""Number of parts of the time that are left out in turn."""

_LEADING = 6
"""Numbers of the most probable sets and single effects that are tested on them."""

_ROUNDS = 2
"""Number of times that the noise is estimated again for the car without effects."""

_OTHER_NOISE = 0.25
"""Change of the log noise above which the search is repeated."""


class _Search:
    """The fits of sets of atoms so far, and for some the products of all columns."""

    def __init__(self, base: Base, null: Fit):
        self.base = base
        self.fits: dict[tuple[int, ...], Fit] = {(): null}
        self.whole = {null.atoms: base.everything(null)}
        self.ids = [atom.effect.id for atom in base.model.atoms]
        self.variants = Counter(self.ids[k] for k in base.testable)
        self.alone = base.one_more(null, self.whole[()])

    def prior(self, atoms: tuple[int, ...]) -> float:
        """Logarithm of the prior of a set, split over effects and their variants."""
        size, every = len(atoms), max(len(self.variants), 1)
        shared = sum(np.log(self.variants[self.ids[k]] * every) for k in atoms)
        return float(np.log(PRIOR_OF_SIZE[size] * factorial(size)) - shared)

    def weight(self, fit: Fit) -> float:
        """Log evidence over no effect plus log prior."""
        more = fit.log_evidence - self.fits[()].log_evidence
        return more + self.prior(fit.atoms)

    def refit(self, parent: Fit, more: int) -> None:
        """A fit with one more atom, started from the linear step of the first fit."""
        atoms = tuple(sorted((*parent.atoms, more)))
        if atoms in self.fits:
            return
        base, first = self.base, len(PARAMETERS)
        own = [*parent.own, first + more]
        z, pull = parent.z.copy(), np.append(parent.pull, 1.0)
        total = self.whole[parent.atoms].of(slice(None)).some(own)
        z[own] += total.step(pull, z[own])
        z[first + more] = np.clip(z[first + more], base.low[more], base.high[more])
        fits = [base.fitted(atoms, z, parent.starts)]
        if fits[0].log_evidence < parent.log_evidence - _LOST:
            # The linear step is a bad start.
            fits.append(base.fitted(atoms, parent.z, parent.starts))
        if np.max(np.abs(parent.z[:first])) > _FAR:
            # Without the effect, the tires were distorted to replace it.
            z = np.where(np.arange(len(z)) < first, 0.0, parent.z)
            fits.append(base.fitted(atoms, z, self.base.cut.data.start))
        self.fits[atoms] = max(fits, key=lambda one: one.log_evidence)

    def best(self, size: int, count: int) -> list[Fit]:
        """The most probable fits of a size, one for each set of effects."""
        fits = [fit for fit in self.fits.values() if len(fit.atoms) == size]
        found: dict[Key, Fit] = {}
        for fit in sorted(fits, key=self.weight, reverse=True):
            found.setdefault(_key(fit), fit)
        return [*found.values()][:count]

    def beside(self, parent: Fit, count: int) -> list[int]:
        """Atoms of further effects that add most, one of each effect."""
        if parent.atoms not in self.whole:
            self.whole[parent.atoms] = self.base.everything(parent)
        more = self.base.one_more(parent, self.whole[parent.atoms])
        order = sorted(
            self.base.testable, key=lambda k: np.log(self.variants[self.ids[k]]) - more[k]
        )
        found: dict[str, int] = {}
        for k in order:
            if self.ids[k] not in parent.effects:
                found.setdefault(self.ids[k], k)
        return [*found.values()][:count]

    def climb(self) -> None:
        """Refit single effects, then those that add most to the best sets of each size."""
        for more in self.beside(self.fits[()], _SINGLES):
            self.refit(self.fits[()], more)
        for size in range(1, MOST):
            before = self.best(size, _DEEP)
            for parent in before:
                for more in self.beside(parent, _WIDE):
                    self.refit(parent, more)
            after = self.best(size + 1, 1)
            if not after or self.weight(after[0]) < self.weight(before[0]):
                break

    def parts(self, whole: Fit) -> None:
        """Refit the subsets of the effects of a fit."""
        for part in parts_of(whole.atoms)[1:]:
            if part not in self.fits:
                fit = self.base.fitted(tuple(part), whole.z, whole.starts)
                self.fits[tuple(part)] = fit


def _key(fit: Fit) -> Key:
    return tuple(sorted(fit.effects))


def searched(base: Base) -> tuple[Weighed, Predicted, Tests]:
    """Sets of effects, refitted and weighed, with their predictions of windows left out
    and a test of the remainder.

    The noise is the remainder of the best set with all unlisted forces. If it differs
    from that without effects, the search is repeated.
    """
    given = np.zeros(base.model.size)
    base.noise = base.rms(given)
    fit = base.fitted((), given, base.cut.data.start)
    for _ in range(_ROUNDS):
        base.follow(fit)
        base.judge_noise(fit)
        fit = base.fitted((), fit.z, fit.starts)
    search = _Search(base, fit)
    search.climb()
    before = base.noise, base.inflation
    best = max(search.fits.values(), key=search.weight)
    base.judge_noise(best)
    if np.any(np.abs(np.log(base.noise / before[0])) > _OTHER_NOISE):
        search = _Search(base, base.fitted((), fit.z, fit.starts))
        search.climb()
    else:
        base.noise, base.inflation = before
    for best in sorted(search.fits.values(), key=search.weight)[-2:]:
        search.parts(best)
    weighed = _weighed(search)
    return weighed, _predicted(search, weighed), Tests(time=base.p_white)


def _weighed(search: _Search) -> Weighed:
    """Posterior probabilities of all sets, with and without an unlisted effect."""
    base, none = search.base, search.fits[()].log_evidence
    logs: dict[Key, list[float]] = {}
    best_of: dict[Key, Fit] = {}
    for fit in sorted(search.fits.values(), key=search.weight, reverse=True):
        logs.setdefault(_key(fit), []).append(search.weight(fit))
        best_of.setdefault(_key(fit), fit)
    total = {key: float(logsumexp(values)) for key, values in logs.items()}
    ranked = sorted(total, key=total.__getitem__, reverse=True)[:_LEADING]
    beside = {}
    for key in dict.fromkeys([*ranked, ()]):
        fit = best_of[key]
        if fit.atoms not in search.whole:
            search.whole[fit.atoms] = base.everything(fit)
        more = base.unlisted(fit, search.whole[fit.atoms])
        beside[key] = total[key] + more + float(np.log(PRIOR_OF_UNKNOWN))
    tried = {fit.atoms for fit in search.fits.values()}
    untried = [k for k in base.testable if (k,) not in tried]
    rest = np.array([search.alone[k] + search.prior((k,)) for k in untried])
    everything = float(logsumexp([*total.values(), *beside.values(), *rest]))
    weak = search.alone[untried] < _WEAK
    return Weighed(
        best_of=best_of,
        log_weight=total,
        log_beside=beside,
        evidence={k: f.log_evidence - none for k, f in best_of.items()},
        other_form=frozenset(),
        gains={},
        log_total=everything,
        hidden=float(np.exp(rest[weak] - everything).sum()),
    )


def _predicted(search: _Search, weighed: Weighed) -> Predicted:
    """Predictions of logs, or of parts of the time, left out by the leading sets."""
    base, log = search.base, weighed.log_weight
    ranked = sorted((k for k in log if k), key=log.__getitem__, reverse=True)
    singles = [key for key in ranked if len(key) == 1]
    wanted = [(), *ranked[:_LEADING], *singles[:_LEADING]]
    wanted += [part for key in ranked[:2] for part in parts_of(key)[1:]]
    keys = [key for key in dict.fromkeys(map(tuple, wanted)) if key in weighed.best_of]
    folds, on = _folds(base.cut.log)
    fits = [weighed.best_of[key] for key in keys]
    number = int(folds.max()) + 1
    rows = np.array([np.sum(folds == f) for f in range(number)])
    rows = rows * (base.cut.data.logged[0].size - base.cut.data.start.shape[1])
    each = base.inflation / rows  # to the mean square over the noise
    loss, sizes = np.empty((number, len(keys))), []
    for s, fit in enumerate(fits):
        own = fit.z[fit.own]
        amplitude = np.empty((number, len(fit.atoms)))
        for f in range(number):
            step = fit.products.of(folds != f).step(fit.pull, own)
            loss[f, s] = fit.products.of(folds == f).square_after(step)
            amplitude[f] = (own + step)[len(PARAMETERS) :]
        sizes.append(amplitude)
    given = base.products(base.at_best_starts(np.zeros(base.model.size))).square
    smooth = _smooth(search, weighed.best_of[ranked[0]], folds)
    return Predicted(
        on,
        len(set(base.cut.log)) >= LEAST_RUNS,
        tuple(keys),
        loss * each[:, None],
        loss,
        rows,
        tuple(sizes),
        smooth * each,
        as_given=np.array([given[folds == f].sum() for f in range(number)]) * each,
    )


def _folds(log: np.ndarray) -> tuple[np.ndarray, str]:
    """The part of each window (w,): its log if there are enough, else its block of time."""
    count = int(log.max()) + 1
    if count >= LEAST_RUNS:
        return log, f"{count} logs left out in turn"
    count = min(_BLOCKS, len(log))
    part = np.arange(len(log)) * count // len(log)
    return part, f"{count} blocks of time left out in turn"


def _smooth(search: _Search, fit: Fit, folds: np.ndarray) -> np.ndarray:
    """Sum of squares (F,) of each part with a fit and unlisted forces, averaged over
    their scale by the evidence of the other parts."""
    base, count = search.base, len(fit.own)
    first = base.model.size - 2 * SHAPES
    own = [*fit.own, *range(first, base.model.size)]
    whole, z = search.whole[fit.atoms].some(own), fit.z[own]
    found = np.empty(int(folds.max()) + 1)
    for f in range(len(found)):
        others = whole.of(folds != f)
        norm = np.maximum(np.diag(others.gram)[count:], FLAT)
        steps, logs = [], []
        for size in SCALES:
            pull = np.concatenate([fit.pull, norm / size**2])
            step = others.step(pull, z)
            curvature = np.linalg.slogdet(others.gram + np.diag(pull))[1]
            steps.append(step)
            logs.append(
                -0.5 * (others.square_after(step) + pull @ (z + step) ** 2)
                - 0.5 * (curvature - np.sum(np.log(pull[count:])))
            )
        step = np.tensordot(softmax(logs), steps, 1)
        found[f] = whole.of(folds == f).square_after(step)
    return found


def findings(weighed: Weighed, out: Predicted, tests: Tests) -> Findings:
    """The findings of the search and of the data left out.

    The probability of an unlisted effect is the smaller one of its evidence and of its
    prediction of the parts left out, or that of the test of the remainder if larger.
    """
    key = () if no_gap_shows(weighed) else weighed.best
    parts = [part for part in parts_of(key) if part in weighed.log_weight]
    ordered = sorted(parts, key=lambda k: (-len(k), -weighed.log_weight[k]))
    best = out.effects.index(weighed.best)
    gains = (out.loss[:, best] - out.smooth) * out.rows
    error = np.sqrt(len(gains)) * np.std(gains, ddof=1)
    predicts = float(stdtr(len(gains) - 1, gains.sum() / max(error, NONZERO)))
    return Findings(
        weighed=weighed,
        sets={
            tuple(part): Fitted(_ratios(weighed, out, part), gains_of(out, part, 1.0))
            for part in ordered
        },
        across_runs=out.across_runs,
        unlisted=max(min(weighed.unlisted, predicts), probability_by_tests(tests)),
        tests=tests,
    )


def errors(weighed: Weighed, out: Predicted, key: Key) -> np.ndarray:
    """Standard errors of the amplitudes of a set, in prior scales: from the curvature, or
    from the jackknife over the parts left out if that is larger."""
    fit = weighed.best_of[key]
    variance = np.diag(fit.covariance)[len(PARAMETERS) :]
    if key in out.effects:
        each = out.amplitude[out.effects.index(key)]
        off = each - each.mean(axis=0)
        variance = np.maximum(variance, (1 - 1 / len(each)) * np.sum(off**2, axis=0))
    return np.sqrt(variance)


def _ratios(weighed: Weighed, out: Predicted, key: Key) -> Mapping[str, float]:
    """Amplitude over its standard error, by effect."""
    fit = weighed.best_of[key]
    ratio = np.abs(fit.amplitude) / errors(weighed, out, key)
    return dict(zip(fit.effects, ratio.tolist(), strict=True))
