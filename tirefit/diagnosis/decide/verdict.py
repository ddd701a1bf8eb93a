"""From the posterior over sets, the figures on data left out and the tests of the
remainder to a verdict. :func:`decide` is pure, and nothing else sets a status."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

from tirefit.diagnosis.evidence.posterior import Key, Weighed
from tirefit.diagnosis.left_out.ladder import Gain

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


@dataclass(frozen=True)
class Policy:
    """The thresholds of :func:`decide`. What each buys stands in
    ``fits/withheld/README.md``, as the table of the ablation.

<<<<<<< HEAD
    Attributes:
        likely: probability from which something is said to be there (even odds).
        known: amplitude over its standard error from which an effect may be named: an
            error bar of half the value.
        gain: standard errors by which an effect must improve the prediction of data
            left out, and by which another set of as many effects must predict them
            better to take the place of the most probable one.
        perhaps: probability from which an effect that is not named is possible, and
            probability of a set over that of the best from which it is a rival.
=======
    status: str
    effects: tuple[str, ...]
    probability: float
    also_possible: tuple[str, ...]
    p_value: float
    chosen: Hypothesis
    adequacy: Adequacy = UNTESTED
    fails_elsewhere: bool = False
    unlisted: float = 0.0


@dataclass(frozen=True)
class Weighed:
    """Probability of every set of effects that was refitted; ``unknown`` is that of a
    gap that no listed effect explains, alone or beside the set; ``other_form`` are the
    sets whose effects are there in a form of their own, ``evidence`` the log evidence
    of each set over none, in whatever form; ``log_weight`` the same with its prior and
    ``log_beside`` that with a remainder beside it: of a gap far beyond the noise the
    probabilities are too small for numbers. ``hidden`` is the probability of sets too
    improbable to be refitted, which these data could not show either; ``gains`` the log
    evidence of each kind of remainder beside a set, see
    :func:`tirefit.diagnosis.rows.basis.gains`."""

    sets: dict[tuple[str, ...], float]
    best_of: dict[tuple[str, ...], Hypothesis]
    unknown_alone: float
    unknown_beside: dict[tuple[str, ...], float]
    other_form: frozenset[tuple[str, ...]]
    evidence: dict[tuple[str, ...], float]
    log_weight: dict[tuple[str, ...], float]
    log_beside: dict[tuple[str, ...], float]
    hidden: float
    gains: dict[tuple[str, ...], dict[str, float]]

    @property
    def best(self) -> tuple[str, ...]:
        """The most probable set of effects, if all that is there is listed."""
        log = self.log_weight
        return max((k for k in log if k), key=lambda k: log[k], default=())

    @property
    def listed(self) -> dict[tuple[str, ...], float]:
        """Probability of every set, if all that is there is listed."""
        return dict(
            zip(self.log_weight, softmax([*self.log_weight.values()]), strict=True)
        )

    def among_listed(self, key) -> float:
        """Probability of a set, if all that is there is listed."""
        return float(self.listed[key])

    @property
    def unlisted(self) -> float:
        """Probability of something that is not listed, alone or beside a set."""
        return self.unknown_alone + sum(self.unknown_beside.values())

    def holding(self, key) -> float:
        """Probability of the sets that hold these effects, if all that is there is
        listed."""
        return float(sum(p for k, p in self.listed.items() if set(key) <= set(k)))


def gap_p_value(search: Search, generator) -> float:
    """Whether there is a gap at all: the largest score, and a generic misfit, each
    against simulated noise; the smaller of both, doubled."""
    base, left = search.base, search.projected
    size = np.linalg.norm(left, axis=0)
    use = [k for k in search.testable if size[k] > UNSEEN]
    z = left[:, use] / size[use]
    residual, jacobian, *_ = base.at_null
    observed = np.max(np.abs(z.T @ base.sure(residual)), initial=0.0)
    draws = np.abs(scores_of_nothing(z, DRAWS, generator)).max(0, initial=0.0)
    p_score = (1 + np.sum(draws >= observed)) / (1 + DRAWS)
    explained = np.concatenate([jacobian, base.proxies], axis=1)
    p_generic = misfit_p_value(base.generic, explained, residual, generator, DRAWS)
    return float(min(1.0, 2 * min(p_score, p_generic)))


def weigh(search: Search) -> Weighed:
    """Posterior probabilities of all sets, with and without an unknown remainder."""
    logs: dict[tuple[str, ...], list[float]] = {}
    best: dict[tuple[str, ...], Hypothesis] = {}
    # An estimate is no fit of its set: its remainder is that of a smaller one.
    fitted = [h for h in search.hypotheses if h.refitted]
    guessed = [h for h in search.hypotheses if not h.refitted]
    for hypothesis in fitted:
        key = tuple(sorted(hypothesis.effects))
        logs.setdefault(key, []).append(hypothesis.log_weight)
        if key not in best or hypothesis.log_weight > best[key].log_weight:
            best[key] = hypothesis
    total = {key: float(logsumexp(values)) for key, values in logs.items()}
    evidence = {key: hypothesis.log_evidence for key, hypothesis in best.items()}
    others, remainder = set(), {}
    ranked = sorted(total, key=lambda key: total[key], reverse=True)
    nothing = linear_at(search.base, best[()])
    of_nothing = due_to_doubt(search.base, best[()], nothing)
    among = dict.fromkeys([*ranked[:_FREED], *_simplest(total, _SINGLES), ()])
    for key in among:
        linear = linear_at(search.base, best[key])
        if linear.forms.shape[1] and len(key) < MOST_EFFECTS:
            formula = float(np.log(1 - PRIOR_OF_FORM))
            # Around nothing, doubt explains what a form is there for.
            due = min(due_to_doubt(search.base, best[key], linear) - of_nothing, 0.0)
            form = gain_of_form(search.base, linear) + due - best[key].due_to_doubt
            total[key] += float(np.logaddexp(formula, form))
            evidence[key] += float(np.logaddexp(formula, form))
            if form > formula:
                others.add(key)
        remainder[key] = gains_beside(search.base, linear, key in others)
    total = _formulas_first(total, best)
    beside = {
        key: total[key] + of_any_kind(gains) + np.log(PRIOR_OF_UNKNOWN)
        for key, gains in remainder.items()
    }
    rest = [hypothesis.log_weight for hypothesis in guessed]
    everything = logsumexp([*total.values(), *beside.values(), *rest])

    def probabilities(logs):
        return {k: float(np.exp(v - everything)) for k, v in logs.items()}

    hidden = [h.log_weight for h in guessed if h.log_evidence < _SHOWS]
    alone = beside.pop(())
    return Weighed(
        sets=probabilities(total),
        best_of=best,
        unknown_alone=float(np.exp(alone - everything)),
        unknown_beside=probabilities(beside),
        other_form=frozenset(others),
        evidence=evidence,
        log_weight=total,
        log_beside=beside,
        hidden=float(np.sum(np.exp(np.array(hidden) - everything))),
        gains=remainder,
    )


def _formulas_first(total, best):
    """Log weights of sets. Of as many effects in forms of their own, which draw nearly
    the same, that set is the likeliest whose formulas do best: these exchange weights.

    Args:
        best: the formulas' fit of each set.
>>>>>>> evid
    """

    likely: float = 0.5
    known: float = 2.0
    gain: float = 1.0
    perhaps: float = 0.1


POLICY = Policy()


class Each(NamedTuple):
    """One effect that is named.

    Attributes:
        probability: that it is there, whatever else is.
        closed_left_out: share of the gap that it closes on data left out, beside the
            other named effects; None where nothing could be left out.
        closed_left_out_std: its standard error over the parts that were left out.
        twins: effects that these data cannot tell from it.
    """

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
    """All that a verdict rests on.

    Attributes:
        weighed: the posterior over sets.
        sets: the set that explains most first, then the sets of some of its effects,
            the largest and most probable first; empty where no gap shows.
        across_runs: whether whole runs were left out.
        unlisted: probability that something unlisted is there beside that set.
        tests: of the remainder of that set.
    """

    weighed: Weighed
    sets: Mapping[Key, "Fitted"]
    across_runs: bool
    unlisted: float
    tests: Tests

    def probability(self, effects, policy: "Policy") -> float:
        """That these effects are there, whatever else is.

        The parts of one run share what is unlisted, and a listed effect that imitates
        it predicts them: there the discrepancy stands beside the sets. From run to run
        only what is there carries over, which ``gains`` judge.
        """
        if self.unlisted > policy.likely and not self.across_runs:
            return self.weighed.holding_beside(effects)
        return self.weighed.holding(effects)


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The two answers: which effects are there, and what is left.

    Attributes:
        status: derived from both.
        effects: ids, the one that gains most on data left out first; empty for no gap,
            ``("unknown",)`` where no effect is named.
        key: the named effects as a set of the posterior.
        probability: that the verdict is right: of exactly this set and of nothing
            unlisted beside it, or of these effects and something unlisted.
        each: by effect.
        also_possible: ids that these data do not rule out.
        unlisted: probability that something unlisted is there.
        tests: of the remainder.
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
            status=status, probability=probability, unlisted=unlisted,
            tests=found.tests, **answers,
        )  # fmt: skip

    if not found.sets:
        if more:
            return verdict(Status.UNKNOWN, unlisted, effects=(UNKNOWN,))
        return verdict(Status.NONE, 1 - unlisted)
    best = next(iter(found.sets))
    rivals = _rivals(weighed, best, policy)
    key = next((k for k in found.sets if _stands(found, k, rivals, policy)), ())
    also = tuple(dict.fromkeys(e for of in (best, *rivals.values()) for e in of))
    also = tuple(e for e in also if e not in key)
    if not key:
        if not more and weighed.nothing_shown > 1 - weighed.nothing_shown:
            return verdict(Status.NONE, 1 - unlisted, also_possible=also)
        return verdict(
            Status.UNKNOWN, max(unlisted, policy.likely), effects=(UNKNOWN,),
            also_possible=also,
        )  # fmt: skip
    gains = found.sets[key].gains
    order = sorted(key, key=lambda e: -gains[e].gain if e in gains else 0.0)
    # Where data left out chose between twins, it is one claim with their probability.
    exact = weighed.listed_given_gap(weighed.best)
    status = Status.CANNOT_TELL if also else Status.NAMED
    return verdict(
        Status.INCOMPLETE if more else status,
        (exact if key == best else weighed.holding(key))
        * (unlisted if more else 1 - unlisted),
        effects=tuple(order), key=key, also_possible=also,
        each={
            e: Each(
                min(found.probability((e,), policy), 1.0),
                gains[e].closed if e in gains else None,
                gains[e].closed_std if e in gains else None,
                rivals.get(e, ()),
            )
            for e in order
        },
    )  # fmt: skip


def _stands(found: Findings, key: Key, rivals, policy: Policy) -> bool:
    """Whether every effect of a set may be named. A twin in its place is the same
    claim: their probabilities count together."""
    errors, gains = found.sets[key]
    for effect in key:
        alike = (effect, *rivals.get(effect, ()))
        there = sum(found.probability((e,), policy) for e in alike)
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
