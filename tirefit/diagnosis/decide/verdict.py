"""From the posterior over sets, the figures on data left out and the tests of the
remainder to a verdict. :func:`decide` is pure, and nothing else sets a status."""

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
"""The id that stands for an effect that the library does not list."""


class Status(StrEnum):
    """What a diagnosis concludes; derived from two answers: which effects are there,
    and what is left."""

    NONE = "none"
    """No gap shows: what the model misses may be noise."""
    NAMED = "named"
    """Listed effects explain the gap; nothing unlisted is likelier than not."""
    CANNOT_TELL = "cannot_tell"
    """The same, and other effects explain these data as well: see ``also_possible``."""
    INCOMPLETE = "incomplete"
    """The named effects are there, and something unlisted is likelier than not."""
    UNKNOWN = "unknown"
    """There is a gap, and no listed effect earns a name."""

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
            Status.INCOMPLETE: {
                Outcome.INCOMPLETE: "something unlisted is there, likelier than not"
            },
            Status.UNKNOWN: {Outcome.INCOMPLETE: "no listed effect explains the gap"},
        }.get(self, {})


@dataclass(frozen=True)
class Policy:
    """The thresholds of :func:`decide`. What each buys stands in
    ``fits/withheld/README.md``, as the table of the ablation.

    Attributes:
        likely: probability from which something is said to be there (even odds).
        known: amplitude over its standard error from which an effect may be named: an
            error bar of half the value.
        gain: standard errors by which an effect must improve the prediction of data
            left out.
        perhaps: probability from which something is possible: no gap at all, where no
            effect earns a name, or an effect that is not named; and probability of a
            set over that of the best from which it is a rival.
    """

    likely: float = 0.5
    known: float = 2.0
    gain: float = 1.0
    perhaps: float = 0.1


POLICY = Policy()


class Each(NamedTuple):
    """One named effect: the probability that it, or one of its twins, is there,
    whatever else is; the share of the gap that it closes on data left out beside the
    other named effects, with its standard error (None where nothing could be left out);
    and its ``twins``: effects that these data cannot tell from it."""

    probability: float
    closed_left_out: float | None
    closed_left_out_std: float | None
    twins: tuple[str, ...]


class Tests(NamedTuple):
    """p-values of what a set of effects leaves, by test; None where the rows have no
    such order. See :mod:`tirefit.diagnosis.decide.remainder`."""

    time: float | None = None
    slip_order: float | None = None
    line: float | None = None
    pure_error: float | None = None
    local: float | None = None


class Fitted(NamedTuple):
    """A refitted set: by effect its amplitude over its standard error, and what it
    gains on data left out beside the others; empty where that was not tried."""

    errors: Mapping[str, float]
    gains: Mapping[str, Gain]


@dataclass(frozen=True, kw_only=True)
class Findings:
    """All that a verdict rests on: the posterior over sets; ``sets``, the set that
    explains most first, then the sets of some of its effects, the largest and most
    probable first (empty where no gap shows); whether whole runs were left out; the
    probability that something unlisted is there beside the first set; and the tests of
    the remainder of that set."""

    weighed: Weighed
    sets: Mapping[Key, "Fitted"]
    across_runs: bool
    unlisted: float
    tests: Tests

    def probability(self, effect: str, key: Key, policy: "Policy") -> float:
        """That an effect of a set is there, whatever else is.

        By the posterior over sets where nothing unlisted is likelier than not. Else,
        where whole runs were left out, by how likely it is that the effect improves the
        prediction of one more run (Student's t); the parts of a single run share what
        is unlisted, and a listed effect that imitates it predicts them: there by the
        sets with a discrepancy beside them.
        """
        gain = self.sets[key].gains.get(effect) if key in self.sets else None
        if self.unlisted <= policy.likely:
            return min(self.weighed.holding((effect,)), 1.0)
        if self.across_runs and gain is not None:
            return float(stdtr(gain.parts - 1, gain.gain / max(gain.std, NONZERO)))
        return min(self.weighed.holding_beside((effect,)), 1.0)

    def claim(self, effect: str, key: Key, rivals, policy: "Policy") -> float:
        """That an effect or one of its twins is there: one claim."""
        alike = (effect, *rivals.get(effect, ()))
        return min(sum(self.probability(e, key, policy) for e in alike), 1.0)


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The two answers: which effects are there, and what is left.

    ``effects`` are ids, the one that gains most on data left out first; empty for no
    gap, ``("unknown",)`` where no effect is named; ``key`` is the set of the named
    ones. ``probability`` is that of exactly this set and of nothing unlisted beside it,
    or of these effects and something unlisted. ``also_possible`` are ids that these
    data do not rule out, ``unlisted`` is the probability of something unlisted.
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
    """Whether what the base model misses may be noise."""
    return weighed.nothing_shown > policy.likely >= weighed.unlisted or not weighed.best


def decide(found: Findings, policy: Policy = POLICY) -> Verdict:
    """The verdict that the findings support.

    An effect of the most probable set is named if it is likelier there than not, known
    to better than half its size, and predicts data left out better than the set without
    it. Something unlisted does not take a name away.
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
    """Effects of other sets that are nearly as probable, by the effect in whose place
    they stand; those beside the whole set stand under the empty name."""
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
