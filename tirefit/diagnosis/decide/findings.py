"""Inputs of :func:`tirefit.diagnosis.decide.verdict.decide` for one file, and calibrated
probabilities of verdicts and of unlisted effects.

The calibration is learned from trials whose cause is known. ``python -m
fits.calibration`` writes it to ``calibration.json``: two numbers for each.
"""

import json
import math
from dataclasses import replace
from functools import cache
from importlib import resources
from itertools import chain, combinations

import numpy as np
from scipy.special import expit, logit

from tirefit.diagnosis.decide.remainder import remainder_tests, widening
from tirefit.diagnosis.decide.verdict import POLICY, Findings, Fitted, Policy, Tests, no_gap_shows
from tirefit.diagnosis.evidence.base import Base
from tirefit.diagnosis.evidence.posterior import Key, Weighed, linear_at, weigh
from tirefit.diagnosis.evidence.search import PRIOR_OF_UNKNOWN, Hypothesis, Search, amplitudes_of
from tirefit.diagnosis.left_out import (
    Gain,
    Predicted,
    climbed,
    folds_of,
    gained,
    jackknife_error,
    of_one_run,
    predicted,
)
from tirefit.diagnosis.negligible import ROUNDING
from tirefit.diagnosis.rows.basis import without

_LEADING = 6
"""Numbers of the most probable sets, and of the most probable single effects, that are
refitted without each part of the data."""

_FARTHEST = 7.0
"""Largest log odds that are distinguished."""


def predictions(base: Base, search: Search, policy: Policy = POLICY) -> tuple[Weighed, Predicted]:
    """The posterior, and the predictions of data left out by the leading sets and their
    subsets. If whole runs are left out, the set that predicts them best is included."""
    climb: Key = ()
    whole = search.best
    parts = [_part(whole, key) for key in parts_of(whole.effects)[1:]]
    search.refit([p.atoms for p in parts], {p.atoms: (p.z, p.amplitude) for p in parts})
    weighed = weigh(search)
    own = {a.effect.id for a in base.atoms if "runs" in a.effect.needs}
    of_runs = sum(p for key, p in weighed.listed.items() if own & set(key))
    rows_each = max(noise.inflation for noise in base.noise.values())
    folds = folds_of(base.rows, rows_each, of_runs <= policy.likely)
    if folds.across_runs:
        climb = tuple(sorted(climbed(base, search, folds, policy.gain).effects))
        weighed = weigh(search)
    log = weighed.log_weight
    ranked = sorted((k for k in log if k), key=lambda k: log[k], reverse=True)
    singles = [k for k in ranked if len(k) == 1]
    wanted = [(), *ranked[:_LEADING], *singles[:_LEADING], *([climb] if climb else [])]
    sets = {k: weighed.best_of[k] for k in wanted}
    for key in (*ranked[:2], climb):
        for less in parts_of(key)[1:]:
            sets.setdefault(less, weighed.best_of.get(less, _part(sets[key], less)))
    out = predicted(base, [*sets.values()], folds)
    return weighed, out._replace(climbed=climb)


def parts_of(key: tuple) -> list[tuple]:
    """A set of effects and its subsets, the largest first."""
    sizes = range(len(key), 0, -1)
    return list(chain.from_iterable(combinations(key, size) for size in sizes))


def _part(whole: Hypothesis, key: Key) -> Hypothesis:
    """A fit reduced to some of its effects, to start the refit of an unsearched set."""
    kept = [k for k, effect in enumerate(whole.effects) if effect in key]
    return replace(
        whole,
        atoms=tuple(whole.atoms[k] for k in kept),
        effects=tuple(whole.effects[k] for k in kept),
        amplitude=whole.amplitude[kept],
    )


def floor_of(base: Base, out: Predicted) -> float:
    """Mean square of the noise of the first channel [N^2], at most the mean square error of
    the base model on left-out rows, which a stated or an estimated noise may exceed."""
    left = out.rows @ out.loss[:, out.effects.index(())] / out.rows.sum()
    return min(float(np.mean(base.noise[base.rows.channels[0]].std ** 2)), float(left))


def findings_of(
    base: Base,
    weighed: Weighed,
    out: Predicted,
    generator: np.random.Generator,
    policy: Policy = POLICY,
) -> Findings:
    """The findings of the search, of the data left out and of the remainder.

    Args:
        generator: of simulated residuals.
    """
    best = weighed.best
    key = () if no_gap_shows(weighed, policy) else best
    tests = remainder_tests(base, weighed, key, generator)
    unlisted = as_often_right("unlisted", weighed.unlisted)
    unlisted = max(unlisted, probability_by_tests(tests))
    if key and unlisted > policy.likely and out.across_runs:
        # The evidence assumes a known noise. If an unlisted effect is present, it is
        # overconfident on the effects that resemble it.
        key = out.climbed or tuple(e for e in key if e not in of_one_run(base))
    floor = floor_of(base, out)
    parts = [part for part in parts_of(key) if part in weighed.log_weight]
    return Findings(
        weighed=weighed,
        sets={
            part: Fitted(amplitude_over_error(base, weighed, out, part), gains_of(out, part, floor))
            for part in sorted(parts, key=lambda k: (-len(k), -weighed.log_weight[k]))
        },
        across_runs=out.across_runs,
        unlisted=unlisted,
        tests=tests,
    )


def gains_of(out: Predicted, key: Key, floor: float) -> dict[str, Gain]:
    """The gain of each effect of a set in addition to the others."""
    at, gains = {one: k for k, one in enumerate(out.effects)}, {}
    for effect in key:
        less = tuple(sorted(set(key) - {effect}))
        if key in at and less in at:
            gains[effect] = gained(out, at[key], at[less], floor)
    return gains


def amplitude_over_error(base: Base, weighed: Weighed, out: Predicted, key: Key):
    """Amplitude over its standard error, by effect. The error is that from the rows,
    widened by the remainder of the set and by the slip uncertainty, or that of the
    jackknife over the parts left out, whichever is larger."""
    best = weighed.best_of[key]
    linear = linear_at(base, best)
    p, size = len(best.z), np.abs(best.amplitude)
    left = base.residual(best.z, amplitudes_of(base, best))
    variance = np.diag(best.covariance)[p:] * widening(base, left)
    jacobian, own = linear.used_up[:, :p], linear.used_up[:, p:]
    own = without(own, jacobian)
    moved = np.linalg.solve(own.T @ own + np.eye(len(size)), own.T @ base.doubt)
    variance = np.maximum(variance, 0.0) + np.sum(moved**2, axis=1)
    if key in out.effects:
        left_out = jackknife_error(out.amplitude[out.effects.index(key)])
        variance = np.maximum(variance, left_out**2)
    error = np.sqrt(np.maximum(variance, ROUNDING))
    return dict(zip(best.effects, (size / error).tolist(), strict=True))


@cache
def _numbers() -> dict:
    file = resources.files("tirefit.diagnosis") / "calibration.json"
    return json.loads(file.read_text())


def probability_by_tests(tests: Tests) -> float:
    """Probability of an unlisted effect by the smallest p-value of the tests of the
    remainder (Bonferroni).

    The tests detect shapes that the discrepancy does not have, such as mains hum. The
    largest Bayes factor of a p-value is 1 / (-e p log p) (Sellke, Bayarri and Berger
    2001); the prior odds are those of an unlisted effect.
    """
    made = [p for p in tests if p is not None]
    p = max(len(made), 1) * min(made, default=1.0)
    odds = PRIOR_OF_UNKNOWN / (1 - PRIOR_OF_UNKNOWN)
    if p < 1 / math.e:
        odds /= -math.e * p * math.log(p)
    return float(odds / (1 + odds))


def as_often_right(status: str, probability: float) -> float:
    """Share of verdicts of this status and this probability that are right.

    Args:
        status: of the verdict; "noise" if it names only an effect on the noise;
            "unlisted" for the probability of an unlisted effect.
    """
    offset, slope = _numbers().get(status, (0.0, 1.0))
    odds = np.clip(logit(np.clip(probability, 0.0, 1.0)), -_FARTHEST, _FARTHEST)
    return float(expit(offset + slope * odds))
