"""The posterior over sets of effects: each with its evidence, alone and beside a
discrepancy, which is whatever no listed effect explains."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import logsumexp, softmax

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
)
from tirefit.diagnosis.negligible import NONZERO
from tirefit.diagnosis.rows.basis import of_any_kind

_SHOWS = 3.0
"""Log evidence over no effect from which a set of effects shows at all: 20 to 1."""

_RIVAL = 0.1
"""Share of the best set's probability from which another set is a rival."""

_FREED, _SINGLES = 6, 8
"""Sets, and sets of one effect, the most probable of each, that are weighed with other
forms and with a discrepancy too."""

Key = tuple[str, ...]
"""A set of effects: their ids in order; () is no effect."""


@dataclass(frozen=True)
class Weighed:
    """Every refitted set of effects with its weight.

    ``best_of`` is the best fit of each set, ``log_weight`` its log evidence over no
    effect plus log prior, ``log_beside`` the same with a discrepancy beside it (of the
    leading sets), ``evidence`` the log evidence alone, in whatever form; ``other_form``
    holds the sets whose effects have a form of their own. ``gains`` is the log evidence
    of each kind of discrepancy beside a set. ``hidden`` is the probability of sets too
    improbable to be refitted, which these data could not show either.
    """

    best_of: Mapping[Key, Hypothesis]
    log_weight: Mapping[Key, float]
    log_beside: Mapping[Key, float]
    evidence: Mapping[Key, float]
    other_form: frozenset[Key]
    gains: Mapping[Key, Mapping[str, float]]
    log_total: float
    hidden: float

    @property
    def best(self) -> Key:
        """The most probable set of effects, if all that is there is listed; () where
        none was fitted."""
        log = self.log_weight
        return max((k for k in log if k), key=lambda k: log[k], default=())

    @cached_property
    def sets(self) -> dict[Key, float]:
        """Probability of every set, and of nothing else."""
        return {
            k: float(np.exp(v - self.log_total)) for k, v in self.log_weight.items()
        }

    @cached_property
    def beside(self) -> dict[Key, float]:
        """Probability of the leading sets, each with a discrepancy beside it."""
        return {
            k: float(np.exp(v - self.log_total)) for k, v in self.log_beside.items()
        }

    @property
    def unlisted(self) -> float:
        """Probability of a discrepancy, alone or beside a set."""
        return min(sum(self.beside.values()), 1.0)

    @cached_property
    def listed(self) -> dict[Key, float]:
        """Probability of every set, if all that is there is listed."""
        log = self.log_weight
        return dict(zip(log, softmax([*log.values()]).tolist(), strict=True))

    def holding(self, effects) -> float:
        """Probability of the sets that hold these effects, if something is there and
        all of it is listed."""
        some = {k: p for k, p in self.listed.items() if k}
        held = sum(p for k, p in some.items() if set(effects) <= set(k))
        return held / max(sum(some.values()), NONZERO)

    def holding_beside(self, effects) -> float:
        """Probability of the sets that hold these effects, with a discrepancy."""
        held = sum(p for k, p in self.beside.items() if set(effects) <= set(k))
        return held / max(sum(self.beside.values()), NONZERO)

    def listed_given_gap(self, key: Key) -> float:
        """Probability of exactly this set, on the same terms."""
        return self.listed[key] / max(1 - self.listed.get((), 0.0), NONZERO)

    @property
    def nothing_shown(self) -> float:
        """Probability that nothing is there which these data could show."""
        weak = (p for k, p in self.sets.items() if self.evidence[k] < _SHOWS)
        return min(self.hidden + sum(weak), 1.0)


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
    everything = float(logsumexp([*total.values(), *beside.values(), *rest]))
    hidden = [h.log_weight for h in guessed if h.log_evidence < _SHOWS]
    return Weighed(
        best_of=best, log_weight=total, log_beside=beside, evidence=evidence,
        other_form=frozenset(others), gains=remainder, log_total=everything,
        hidden=float(np.sum(np.exp(np.array(hidden) - everything))),
    )  # fmt: skip


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
