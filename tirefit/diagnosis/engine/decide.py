"""Decide a verdict from the posterior over sets, the predictions of data left out, and the
sizes of effects by group. Only :func:`decide`, a pure function, sets a status.

Two questions about an effect have two answers. Does it help: does the model with it predict
data left out better? And is it the cause: is it there, in a world that also holds effects
which the library does not list? An effect that helps without being the likely cause acts like
the cause: it belongs into a simulator, but says little about the car.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache
from importlib import resources
from typing import Any, NamedTuple

import numpy as np
from scipy.special import expit, logit, stdtr

from tirefit.diagnosis.engine import NONZERO
from tirefit.diagnosis.engine.fit import Forward, Key
from tirefit.diagnosis.engine.left_out import Gain, Predicted, gained, predicted, sizes_by_group
from tirefit.diagnosis.engine.search import Search, Weighed, parts_of, weighed
from tirefit.results import Outcome

UNKNOWN = "unknown"
"""The id of an effect that the library does not list."""

NOT_WRITTEN = {"written": False}
"""Metadata of a field that is not in the document."""


class Status(StrEnum):
    """The conclusion of a diagnosis. It follows from two answers: which effects are
    present, and what remains."""

    NONE = "none"
    """No gap is found: the residuals of the model may be noise."""
    NAMED = "named"
    """Listed effects explain the gap; an unlisted effect is less likely than none."""
    CANNOT_TELL = "cannot_tell"
    """As ``named``, but other effects explain the data as well: see ``also_possible``."""
    INCOMPLETE = "incomplete"
    """Effects are named, but an unlisted effect in addition is likelier than none."""
    UNKNOWN = "unknown"
    """There is a gap, and no listed effect is its likely cause."""

    @property
    def limits(self) -> dict[Outcome, str]:
        """Outcome -> sentence where the answer is open, for a record."""
        if self is Status.CANNOT_TELL:
            return {Outcome.NOT_IDENTIFIED: "other effects explain these data as well"}
        open_answers = {
            Status.INCOMPLETE: "an unlisted effect is more probable than not",
            Status.UNKNOWN: "no listed effect is the likely cause",
        }
        return {Outcome.INCOMPLETE: open_answers[self]} if self in open_answers else {}


@dataclass(frozen=True)
class Policy:
    """The thresholds of :func:`decide`.

    Attributes:
        likely: probability above which an effect counts as present (even odds).
        gain: standard errors by which an effect must improve the prediction of data left out.
        perhaps: probability above which something is possible: no gap, if no effect can
            be named, or an effect that is not named; and probability of a set over that
            of the best above which it is a rival.
        alike: share of the gain of an effect that another one in its place may lack, where
            an unlisted effect is likely, which may have it.
    """

    likely: float = 0.5
    gain: float = 1.0
    perhaps: float = 0.1
    alike: float = 0.1


POLICY = Policy()


class Features(NamedTuple):
    """What tells a cause from an effect that stands in for another one.

    Attributes:
        spread: logarithm of the mean spread of its sizes over groups, see
            :class:`~tirefit.diagnosis.engine.left_out.SizeByGroup`.
        unequal: root of the largest share of the remainder that unequal sizes explain.
        listed: log odds of the sets that hold it, all effects listed.
        beside: log odds of the sets that hold it, beside an unlisted effect.
        unlisted: log odds of an unlisted effect.
        closed: share of the gap that it closes on data left out.
        known: logarithm of its amplitude over its standard error.
        left: logarithm of the mean square of the remainder over the noise.
        others: number of effects of its set.
    """

    spread: float
    unequal: float
    listed: float
    beside: float
    unlisted: float
    closed: float
    known: float
    left: float
    others: float


class Each(NamedTuple):
    """One effect that helps: the probability that it or one of its twins is the cause; the
    share of the gap that it closes on data left out, in addition to the others, with its
    standard error; and its ``twins``: effects that these data cannot distinguish from it."""

    probability: float
    closed_left_out: float
    closed_left_out_std: float
    twins: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Findings:
    """All inputs of a verdict: the posterior over sets; by set (empty if no gap is found, of the
    leading sets first the one that predicts data left out best, then its subsets, the largest and
    most probable first) the gain of each effect on data left out in addition to the others, and the
    features of each; for the first of them its gain over the sets with another effect in the place
    of one, {effect: {other: gain}}; the probability of an unlisted effect, not calibrated; and the
    prior log odds of sets by what is known beside the data."""

    weighed: Weighed
    gains: Mapping[Key, Mapping[str, Gain]]
    features: Mapping[Key, Mapping[str, Features]]
    unlisted: float
    swaps: Mapping[str, Mapping[str, Gain]] = field(default_factory=dict)
    odds: Mapping[Key, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The two answers: which effects are present, and what remains.

    ``effects`` are ids of likely causes, the one that gains most on data left out first;
    empty without a gap, ``("unknown",)`` for a gap without a likely cause; ``acts_like`` are
    the others that help; ``key`` is the set of both. ``probability`` is that of exactly these
    causes without an unlisted effect or, for ``incomplete``, with one. ``also_possible`` are
    ids that these data do not rule out, ``unlisted`` is the probability of an unlisted effect.
    """

    status: Status
    effects: tuple[str, ...] = ()
    acts_like: tuple[str, ...] = ()
    key: Key = field(default=(), metadata=NOT_WRITTEN)
    probability: float
    each: Mapping[str, Each] = field(default_factory=dict)
    also_possible: tuple[str, ...] = ()
    unlisted: float = field(metadata=NOT_WRITTEN)


class Learned(NamedTuple):
    """The calibration, learned from trials whose cause is known, a third of them with
    listed effects only, a third with a listed one beside an unlisted one, a third with an
    unlisted one alone (``python -m fits.calibration`` writes ``calibration.json``).

    Attributes:
        lines: offset and slope in log odds, by status; "noise" of a verdict that names
            only an effect on the noise; "unlisted" of the probability of an unlisted effect.
        weights: of :class:`Features`, after an offset.
    """

    lines: Mapping[str, tuple[float, float]]
    weights: tuple[float, ...]

    def often(self, status: str, probability: float) -> float:
        """Share of verdicts of this status and this probability that are right."""
        offset, slope = self.lines.get(status, (0.0, 1.0))
        return float(expit(offset + slope * _odds(probability)))

    def cause(self, features: Features) -> float:
        """Probability that an effect with these features is there."""
        offset, *weights = self.weights
        return float(expit(offset + np.dot(weights, features)))


@cache
def calibration() -> Learned:
    """The calibration of the package."""
    text = (resources.files("tirefit.diagnosis") / "calibration.json").read_text()
    content = json.loads(text)
    lines = {status: tuple(line) for status, line in content["lines"].items()}
    return Learned(lines, tuple(content["cause"].values()))


def predictions(search: Search) -> tuple[Weighed, Predicted]:
    """The posterior, and the predictions of data left out by the leading sets and their subsets."""
    posterior, count = weighed(search), len(search.fits)
    search.refit_parts(posterior.best_of[posterior.best_beside])
    if len(search.fits) > count:
        posterior = weighed(search)
    ranked = posterior.ranked
    singles = [k for k in ranked if len(k) == 1]
    # The six most probable sets and single effects, and subsets of the leading ones.
    wanted = [(), *ranked[:6], *singles[:6]]
    wanted += [part for key in (*ranked[:2], posterior.best_beside) for part in parts_of(key)]
    # These are not in the posterior: they show what data left out cannot tell apart.
    leading = dict.fromkeys((posterior.best, posterior.best_beside))
    exchanged = [x for key in leading for x in search.refit_exchanged(posterior.best_of[key])]
    fit_of = {fit.key: fit for fit in exchanged} | {**posterior.best_of}
    wanted += [fit.key for fit in exchanged]
    sets = [fit_of[key] for key in dict.fromkeys(wanted) if key in fit_of]
    folds = search.subject.folds(posterior.best)
    return posterior, predicted(search.subject, sets, search.null, folds)


def floor_of(subject: Forward, out: Predicted) -> float:
    """Mean square of the noise of the first channel, at most the mean square error of the
    model without effects on data left out, which an estimated noise may exceed."""
    left = out.rows @ out.sets[()].loss / out.rows.sum()
    return min(subject.floor, float(left))


def findings_of(
    search: Search, posterior: Weighed, out: Predicted, policy: Policy = POLICY
) -> Findings:
    """The findings of the search and of the data left out."""
    subject, unlisted = search.subject, posterior.unlisted
    if out.folds.is_covered:
        # Nothing unlisted is claimed where smooth functions predict no better, but for what
        # no other part could predict, such as a gust.
        better = out.sets[posterior.best].whitened - out.smooth.whitened
        error = max(np.sqrt(len(better)) * np.std(better, ddof=1), NONZERO)
        predicts = float(stdtr(len(better) - 1, better.sum() / error))
        local = subject.discrepancy.local_share(posterior.best_of[posterior.best])
        unlisted = max(min(unlisted, predicts), local * unlisted)
    # Evidence of sets alone takes the noise for all that is left.
    first = posterior.best_beside if unlisted > policy.likely else posterior.best
    wholes = [] if no_gap_shows(posterior, policy) else [*dict.fromkeys((first, posterior.best))]
    # Smooth functions may take the place of a listed effect; data left out tell.
    wholes.sort(key=lambda whole: out.sets[whole].whitened.sum())
    floor, gains = floor_of(subject, out), dict[Key, dict[str, Gain]]()
    for whole in wholes:
        parts = [part for part in parts_of(whole) if part in out.sets]
        for part in sorted(parts, key=lambda k: (-len(k), -posterior.log_weight[k])):
            each = gains_of(out, part, floor)
            if len(each) == len(part):
                gains.setdefault(part, each)
    features = {
        part: _features(subject, posterior, part, each, unlisted) for part, each in gains.items()
    }
    odds = {f.key: float(subject.priors.odds[[*f.atoms]].sum()) for f in search.fits.values()}
    return Findings(
        weighed=posterior,
        gains=gains,
        features=features,
        swaps=swaps_of(out, next(iter(gains), ()), floor),
        unlisted=unlisted,
        odds=odds,
    )


def _features(
    subject: Forward, posterior: Weighed, key: Key, gains: Mapping[str, Gain], unlisted: float
) -> dict[str, Features]:
    """The features of each effect of a set."""
    fit, groups = posterior.best_of[key], subject.groups()
    rest = fit.remainder()
    left = max(float(rest @ rest) / len(fit.residual), NONZERO)
    each = {}
    for place, (atom, effect) in enumerate(zip(fit.atoms, fit.effects, strict=True)):
        sizes = sizes_by_group(fit, atom, groups, left)
        spread = np.mean([size.spread for size in sizes]) if sizes else 0.0
        each[effect] = Features(
            # A spread of .05 is as good as none, above 3 none is distinguished.
            spread=math.log(min(float(spread), 3.0) + 0.05),
            unequal=math.sqrt(max((size.explains for size in sizes), default=0.0)),
            listed=_odds(posterior.holding((effect,))),
            beside=_odds(posterior.holding((effect,), beside=True)),
            unlisted=_odds(unlisted),
            closed=float(np.clip(gains[effect].closed, -1.0, 1.0)),
            known=math.log(max(abs(fit.amplitude[place]) / fit.errors[place], NONZERO)),
            left=math.log(left),
            others=float(len(key)),
        )
    return each


def _odds(probability: float) -> float:
    """Log odds, of which none beyond 7 are distinguished."""
    with np.errstate(divide="ignore"):
        return float(np.clip(logit(np.clip(probability, 0.0, 1.0)), -7.0, 7.0))


def gains_of(out: Predicted, key: Key, floor: float) -> dict[str, Gain]:
    """The gain of each effect of a set in addition to the others."""
    rest = {effect: tuple(sorted({*key} - {effect})) for effect in key}
    return {
        effect: gained(out, key, less, floor)
        for effect, less in rest.items()
        if {key, less} <= out.sets.keys()
    }


def swaps_of(out: Predicted, key: Key, floor: float) -> dict[str, dict[str, Gain]]:
    """The gain of a set over each set with another effect in the place of one of its own."""
    swaps = dict[str, dict[str, Gain]]()
    for other in out.sets:
        new, old = set(other) - set(key), set(key) - set(other)
        if len(new) == len(old) == 1:
            swaps.setdefault(old.pop(), {})[new.pop()] = gained(out, key, other, floor)
    return swaps


def no_gap_shows(posterior: Weighed, policy: Policy = POLICY) -> bool:
    """Whether the residuals of the model without effects may be noise."""
    return posterior.nothing_shown > policy.likely >= posterior.unlisted or not posterior.best


def decide(findings: Findings, policy: Policy = POLICY, learned: Learned | None = None) -> Verdict:
    """The verdict that the findings support.

    The first set of ``gains`` helps whose every effect predicts data left out better. Its
    effects are causes if they are likelier there than not.

    Args:
        learned: the calibration; None for that of the package.
    """
    learned = learned or calibration()
    sets, unlisted = findings.weighed, learned.often("unlisted", findings.unlisted)
    more = unlisted > policy.likely

    def verdict(status: Status, probability: float, **answers: Any) -> Verdict:
        return Verdict(status=status, probability=probability, unlisted=unlisted, **answers)

    key = helping(findings, policy)
    best = next(iter(findings.gains), ())
    rivals = _rivals(findings, best, policy, more) if best else {}
    also = tuple(dict.fromkeys(e for of in (best, *rivals.values()) for e in of))
    gains, each = findings.gains.get(key, {}), {}
    for e in sorted(key, key=lambda e: -gains[e].gain):
        # A twin in its place is the same claim, so their probabilities count together.
        twins = rivals.get(e, ())
        alike = (e, *twins)
        features = findings.features[key][e]._replace(
            listed=_odds(min(sum(sets.holding((x,)) for x in alike), 1.0)),
            beside=_odds(min(sum(sets.holding((x,), beside=True) for x in alike), 1.0)),
        )
        each[e] = Each(learned.cause(features), gains[e].closed, gains[e].closed_std, twins)
    effects = tuple(e for e, claim in each.items() if claim.probability > policy.likely)
    also = tuple(e for e in also if e not in each)
    answers: dict[str, Any] = {"key": key, "each": each, "also_possible": also}
    answers["acts_like"] = tuple(e for e in each if e not in effects)
    if not effects:
        shown = best and sets.nothing_shown <= policy.perhaps
        if not (key or more or shown):
            return verdict(Status.NONE, 1 - unlisted, also_possible=also)
        there = max(unlisted, policy.likely)
        return verdict(Status.UNKNOWN, there, effects=(UNKNOWN,), **answers)
    exact = math.prod(each[e].probability for e in effects)
    if more:
        return verdict(Status.INCOMPLETE, exact * unlisted, effects=effects, **answers)
    status = Status.CANNOT_TELL if also else Status.NAMED
    return verdict(status, exact * (1 - unlisted), effects=effects, **answers)


def helping(findings: Findings, policy: Policy = POLICY) -> Key:
    """The first set of ``gains`` whose every effect predicts data left out better."""
    every = findings.gains.items()
    return next((k for k, gains in every if all(_helps(x, policy) for x in gains.values())), ())


def _helps(gain: Gain, policy: Policy) -> bool:
    """Whether data left out are predicted better."""
    return gain.gain > policy.gain * gain.std


def _rivals(
    findings: Findings, best: Key, policy: Policy, more: bool
) -> dict[str, tuple[str, ...]]:
    """Effects of other sets that are nearly as probable, or predict data left out nearly as well,
    by the effect that they replace; those in addition to the whole set have the empty name.

    Args:
        more: whether an unlisted effect is likely.
    """
    sets, rivals = findings.weighed, dict[str, list[str]]()
    least = policy.perhaps * sets.listed[sets.best]
    ranked = sorted(sets.listed, key=sets.listed.__getitem__, reverse=True)
    for key in ranked:
        if key == best or sets.listed[key] < least:
            continue
        new, old = set(key) - set(best), set(best) - set(key)
        if len(key) <= len(best) or not old:
            place = min(old) if len(old) == len(new) == 1 else ""
            rivals.setdefault(place, []).extend(sorted(new))
    for effect, swapped in findings.swaps.items():
        gain = findings.gains[best][effect]
        if not _helps(gain, policy):  # it is not named
            continue
        lacks = policy.alike * gain.gain * more
        for other, swap in sorted(swapped.items(), key=lambda pair: pair[1].gain):
            key = tuple(sorted({*best, other} - {effect}))
            # What is known beside these rows, such as a wheel speed, may exclude it.
            possible = math.exp(findings.odds.get(key, 0.0) - findings.odds.get(best, 0.0))
            if possible >= policy.perhaps and swap.gain < max(policy.gain * swap.std, lacks):
                rivals.setdefault(effect, []).append(other)
    return {place: tuple(dict.fromkeys(of)) for place, of in rivals.items()}
