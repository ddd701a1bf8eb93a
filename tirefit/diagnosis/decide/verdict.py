"""From the search to a verdict: is there a gap, which effects, how sure."""

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp, softmax

from tirefit.diagnosis.decide.adequacy import UNTESTED, Adequacy
from tirefit.diagnosis.effects.free_forms import moved_by
from tirefit.diagnosis.evidence.changes import MOST_EFFECTS
from tirefit.diagnosis.evidence.linear_fit import (
    PRIOR_OF_FORM,
    due_to_doubt,
    gain_of_form,
    gains_beside,
    linear_at,
)
from tirefit.diagnosis.evidence.search import (
    PRIOR_OF_UNKNOWN,
    Hypothesis,
    Search,
    amplitudes_of,
)
from tirefit.diagnosis.negligible import UNSEEN
from tirefit.diagnosis.rows.basis import misfit_p_value, of_any_kind, without
from tirefit.diagnosis.summary.forecast import DRAWS, scores_of_nothing, separability

SURE = 0.8
"""Probability from which an effect is named without alternatives."""

_LEVEL = 0.05
"""Error of the first kind of the test for a gap."""

_TOLD_APART = 0.75
"""Forecast probability of telling two effects apart below which data cannot."""

_TIE = np.log(3.0)
"""Log evidence within which the data do not tell two sets apart: three to one is what
they would be told apart by three times in four."""

_RIVAL = 0.1
"""Share of the best set's probability from which another set is a rival."""

_KIN = 0.008
"""The same for an effect of the same family: where a law of friction that flattens out
was called by the wrong one of two formulas, the right one had .01 to .4 of it."""

_DISTANT_KIN = 0.03
"""The same for one of another family that acts on the same parameter of the tire, or
with the same quantity: "force x time" was called by "friction x time"."""

_ABSURD = 8.0
"""Amplitude in prior scales beyond which an effect is no explanation."""

HARDLY = 0.02
"""Probability of nothing below which a gap stands though the score test misses it:
effects without a slope at zero escape that test."""

_SHOWS = 3.0
"""Log evidence over no gap from which a set of effects shows at all: 20 to 1."""

_FREED, _SINGLES = 6, 8
"""Sets, and sets of one effect, the most probable of each, that are weighed with other
forms and a remainder too."""


@dataclass(frozen=True)
class Verdict:
    """What is said: status, effects, the probability of exactly this set; the tests of
    what it leaves, once they are made; whether rows left out decided the status; the
    probability of something ``unlisted``, where it was asked for."""

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
    """
    likeliest = max((k for k in total if k), key=lambda k: total[k], default=())
    least = total[likeliest] + np.log(_RIVAL)
    alike = [k for k in total if len(k) == len(likeliest) and total[k] >= least]
    nearest = max(alike, key=lambda k: best[k].log_weight)
    return total | {likeliest: total[nearest], nearest: total[likeliest]}


def _simplest(total, count: int):
    """Single effects, the most probable first."""
    singles = sorted((k for k in total if len(k) == 1), key=total.get, reverse=True)
    return singles[:count]


def judge(search: Search, weighed: Weighed, p_value: float) -> Verdict:
    """The verdict that the probabilities support."""
    null = weighed.best_of[()]
    nothing = nothing_shown(weighed)
    if nothing > 0.5 or (p_value > _LEVEL and nothing > HARDLY):
        return Verdict("none", (), weighed.sets[()], (), p_value, null)
    best = weighed.best
    if not best:
        return Verdict(
            "unknown", ("unknown",), weighed.unknown_alone, (), p_value, null
        )
    return named(search, weighed, best, p_value)


def named(search: Search, weighed: Weighed, key, p_value: float) -> Verdict:
    """A set of effects named, with what these data cannot tell from it."""
    chosen = weighed.best_of[key]
    alike = (
        *_aliases(search, weighed, key), *ties(weighed, key),
        *_kin(search, weighed, key),
    )  # fmt: skip
    # Where only the prior decides, the data cannot tell.
    others = {k: v for k, v in weighed.listed.items() if k}
    rivals = tuple(dict.fromkeys((*alike, *_rivals(others, key))))
    probability = weighed.among_listed(key)
    sure = probability >= SURE and not alike
    status = "named" if sure or not rivals else "cannot_tell"
    return Verdict(status, key, probability, () if sure else rivals, p_value, chosen)


def ties(weighed: Weighed, key) -> tuple[str, ...]:
    """Effects that explain in the place of one of the set as well as that does."""
    return tuple(
        new
        for other, _, new in _swapped(weighed.log_weight, key)
        if weighed.evidence[other] > weighed.evidence[key] - _TIE
    )


def _kin(search: Search, weighed: Weighed, key) -> tuple[str, ...]:
    """Effects on what one of the set acts on that explain in its place nearly as well:
    formulas of one law differ by less than a tire does from any of them."""
    family = {a.effect.id: a.effect.family for a in search.base.atoms}
    kin, listed = [], weighed.listed
    for other, old, new in _swapped(listed, key):
        mine, its = family[old], family[new]
        # "friction x speed" is kin of "friction x time" and of "slip x speed", two of
        # one family are closer.
        near = _KIN if mine == its else _DISTANT_KIN
        what, _, by = mine.partition(" x ")
        other_what, _, other_by = its.partition(" x ")
        if what == other_what or (by and by == other_by):
            if listed[other] > near * listed[key]:
                kin.append(new)
    return tuple(kin)


def stand_ins(search: Search, weighed: Weighed, key) -> tuple[str, ...]:
    """Effects that move what one of the set moves and stand in its place beside
    something unlisted: the evidence between them is less than what that takes."""
    log = weighed.log_beside
    if key not in log:
        return ()
    moves = {a.effect.id: moved_by(a.effect.forms) for a in search.base.atoms}
    least = log[key] - max(0.0, *weighed.gains[key].values())
    return tuple(
        new
        for other, old, new in _swapped(log, key)
        if moves[old] & moves[new] and log[other] > least
    )


def swapped_beside(weighed: Weighed, key) -> tuple[str, ...]:
    """Effects that stand in the place of one of the set in other sets nearly as
    probable as the best: beside something unlisted, which other effects draw a part of
    it is chance."""
    log = weighed.log_weight
    least = max(log.values()) + np.log(_DISTANT_KIN)
    likely = {k: value for k, value in log.items() if value > least}
    return tuple(
        new
        for one in likely
        for _, old, new in _swapped(likely, one)
        if old in key and new not in key
    )


def _swapped(sets, key):
    """Sets that differ from ``key`` by one effect: (set, that of ``key``, its own)."""
    for other in sets:
        new, old = set(other) - set(key), set(key) - set(other)
        if len(new) == len(old) == 1:
            yield other, min(old), min(new)


def _aliases(search: Search, weighed: Weighed, key) -> tuple[str, ...]:
    """Effects that do to these data what one of the chosen does, at a size that is not
    absurd: the data would tell them apart less than three times in four, by the linear
    forecast, and no refit in its place did."""
    base, chosen, fits = search.base, weighed.best_of[key], weighed.best_of
    # By the rows alone: a size that is hardly expected fits them as well.
    worst = chosen.chi2 - 2 * np.log(_KIN)
    swapped = _swapped(fits, key)
    apart = {(old, new) for other, old, new in swapped if fits[other].chi2 > worst}
    linear = base.linearised(chosen.z, amplitudes_of(base, chosen))
    alike: dict[str, float] = {}
    for atom, amplitude in zip(chosen.atoms, chosen.amplitude, strict=True):
        rest = [k for k in chosen.atoms if k != atom]
        used_up = np.concatenate([linear.jacobian, linear.columns[:, rest]], axis=1)
        left = without(linear.columns, used_up)
        norm = np.linalg.norm(left, axis=0)
        size = abs(amplitude) * norm[atom]
        if size < 1:  # standard error: at its bound, where it has no slope to compare
            continue
        for k in search.testable:
            effect = base.atoms[k].effect
            if effect.id in chosen.effects or norm[k] < UNSEEN:
                continue
            if (base.atoms[atom].effect.id, effect.id) in apart:
                continue
            needed = size / norm[k]
            told_apart = separability(left, atom, k, abs(amplitude), needed)
            if needed < _ABSURD and told_apart < _TOLD_APART:
                alike[effect.id] = min(told_apart, alike.get(effect.id, 1.0))
    return tuple(sorted(alike, key=lambda effect: alike[effect]))


def nothing_shown(weighed: Weighed) -> float:
    """Probability that nothing is there which these data could show."""
    shown = (p for k, p in weighed.sets.items() if weighed.evidence[k] < _SHOWS)
    return weighed.hidden + float(sum(shown))


def _rivals(named, best) -> tuple[str, ...]:
    """Effects of other sets that are nearly as probable: in the place of the best, or
    beside it."""
    rivals: dict[str, float] = {}
    for key, probability in named.items():
        if key == best or probability < _RIVAL * named[best]:
            continue
        for effect in sorted(set(key) - set(best)):
            if len(key) <= len(best) or set(best) < set(key):
                rivals[effect] = max(rivals.get(effect, 0.0), probability)
    return tuple(sorted(rivals, key=lambda effect: rivals[effect], reverse=True))
