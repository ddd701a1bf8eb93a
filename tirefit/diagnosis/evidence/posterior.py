"""The posterior over sets of effects. Each set is refitted, linearised around its fit,
and weighed without and with a discrepancy, which no listed effect explains."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.special import logsumexp, softmax

from tirefit.diagnosis.evidence.changes import MOST_EFFECTS
from tirefit.diagnosis.evidence.forms import form_columns
from tirefit.diagnosis.evidence.search import PRIOR_OF_UNKNOWN, Hypothesis, Search, amplitudes_of
from tirefit.diagnosis.negligible import FLAT, NONZERO
from tirefit.diagnosis.rows.basis import gain, gains, of_any_kind, orthogonal

_PRIOR_OF_FORM = 0.4
"""Probability that a listed effect has another form than its formula."""

_SHOWS = 3.0
"""Log evidence over no effect above which the data show a set of effects: 20 to 1."""

_FREED, _SINGLES = 6, 8
"""Numbers of the most probable sets, and of the most probable sets of one effect, that
are also weighed with other forms and with a discrepancy."""

Key = tuple[str, ...]
"""A set of effects: their ids in order; () means no effect."""


class LinearFit(NamedTuple):
    """A refitted hypothesis: residual (m,), its columns (m, p), those of other forms of
    its effects (m, k), and those of the slip noise by other measurements (m, j)."""

    residual: np.ndarray
    used_up: np.ndarray
    forms: np.ndarray
    proxies: np.ndarray

    @property
    def explained(self) -> np.ndarray:
        """Columns (m, p + j) to which a remainder is orthogonal."""
        return np.concatenate([self.used_up, self.proxies], axis=1)

    def in_other_form(self) -> "LinearFit":
        """The same columns with those of the other forms."""
        whole = np.concatenate([self.used_up, self.forms], axis=1)
        return self._replace(used_up=whole)


def linear_at(base, hypothesis: Hypothesis) -> LinearFit:
    """The linearisation around a refitted hypothesis."""
    amplitudes, atoms = amplitudes_of(base, hypothesis), list(hypothesis.atoms)
    residual, jacobian, columns, fields = base.linearised(hypothesis.z, amplitudes)
    effects = [base.atoms[k].effect for k in atoms]
    forms = form_columns(effects, fields, base.prepared, base.slip_fraction)
    keep = np.tile(base.design.keep[: base.prepared.n], len(base.prepared.channels))
    used_up = np.concatenate([jacobian, columns[:, atoms]], axis=1)
    return LinearFit(residual, used_up, forms * keep[:, None], base.proxies)


def due_to_doubt(base, hypothesis: Hypothesis, linear: LinearFit) -> float:
    """Change of the log evidence of a set by the shared slip uncertainty, at its fit. A
    refit ignores it and is not repeated. For sets with a large misfit, a repeated one
    would end elsewhere and change the evidence by tens of units."""
    center = np.asarray(base.design.prior_center)[list(hypothesis.atoms)]
    off = hypothesis.amplitude - center
    p = linear.used_up.shape[1] - len(off)
    prior = np.diag(np.concatenate([np.full(p, FLAT), np.ones(len(off))]))

    def log_evidence(used_up, residual):
        determinant = np.linalg.slogdet(used_up.T @ used_up + prior)[1]
        return -0.5 * (residual @ residual + off @ off + determinant)

    doubted = base.sure(linear.used_up), base.sure(linear.residual)
    return float(log_evidence(*doubted) - log_evidence(linear.used_up, linear.residual))


def gains_beside(base, linear: LinearFit, in_other_form: bool) -> dict[str, float]:
    """Log evidence of each kind of remainder in addition to a set of effects, with the
    form of the formulas or another one. The slip uncertainty can only reduce it."""

    def found(expected):
        return gains(base.generic, linear.explained, linear.residual, expected)

    forms = linear.forms if in_other_form else linear.forms[:, :0]
    sure = found(forms)
    if not base.doubt.shape[1] or max(sure.values()) <= 0:
        return sure
    doubting = found(np.concatenate([forms, base.doubt], axis=1))
    return {kind: min(value, doubting[kind]) for kind, value in sure.items()}


def fitted_form(linear: LinearFit) -> np.ndarray:
    """Forces that the other forms add to the fit, whitened: (m,)."""
    left, size = orthogonal(linear.forms, linear.used_up)
    t = size**2
    return left @ (left.T @ linear.residual * t / (1 + t))


@dataclass(frozen=True)
class Weighed:
    """Every refitted set of effects: its best fit; log evidence over no effect plus log
    prior; the same with a discrepancy (leading sets only); log evidence in any form;
    and that of each kind of discrepancy. ``other_form`` are the sets whose effects have
    another form; ``hidden`` is the probability of sets that are too improbable to be
    refitted and that these data could not show."""

    best_of: Mapping[Key, Any]
    log_weight: Mapping[Key, float]
    log_beside: Mapping[Key, float]
    evidence: Mapping[Key, float]
    other_form: frozenset[Key]
    gains: Mapping[Key, Mapping[str, float]]
    log_total: float
    hidden: float

    @property
    def best(self) -> Key:
        """The most probable set of effects without discrepancy; () without a fit."""
        log = self.log_weight
        return max((k for k in log if k), key=lambda k: log[k], default=())

    @cached_property
    def sets(self) -> dict[Key, float]:
        """Probability of every set, without a discrepancy."""
        return self._probabilities(self.log_weight)

    @cached_property
    def beside(self) -> dict[Key, float]:
        """Probability of the leading sets, each with a discrepancy."""
        return self._probabilities(self.log_beside)

    def _probabilities(self, log) -> dict[Key, float]:
        return {k: float(np.exp(v - self.log_total)) for k, v in log.items()}

    @property
    def unlisted(self) -> float:
        """Probability of a discrepancy, alone or in addition to a set."""
        return min(sum(self.beside.values()), 1.0)

    @cached_property
    def listed(self) -> dict[Key, float]:
        """Probability of every set, given that there is no discrepancy."""
        log = self.log_weight
        return dict(zip(log, softmax([*log.values()]).tolist(), strict=True))

    def holding(self, effects) -> float:
        """Probability of the sets that hold these effects, given an effect and no discrepancy."""
        return _holding({k: p for k, p in self.listed.items() if k}, effects)

    def holding_beside(self, effects) -> float:
        """Probability of the sets that hold these effects, with a discrepancy."""
        return _holding(self.beside, effects)

    def listed_given_gap(self, key: Key) -> float:
        """Probability of exactly this set, with a discrepancy."""
        return self.listed[key] / max(1 - self.listed.get((), 0.0), NONZERO)

    @property
    def nothing_shown(self) -> float:
        """Probability of the sets that these data could not show."""
        weak = (p for k, p in self.sets.items() if self.evidence[k] < _SHOWS)
        return min(self.hidden + sum(weak), 1.0)


def _holding(sets: Mapping[Key, float], effects) -> float:
    held = sum(p for k, p in sets.items() if set(effects) <= set(k))
    return held / max(sum(sets.values()), NONZERO)


def weigh(search: Search) -> Weighed:
    """Posterior probabilities of all sets, with and without an unknown remainder."""
    base, best = search.base, dict[Key, Hypothesis]()
    logs: dict[Key, list[float]] = {}
    # The remainder of a linear estimate is that of a smaller set.
    for hypothesis in (h for h in search.hypotheses if h.refitted):
        key = tuple(sorted(hypothesis.effects))
        logs.setdefault(key, []).append(hypothesis.log_weight)
        if key not in best or hypothesis.log_weight > best[key].log_weight:
            best[key] = hypothesis
    total = {key: float(logsumexp(values)) for key, values in logs.items()}
    evidence = {key: hypothesis.log_evidence for key, hypothesis in best.items()}
    others, remainder = set(), {}
    of_nothing = due_to_doubt(base, best[()], linear_at(base, best[()]))
    ranked = sorted(total, key=lambda key: total[key], reverse=True)
    singles = [key for key in ranked if len(key) == 1][:_SINGLES]
    for key in dict.fromkeys([*ranked[:_FREED], *singles, ()]):
        linear = linear_at(base, best[key])
        if linear.forms.shape[1] and len(key) < MOST_EFFECTS:
            formula = float(np.log(1 - _PRIOR_OF_FORM))
            # Without effects, the slip uncertainty explains what a form would.
            due = min(due_to_doubt(base, best[key], linear) - of_nothing, 0.0)
            form = _gain_of_form(base, linear) + due - best[key].due_to_doubt
            total[key] += float(np.logaddexp(formula, form))
            evidence[key] += float(np.logaddexp(formula, form))
            if form > formula:
                others.add(key)
        remainder[key] = gains_beside(base, linear, key in others)
    beside = {
        key: total[key] + of_any_kind(gains) + np.log(PRIOR_OF_UNKNOWN)
        for key, gains in remainder.items()
    }
    guessed = [h for h in search.hypotheses if not h.refitted]
    rest = [hypothesis.log_weight for hypothesis in guessed]
    everything = float(logsumexp([*total.values(), *beside.values(), *rest]))
    hidden = [h.log_weight for h in guessed if h.log_evidence < _SHOWS]
    return Weighed(
        best_of=best,
        log_weight=total,
        log_beside=beside,
        evidence=evidence,
        other_form=frozenset(others),
        gains=remainder,
        log_total=everything,
        hidden=float(np.sum(np.exp(np.array(hidden) - everything))),
    )


def _gain_of_form(base, linear: LinearFit) -> float:
    """Log evidence of the other forms over the formulas, with their prior."""
    left, size = orthogonal(base.sure(linear.forms), base.sure(linear.used_up))
    there = gain(left.T @ base.sure(linear.residual), size)
    return there + float(np.log(_PRIOR_OF_FORM))
