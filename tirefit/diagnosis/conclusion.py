"""From the most probable set to what may be said of it.

The evidence ranks what a library holds; here the first of that ranking is held against
what it leaves. A name is given where nothing is left that residual plots would show,
every effect is known better than to half its size, and no effect is there only to undo
or to mend another.
"""

from dataclasses import replace

import numpy as np

from tirefit.diagnosis.adequacy import Adequacy
from tirefit.diagnosis.negligible import NONZERO
from tirefit.diagnosis.records import HeldOut
from tirefit.diagnosis.search import PRIOR_OF_UNKNOWN, Search
from tirefit.diagnosis.standing import Standing, standing
from tirefit.diagnosis.verdict import Verdict, Weighed, linear_at

__all__ = ["bound_by", "concluded", "probability_of_rest"]

_KNOWN = 2.0
"""Standard errors from which an effect may be named at all: an error bar of half the
value."""

_FIRM = 3.0
"""Standard errors from which an effect stands beside a remainder that is not known."""

_CANCELS = 4.0
"""Energy of the effects of a set one by one over that of all together: from here on
one is there to undo the other. The 18 visible pairs of one development set reach 2."""

_MENDS = (0.05, 30.0)
"""Share of a set's log evidence, and log evidence, below which its weakest effect only
mends what the others miss."""

_EDGE = 1e-3
"""Distance from its bound, in prior scales, at which an effect rests on it."""

_WORSE = 0.0
"""Closure of rows left out below which an explanation is none: the base predicts them
as well."""

_FALLS_SHORT = 0.5
"""Share of the closure on the rows fitted that must be found on those left out."""


_FLAGGED = 0.0065
"""Smallest p-value, times their number, below which rows without a resolvable effect
are said to hold something: the smallest value that six tests of 999 draws can take."""


def probability_of_rest(p_value: float) -> float:
    """Probability that something is left, from the smallest of the tests' p-values.

    The largest Bayes factor that a p-value can stand for, 1 / (-e p log p) (Sellke,
    Bayarri and Berger 2001), with the prior odds of an effect that is not listed.
    """
    if p_value >= 1 / np.e:
        return PRIOR_OF_UNKNOWN
    odds = PRIOR_OF_UNKNOWN / (1 - PRIOR_OF_UNKNOWN)
    odds /= -np.e * p_value * np.log(p_value)
    return float(odds / (1 + odds))


def _smallest(adequacy: Adequacy) -> float:
    """The smallest p-value, of so many tests (Bonferroni)."""
    values = [p for p in adequacy[:-1] if p is not None]
    return min(1.0, len(values) * min(values)) if values else 1.0


class _Judge:
    """The standings of the sets of one search, each worked out once."""

    def __init__(self, search: Search, weighed: Weighed, generator):
        self.search, self.weighed, self.generator = search, weighed, generator
        self.known: dict[tuple[str, ...], Standing] = {}

    def of(self, key: tuple[str, ...]) -> Standing:
        if key not in self.known:
            hypothesis = self.weighed.best_of[key]
            linear = linear_at(self.search.base, hypothesis)
            used_up = linear.used_up
            if key in self.weighed.other_form:
                used_up = np.concatenate([used_up, linear.forms], axis=1)
            self.known[key] = standing(
                self.search.base, hypothesis, used_up, self.generator
            )
        return self.known[key]

    def errors(self, key) -> dict[str, float]:
        """Amplitude over its error, by effect."""
        return dict(
            zip(self.weighed.best_of[key].effects, self.of(key).errors, strict=True)
        )

    def firm(self, key, least: float) -> tuple[str, ...]:
        """The effects of a set that are known so well."""
        return tuple(sorted(e for e, z in self.errors(key).items() if z >= least))

    def best_within(self, allowed) -> tuple[str, ...]:
        """The most probable refitted set of some of these effects; () for none."""
        sets = [k for k in self.weighed.sets if k and set(k) <= set(allowed)]
        return max(sets, key=lambda k: self.weighed.sets[k], default=())

    def mended(self, key) -> tuple[str, ...]:
        """The set without an effect that only mends what the others miss, if there is
        one; else the set."""
        if len(key) < 2:
            return key
        evidence = self.weighed.evidence
        parts = {
            rest: evidence[rest]
            for rest in (tuple(e for e in key if e != out) for out in key)
            if rest in evidence
        }
        if not parts:
            return key
        rest = max(parts, key=lambda k: parts[k])
        added = evidence[key] - parts[rest]
        share, least = _MENDS
        return rest if added < min(least, share * evidence[key]) else key

    def imitates(self, key) -> bool:
        """Whether a set of several looks like a drawing of something else."""
        if len(key) < 2:
            return False
        hypothesis, design = self.weighed.best_of[key], self.search.base.design
        atoms = list(hypothesis.atoms)
        low, high = np.asarray(design.low)[atoms], np.asarray(design.high)[atoms]
        amplitude = hypothesis.amplitude
        at_edge = np.minimum(amplitude - low, high - amplitude) < _EDGE
        return bool(at_edge.any()) or self.of(key).cancels > _CANCELS


def concluded(verdict: Verdict, search: Search, weighed: Weighed, generator) -> Verdict:
    """The verdict that the best set's standing allows.

    Args:
        verdict: what the probabilities support.
        generator: of simulated residuals.
    """
    judge = _Judge(search, weighed, generator)
    key = tuple(sorted(verdict.chosen.effects))
    if verdict.status in ("none", "unknown"):
        adequacy = judge.of(()).adequacy
        verdict = replace(verdict, adequacy=adequacy)
        # Stricter than for a name: six tests, and a false alarm is the worse error.
        if verdict.status == "none" and _smallest(adequacy) < _FLAGGED:
            return _unknown(verdict, weighed, adequacy)
        return verdict
    kept = judge.firm(key, _KNOWN)
    if kept != key:
        key = judge.best_within(kept)
    if not key or judge.imitates(key):
        return _unknown(verdict, weighed, judge.of(()).adequacy)
    adequacy = judge.of(key).adequacy
    complete = judge.mended(key)
    if verdict.status != "incomplete" and adequacy.passed and complete == key:
        if key == tuple(sorted(verdict.effects)):
            return replace(verdict, adequacy=adequacy)
        return replace(
            verdict, effects=key, probability=weighed.sets[key], adequacy=adequacy,
            chosen=weighed.best_of[key], status="cannot_tell",
            also_possible=tuple(e for e in verdict.effects if e not in key),
        )  # fmt: skip
    return _incomplete(verdict, judge, complete)


def _incomplete(verdict: Verdict, judge: _Judge, key: tuple[str, ...]) -> Verdict:
    """What stands beside a remainder, whatever that is."""
    weighed = judge.weighed
    firm = judge.firm(key, _FIRM)
    key = key if firm == key else judge.best_within(firm)
    if not key:
        return _unknown(verdict, weighed, judge.of(()).adequacy)
    adequacy = judge.of(key).adequacy
    rest = max(probability_of_rest(_smallest(adequacy)), _beside(weighed, key))
    return replace(
        verdict, status="incomplete", effects=key, also_possible=(),
        probability=_with_more(weighed, key, rest), chosen=weighed.best_of[key],
        adequacy=adequacy,
    )  # fmt: skip


def _with_more(weighed: Weighed, key: tuple[str, ...], rest: float) -> float:
    """Probability that these effects are there and something else is: of every larger
    set, and of this one with a remainder, whose probability is ``rest``."""
    total = {k: v + weighed.unknown_beside.get(k, 0.0) for k, v in weighed.sets.items()}
    larger = sum(v for k, v in total.items() if set(key) < set(k))
    return float(min(larger + rest * total[key], 1.0))


def _beside(weighed: Weighed, key) -> float:
    """Probability of a remainder beside a set, given the set."""
    more = weighed.unknown_beside.get(key, 0.0)
    return more / max(more + weighed.sets[key], NONZERO)


def _unknown(verdict: Verdict, weighed: Weighed, adequacy: Adequacy) -> Verdict:
    """A gap that nothing listed explains: no set of the library may be named."""
    rest = probability_of_rest(_smallest(adequacy))
    return replace(
        verdict, status="unknown", effects=("unknown",), also_possible=(),
        probability=max(rest, weighed.unknown_alone), chosen=weighed.best_of[()],
        adequacy=adequacy,
    )  # fmt: skip


def bound_by(
    verdict: Verdict, weighed: Weighed, closed: float | None, held: HeldOut | None
) -> Verdict:
    """The verdict that the figures on rows left out allow: ``unknown`` where they are
    predicted no better than by the base, ``incomplete`` where far less is closed there
    than on the rows fitted.

    Args:
        closed: on the rows fitted.
    """
    if verdict.status not in ("named", "cannot_tell", "incomplete"):
        return verdict
    if held is None or held.closed is None or not held.resolvable:
        return verdict
    if held.closed <= _WORSE:
        return _unknown(verdict, weighed, verdict.adequacy)
    if closed and held.closed < _FALLS_SHORT * closed:
        return replace(verdict, status="incomplete", also_possible=())
    return verdict
