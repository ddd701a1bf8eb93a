"""Decide a verdict from the posterior over sets, the predictions of data left out and the
tests of the remainder. Only :func:`decide`, a pure function, sets a status."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

from scipy.special import stdtr

from tirefit.diagnosis.evidence.posterior import Key, Weighed
from tirefit.diagnosis.left_out import Gain
from tirefit.diagnosis.negligible import NONZERO
from tirefit.results import Outcome

UNKNOWN = "unknown"
"""The id of an effect that the library does not list."""


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
    """There is a gap, and no listed effect can be named."""

    @property
    def names(self) -> bool:
        """Whether listed effects are named."""
        return self in (Status.NAMED, Status.CANNOT_TELL, Status.INCOMPLETE)

    @property
    def limits(self) -> dict[Outcome, str]:
        """Outcome -> sentence where the answer is open, for a record."""
        return {
            Status.CANNOT_TELL: {
                Outcome.NOT_IDENTIFIED: "other effects explain these data as well"
            },
            Status.INCOMPLETE: {Outcome.INCOMPLETE: "an unlisted effect is more probable than not"},
            Status.UNKNOWN: {Outcome.INCOMPLETE: "no listed effect explains the gap"},
        }.get(self, {})


@dataclass(frozen=True)
class Policy:
    """The thresholds of :func:`decide`. The table of the ablation in
    ``fits/withheld/README.md`` shows the effect of each.

    Attributes:
        likely: probability above which an effect counts as present (even odds).
        known: amplitude over its standard error above which an effect may be named: a
            standard error of half the value.
        gain: standard errors by which an effect must improve the prediction of data left out.
        perhaps: probability above which something is possible: no gap, if no effect can
            be named, or an effect that is not named; and probability of a set over that
            of the best above which it is a rival.
    """

    likely: float = 0.5
    known: float = 2.0
    gain: float = 1.0
    perhaps: float = 0.1


POLICY = Policy()


class Each(NamedTuple):
    """One named effect: the probability that it or one of its twins is present; the share
    of the gap that it closes on data left out, in addition to the other named effects,
    with its standard error (None if no data could be left out); and its ``twins``:
    effects that these data cannot distinguish from it."""

    probability: float
    closed_left_out: float | None
    closed_left_out_std: float | None
    twins: tuple[str, ...]


class Tests(NamedTuple):
    """p-values of the remainder of a set of effects, by test; None if the rows have no
    such order. See :mod:`tirefit.diagnosis.decide.remainder`."""

    time: float | None = None
    slip_order: float | None = None
    line: float | None = None
    pure_error: float | None = None
    local: float | None = None


class Fitted(NamedTuple):
    """A refitted set: for each effect the amplitude over its standard error, and its gain
    on data left out in addition to the others; empty if that was not computed."""

    errors: Mapping[str, float]
    gains: Mapping[str, Gain]


@dataclass(frozen=True, kw_only=True)
class Findings:
    """All inputs of a verdict: the posterior over sets; ``sets``, the set that explains
    most first, then its subsets, the largest and most probable first (empty if no gap is
    found); whether whole runs were left out; the probability of an unlisted effect in
    addition to the first set; and the tests of the remainder of that set."""

    weighed: Weighed
    sets: Mapping[Key, "Fitted"]
    across_runs: bool
    unlisted: float
    tests: Tests

    def probability(self, effect: str, key: Key, policy: "Policy") -> float:
        """Probability that an effect of a set is present.

        It is that of the posterior over sets if an unlisted effect is unlikely.
        Otherwise, if whole runs were left out, it is the probability that the effect
        improves the prediction of one more run (Student's t). The parts of a single run
        share an unlisted effect, and a listed effect that resembles it predicts them;
        then the sets with a discrepancy give the probability.
        """
        gain = self.sets[key].gains.get(effect) if key in self.sets else None
        if self.unlisted <= policy.likely:
            return min(self.weighed.holding((effect,)), 1.0)
        if self.across_runs and gain is not None:
            return float(stdtr(gain.parts - 1, gain.gain / max(gain.std, NONZERO)))
        return min(self.weighed.holding_beside((effect,)), 1.0)

    def claim(self, effect: str, key: Key, rivals, policy: "Policy") -> float:
        """Probability that an effect or one of its twins is present."""
        alike = (effect, *rivals.get(effect, ()))
        return min(sum(self.probability(e, key, policy) for e in alike), 1.0)


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The two answers: which effects are present, and what remains.

    ``effects`` are ids, the one that gains most on data left out first; empty without a
    gap, ``("unknown",)`` if no effect is named; ``key`` is the set of the named ones.
    ``probability`` is that of exactly this set without an unlisted effect or, for
    ``incomplete``, of these effects with one. ``also_possible`` are ids that these data
    do not rule out, ``unlisted`` is the probability of an unlisted effect.
    """

    status: Status
    effects: tuple[str, ...] = ()
    key: Key = ()
    probability: float
    each: Mapping[str, Each] = field(default_factory=dict)
    also_possible: tuple[str, ...] = ()
    unlisted: float
    tests: Tests


def no_gap_shows(weighed: Weighed, policy: Policy = POLICY) -> bool:
    """Whether the residuals of the base model may be noise."""
    return weighed.nothing_shown > policy.likely >= weighed.unlisted or not weighed.best


def decide(found: Findings, policy: Policy = POLICY) -> Verdict:
    """The verdict that the findings support.

    An effect of the most probable set is named if it is probably present, if its standard
    error is below half its amplitude, and if the set predicts data left out better with
    it. An unlisted effect does not prevent naming.
    """
    weighed, unlisted = found.weighed, found.unlisted
    more = unlisted > policy.likely

    def verdict(status, probability, **answers):
        return Verdict(
            status=status, probability=probability, unlisted=unlisted, tests=found.tests, **answers
        )

    def unnamed(is_gap: bool, also=()):
        if not is_gap:
            return verdict(Status.NONE, 1 - unlisted, also_possible=also)
        there, effects = max(unlisted, policy.likely), (UNKNOWN,)
        return verdict(Status.UNKNOWN, there, effects=effects, also_possible=also)

    if not found.sets:
        return unnamed(more)
    best = next(iter(found.sets))
    rivals = _rivals(weighed, best, policy)
    key = next((k for k in found.sets if _stands(found, k, rivals, policy)), ())
    also = tuple(dict.fromkeys(e for of in (best, *rivals.values()) for e in of))
    also = tuple(e for e in also if e not in key)
    if not key:
        return unnamed(more or weighed.nothing_shown <= policy.perhaps, also)
    gains, each = found.sets[key].gains, {}
    for e in sorted(key, key=lambda e: -gains[e].gain if e in gains else 0.0):
        gain, there = gains.get(e), found.claim(e, key, rivals, policy)
        closed, std = (gain.closed, gain.closed_std) if gain else (None, None)
        each[e] = Each(there, closed, std, rivals.get(e, ()))
    exact = weighed.listed_given_gap(key) if key == best else weighed.holding(key)
    if more:
        exact = math.prod(found.claim(e, key, rivals, policy) for e in key)
    status = Status.CANNOT_TELL if also else Status.NAMED
    return verdict(
        Status.INCOMPLETE if more else status,
        exact * (unlisted if more else 1 - unlisted),
        effects=tuple(each),
        key=key,
        also_possible=also,
        each=each,
    )


def _stands(found: Findings, key: Key, rivals, policy: Policy) -> bool:
    """Whether every effect of a set may be named. A twin in its place is the same
    claim: their probabilities count together."""
    errors, gains = found.sets[key]
    for effect in key:
        there = found.claim(effect, key, rivals, policy)
        if there <= policy.likely or errors[effect] < policy.known:
            return False
        if effect in gains and gains[effect].gain <= policy.gain * gains[effect].std:
            return False
    return True


def _rivals(weighed: Weighed, best: Key, policy: Policy) -> dict[str, tuple[str, ...]]:
    """Effects of other sets that are nearly as probable, by the effect that they replace;
    those in addition to the whole set have the empty name."""
    found: dict[str, list[str]] = {}
    least = policy.perhaps * weighed.listed[weighed.best]
    ranked = sorted(weighed.listed, key=weighed.listed.__getitem__, reverse=True)
    for key in ranked:
        if key == best or weighed.listed[key] < least:
            continue
        new, old = set(key) - set(best), set(best) - set(key)
        if len(key) <= len(best) or not old:
            place = min(old) if len(old) == len(new) == 1 else ""
            found.setdefault(place, []).extend(sorted(new))
    return {place: tuple(dict.fromkeys(of)) for place, of in found.items()}
