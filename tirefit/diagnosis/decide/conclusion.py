"""From the most probable set to what may be said of it.

The evidence ranks what a library holds; here the first of that ranking is held against
what it leaves. A name is given where trials of known cause say that nothing else is
there, every effect is known better than to half its size, and no effect is there only
to undo another.
"""

import math
from dataclasses import replace

import numpy as np
from scipy.special import logsumexp

from tirefit.diagnosis.decide.adequacy import Adequacy
from tirefit.diagnosis.decide.calibrated import (
    Explanation,
    Part,
    clues_of_effect,
    clues_of_rest,
    clues_of_set,
    probability_beside,
    probability_of_more,
)
from tirefit.diagnosis.decide.one_place import hidden_by_noise
from tirefit.diagnosis.decide.standing import Standing, standing, steadiness
from tirefit.diagnosis.decide.verdict import (
    HARDLY,
    Verdict,
    Weighed,
    named,
    nothing_shown,
    stand_ins,
    swapped_beside,
    ties,
)
from tirefit.diagnosis.evidence.base import Base
from tirefit.diagnosis.evidence.fast_waves import with_fast_waves
from tirefit.diagnosis.evidence.linear_fit import LinearFit, gains_beside, linear_at
from tirefit.diagnosis.evidence.search import PRIOR_OF_UNKNOWN, Search
from tirefit.diagnosis.negligible import NONZERO
from tirefit.diagnosis.rows.basis import without
from tirefit.diagnosis.rows.patterns import Look, looks
from tirefit.diagnosis.summary.records import HeldOut

_KNOWN = 2.0
"""Standard errors from which an effect may be named at all: an error bar of half the
value."""

_EVEN = 0.5
"""Probability from which something is likelier than not."""

_UNLISTED = 0.55
"""Probability of something unlisted from which it is said: at even odds a name, with
its probability, helps more than none."""

_SHOWN = 0.05
"""Probability of a pattern from which it is told."""

_FIRM = 3.0
"""Standard errors from which an effect stands beside a remainder that is not known."""

_CANCELS = 4.0
"""Energy of the effects of a set one by one over that of all together: from here on
one is there to undo the other. The 18 visible pairs of one development set reach 2."""

_EARNED = 0.17
"""Probability from which an effect is named beside something that is not listed. Trials
hold a listed effect beside a stranger in one of six; no model fits a measured log, and
one of two may hold such an effect as well: by these odds this is even."""

_PERHAPS = 0.1
"""The same from which an effect that is not named is said to be possible."""

_LEADING, _NEARLY = 4, 0.1
"""Sets over which it is asked whether an effect is there beside something unlisted, at
most, and the least probability of one over that of the first: what merely draws such a
gap is drawn by several nearly as well, and which of them comes first is chance."""

_TRIED = 6
"""Sets that are tried as what may be named beside something unlisted, at most."""

_EDGE = 1e-3
"""Distance from its bound, in prior scales, at which an effect rests on it."""

WORSE = 0.0
"""Closure of rows left out below which an explanation is none: the base predicts them
as well."""

_FALLS_SHORT = 0.5
"""Share of the closure on the rows fitted that must be found on those left out."""


_FLAGGED = 0.0065
"""Smallest p-value, times their number, below which rows are said to hold something
else than what is named, or than noise: the smallest value that six tests of 999 draws
can take within those."""


_BEYOND, _HARDLY_NOISE = 2.0, 0.75
"""Noise over the stated one from which it is no noise of that sensor but something
finer than the rows resolve, and the probability that it is: three of four engineers who
state a noise know it within a factor of two, a judgement."""


def probability_of_rest(p_value: float) -> float:
    """Probability that something is left, from the smallest of the tests' p-values.

    The largest Bayes factor that a p-value can stand for, 1 / (-e p log p) (Sellke,
    Bayarri and Berger 2001), with the prior odds of an effect that is not listed.
    """
    if p_value >= 1 / math.e:
        return PRIOR_OF_UNKNOWN
    odds = PRIOR_OF_UNKNOWN / (1 - PRIOR_OF_UNKNOWN)
    odds /= -math.e * p_value * np.log(p_value)
    return float(odds / (1 + odds))


def _smallest(adequacy: Adequacy) -> float:
    """The smallest p-value, of so many tests (Bonferroni)."""
    values = [p for p in adequacy[:-1] if p is not None]
    return min(1.0, len(values) * min(values)) if values else 1.0


def _linear(base: Base, weighed: Weighed, key) -> LinearFit:
    """Around a set; its other forms are used up too where it has them."""
    linear = linear_at(base, weighed.best_of[key])
    return linear.in_other_form() if key in weighed.other_form else linear


def _less(key, effect: str) -> tuple[str, ...]:
    """A set without one of its effects."""
    return tuple(e for e in key if e != effect)


class Judge:
    """The standings of the sets of one search, each worked out once."""

    def __init__(self, search: Search, weighed: Weighed, generator):
        self.search, self.weighed, self.generator = search, weighed, generator
        self.known: dict[tuple[str, ...], Standing] = {}
        self.told: dict[tuple[str, ...], dict[str, dict[str, float]]] = {}

    def of(self, key: tuple[str, ...]) -> Standing:
        if key not in self.known:
            base, weighed = self.search.base, self.weighed
            linear = _linear(base, weighed, key)
            self.known[key] = standing(
                base, weighed.best_of[key], linear.used_up, self.generator
            )
        return self.known[key]

    def gains(self, key) -> dict[str, float]:
        """Log evidence of each kind of remainder beside a set."""
        base, weighed = self.search.base, self.weighed
        if key not in weighed.gains:
            linear = linear_at(base, weighed.best_of[key])
            in_form = key in weighed.other_form
            weighed.gains[key] = gains_beside(base, linear, in_form)
        return weighed.gains[key]

    def errors(self, key) -> dict[str, float]:
        """Amplitude over its error, by effect."""
        return dict(
            zip(self.weighed.best_of[key].effects, self.of(key).errors, strict=True)
        )

    def firm(self, key, least: float) -> tuple[str, ...]:
        """The effects of a set that are known so well."""
        return tuple(sorted(e for e, z in self.errors(key).items() if z >= least))

    def is_known(self, key) -> bool:
        """Whether every effect of a set is known well enough to be named."""
        return self.firm(key, _KNOWN) == tuple(sorted(key))

    def best_within(self, allowed) -> tuple[str, ...]:
        """The most probable refitted set of some of these effects; () for none."""
        log = self.weighed.log_weight
        sets = [k for k in log if k and set(k) <= set(allowed)]
        return max(sets, key=lambda k: log[k], default=())

    def clues(self, key) -> dict[str, float]:
        """What tells that a set is not all that there is."""
        of_effects = self.clues_by_effect(key).values()
        return clues_of_set(clues_of_rest(self._explanation(key)), of_effects)

    def _explanation(self, key) -> Explanation:
        weighed, evidence = self.weighed, self.weighed.evidence
        others = [v for k, v in evidence.items() if k != key and len(k) <= len(key)]
        return Explanation(
            self.of(key), self.gains(key), self.gains(()), evidence[key],
            evidence[key] - weighed.best_of[key].log_evidence,
            evidence[key] - max(others, default=0.0), weighed.unknown_alone,
            len(key), self.search.base.rows.n,
        )  # fmt: skip

    def in_sets(self, effect: str) -> float:
        """Probability of the sets that hold an effect, if something unlisted is there
        beside them."""
        log = self.weighed.log_beside
        held = [value for key, value in log.items() if effect in key]
        if not held:
            return 0.0
        return float(np.exp(logsumexp(held) - logsumexp([*log.values()])))

    def lost(self, key, effect: str) -> float:
        """Log evidence that a set loses without an effect; all of it where what is left
        was not refitted."""
        less, evidence = _less(key, effect), self.weighed.evidence
        return evidence[key] - (evidence.get(less, 0.0) if less else 0.0)

    def over_rest(self, key, effect: str) -> float:
        """Log evidence of an effect beside a remainder of any kind over that remainder
        without it; zero where the set without it was not refitted."""
        less, evidence = _less(key, effect), self.weighed.evidence
        if less not in evidence:
            return 0.0
        with_rest = evidence[key] + max(0.0, *self.gains(key).values())
        return with_rest - evidence[less] - max(self.gains(less).values())

    def clues_by_effect(self, key) -> dict[str, dict[str, float]]:
        """What tells of each effect of a set that it is there, whatever else is."""
        if key not in self.told:
            self.told[key] = self._clues_by_effect(key)
        return self.told[key]

    def _clues_by_effect(self, key) -> dict[str, dict[str, float]]:
        evidence, best = self.weighed.evidence, self.weighed.best_of[key]
        explanation, errors = self._explanation(key), self.of(key).errors
        base = self.search.base
        used_up = _linear(base, self.weighed, key).used_up
        regimes = zip(*steadiness(base, best, used_up), strict=True)
        parts = {
            effect: Part(
                error, evidence.get((effect,)), self.lost(key, effect), *regime,
                self.over_rest(key, effect), self.in_sets(effect),
            )
            for effect, error, regime in zip(best.effects, errors, regimes, strict=True)
        }  # fmt: skip
        return {e: clues_of_effect(p, explanation) for e, p in parts.items()}

    def leading(self, key) -> dict[tuple[str, ...], float]:
        """A set and those nearly as probable among the listed, with their shares of the
        probability of all these."""
        listed = {k: p for k, p in self.weighed.listed.items() if k}
        ranked = sorted(listed, key=lambda k: listed[k], reverse=True)[:_LEADING]
        near = [k for k in ranked if listed[k] >= _NEARLY * listed[ranked[0]]]
        leading = {k: max(listed[k], NONZERO) for k in (key, *near)}
        return {k: value / sum(leading.values()) for k, value in leading.items()}

    def beside(self, key) -> dict[str, float]:
        """Probability of the effects of a set and of those nearly as probable, each to
        be there if something unlisted is: the mean over those sets that hold it."""
        found: dict[str, list[tuple[float, float]]] = {}
        for one, share in self.leading(key).items():
            for effect, clues in self.clues_by_effect(one).items():
                found.setdefault(effect, []).append((probability_beside(clues), share))
        return {
            effect: sum(chance * share for chance, share in of)
            / sum(share for _, share in of)
            for effect, of in found.items()
        }

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
        verdict: nothing, or the most probable set.
        generator: of simulated residuals.
    """
    judge = Judge(search, weighed, generator)
    if verdict.status in ("none", "unknown"):
        left = judge.of(()).adequacy
        verdict = replace(verdict, adequacy=left)
        # Stricter than for a name: six tests, and a false alarm is the worse error.
        if verdict.status == "none" and _smallest(left) < _FLAGGED:
            return unknown(verdict, weighed, left, probability_of_rest(_smallest(left)))
        return _nothing(verdict, judge) if verdict.status == "none" else verdict
    key = verdict.effects
    kept = judge.firm(key, _KNOWN)
    if kept != key:
        key = judge.best_within(kept)
        if not key:
            return _nothing_stands(verdict, judge)
        dropped = tuple(e for e in verdict.effects if e not in key)
        less = named(search, _without(weighed, dropped), key, verdict.p_value)
        also = tuple(dict.fromkeys((*dropped, *less.also_possible)))
        # What else the sets hold is not known well enough to be told from nothing.
        verdict = replace(
            less, status="cannot_tell", also_possible=also,
            probability=weighed.holding(key),
        )  # fmt: skip
    more = probability_of_more(judge.clues(key))
    # What its own tests refuse is no whole explanation, however seldom trials say so.
    if judge.imitates(key) or _smallest(judge.of(key).adequacy) < _FLAGGED:
        more = max(more, _UNLISTED)
    if not _is_noise(search.base):
        more = max(more, _HARDLY_NOISE)
    if more < _UNLISTED and nothing_shown(weighed) > weighed.sets[key]:
        # Named, it would be a false alarm more often than the name of what is there.
        return _nothing_stands(verdict, judge)
    if more < _UNLISTED:
        passed = judge.of(key).adequacy._replace(passed=True)
        sure = verdict.probability * (1 - more)
        return replace(verdict, probability=sure, adequacy=passed, unlisted=more)
    return _incomplete(verdict, judge, key, more)


def _earned(judge: Judge, key, chances) -> tuple[str, ...]:
    """The most probable set that may be named beside something unlisted; () for none.

    Every effect of it is likely enough, known to better than half its size as it will
    be told, and firm there or in one of the leading sets: what a set without the others
    leaves widens the error of each.
    """
    log = judge.weighed.log_weight
    likely = {e for e, p in chances.items() if p >= _EARNED}
    firm = {e for one in judge.leading(key) for e in judge.firm(one, _FIRM)}
    sets = [k for k in log if k and set(k) <= likely]
    for one in sorted(sets, key=lambda k: log[k], reverse=True)[:_TRIED]:
        stands = set(one) <= firm | set(judge.firm(one, _FIRM))
        if stands and judge.is_known(one) and not judge.imitates(one):
            return one
    return ()


def _without(weighed: Weighed, effects) -> Weighed:
    """The weights of the sets that hold none of these: what is known to less than half
    its size may explain most of a file, as a load that knows the slip does."""
    log = weighed.log_weight
    kept = {k: value for k, value in log.items() if not set(k) & set(effects)}
    return replace(weighed, log_weight=kept)


def _nothing_stands(verdict: Verdict, judge: Judge) -> Verdict:
    """The gap shows, and no effect is known well enough to be its name."""
    weighed, left = judge.weighed, judge.of(()).adequacy
    rest = max(probability_of_rest(_smallest(left)), weighed.unknown_alone)
    perhaps = (*verdict.effects, *verdict.also_possible)
    if left.passed and weighed.unknown_alone < _EVEN:
        # What the evidence asks for is said, unless nothing may be there as well.
        nothing = replace(
            verdict, status="none", effects=(), adequacy=left,
            also_possible=perhaps if nothing_shown(weighed) < HARDLY else (),
            probability=1 - rest, chosen=weighed.best_of[()],
        )  # fmt: skip
        return _nothing(nothing, judge)
    return replace(unknown(verdict, weighed, left, rest), also_possible=perhaps)


def _is_noise(base: Base) -> bool:
    """Whether the rows may scatter by what is stated of their noise."""
    return max(noise.excess for noise in base.noise.values()) <= _BEYOND


def _nothing(verdict: Verdict, judge: Judge) -> Verdict:
    """No gap, unless what counts as noise is none."""
    base = judge.search.base
    if not _is_noise(base) or hidden_by_noise(base, verdict.chosen):
        return unknown(verdict, judge.weighed, verdict.adequacy, _HARDLY_NOISE)
    return verdict


def _incomplete(verdict: Verdict, judge: Judge, key, more: float) -> Verdict:
    """What stands beside something unlisted, whose probability is ``more``."""
    weighed, verdict = judge.weighed, replace(verdict, unlisted=more)
    chances = judge.beside(key)
    perhaps = [e for e, p in sorted(chances.items()) if p >= _PERHAPS]
    earned = _earned(judge, key, chances)
    if not earned:
        nothing = unknown(verdict, weighed, judge.of(()).adequacy, more)
        return replace(nothing, also_possible=tuple(perhaps))
    there = [chances[e] for e in earned]
    left = judge.of(earned).adequacy._replace(passed=False)
    alike = (*ties(weighed, earned), *stand_ins(judge.search, weighed, earned))
    alike += tuple(e for e in perhaps if e not in earned)
    alike += swapped_beside(weighed, earned)
    return replace(
        verdict, status="incomplete", effects=earned,
        also_possible=tuple(dict.fromkeys(alike)),
        probability=float(more * np.prod(there)), chosen=weighed.best_of[earned],
        adequacy=left,
    )  # fmt: skip


def unknown(
    verdict: Verdict, weighed: Weighed, left: Adequacy, probability: float
) -> Verdict:
    """A gap that nothing listed explains: no set of the library may be named."""
    return replace(
        verdict, status="unknown", effects=("unknown",), also_possible=(),
        probability=probability, chosen=weighed.best_of[()],
        adequacy=left._replace(passed=False),
        unlisted=max(verdict.unlisted, probability),
    )  # fmt: skip


def bound_by(
    verdict: Verdict, weighed: Weighed, closed: float | None, held: HeldOut | None
) -> Verdict:
    """The verdict that the figures on rows left out allow: ``unknown`` where they are
    predicted no better than by the base, ``incomplete`` where far less is closed there
    than on the rows fitted. What may stand in the place of the effects still may.

    Args:
        closed: on the rows fitted.
    """
    if verdict.status not in ("named", "cannot_tell", "incomplete"):
        return verdict
    if held is None or held.closed is None or not held.resolvable:
        return verdict
    if held.closed <= WORSE:
        probability = max(_EVEN, 1 - verdict.probability)
        bound = unknown(verdict, weighed, verdict.adequacy, probability)
        return replace(bound, fails_elsewhere=True)
    if closed and held.closed < _FALLS_SHORT * closed:
        left = verdict.adequacy._replace(passed=False)
        return replace(
            verdict, status="incomplete", adequacy=left,
            unlisted=max(verdict.unlisted, _EVEN), fails_elsewhere=True,
        )  # fmt: skip
    return verdict


def look_of_rest(verdict: Verdict, base: Base, weighed: Weighed) -> tuple[Look, ...]:
    """What is left beside the effects of an unknown or incomplete verdict."""
    if verdict.status not in ("unknown", "incomplete"):
        return ()
    key = tuple(sorted(verdict.chosen.effects))
    linear = _linear(base, weighed, key)
    among, left = base.generic.patterns, without(linear.residual, linear.explained)
    if base.rows.time is not None:
        among = with_fast_waves(among, base.rows.time, left)
    alike = looks(among, linear.explained, linear.residual)
    return tuple(look for look in alike if look.probability > _SHOWN)
