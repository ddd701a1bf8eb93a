"""From the search to a verdict: is there a gap, which effects, how sure."""

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from tirefit.diagnosis.basis import log_evidence_gain, orthogonal
from tirefit.diagnosis.search import PRIOR_OF_UNKNOWN, Hypothesis, Search

__all__ = ["Verdict", "Weighed", "gap_p_value", "judge", "weigh"]

SURE = 0.8
"""Probability from which an effect is named without alternatives."""

_LEVEL = 0.05
_DRAWS = 2000


@dataclass(frozen=True)
class Verdict:
    """What is said: status, effects, the probability of exactly this set."""

    status: str
    effects: tuple[str, ...]
    probability: float
    also_possible: tuple[str, ...]
    p_value: float
    chosen: Hypothesis


@dataclass(frozen=True)
class Weighed:
    """Probability of every set of effects; ``unknown`` is that of a gap that no listed
    effect explains, alone or beside the set."""

    sets: dict[tuple[str, ...], float]
    best_of: dict[tuple[str, ...], Hypothesis]
    unknown_alone: float
    unknown_beside: dict[tuple[str, ...], float]


def gap_p_value(search: Search, generator) -> float:
    """Whether there is a gap at all: the largest score, and a generic misfit, each
    against simulated noise; the smaller of both, doubled."""
    base, left = search.base, search.projected
    size = np.linalg.norm(left, axis=0)
    use = [k for k in search.testable if size[k] > 1e-6]
    z = left[:, use] / size[use]
    residual, jacobian, _ = base.at_null
    observed = np.max(np.abs(z.T @ residual), initial=0.0)
    values, vectors = np.linalg.eigh(z.T @ z)
    root = vectors * np.sqrt(np.maximum(values, 0))
    draws = np.abs(root @ generator.standard_normal((len(use), _DRAWS))).max(0)
    p_score = (1 + np.sum(draws >= observed)) / (1 + _DRAWS)
    basis, weight = orthogonal(base.basis, jacobian)
    total = np.sum(weight**2 * (basis.T @ residual) ** 2)
    noise = generator.standard_normal((_DRAWS, len(weight))) ** 2 @ weight**2
    p_generic = (1 + np.sum(noise >= total)) / (1 + _DRAWS)
    return float(min(1.0, 2 * min(p_score, p_generic)))


def weigh(search: Search, amplitudes_of) -> Weighed:
    """Posterior probabilities of all sets, with and without an unknown remainder."""
    logs: dict[tuple[str, ...], list[float]] = {}
    best: dict[tuple[str, ...], Hypothesis] = {}
    for hypothesis in search.hypotheses:
        key = tuple(sorted(hypothesis.effects))
        logs.setdefault(key, []).append(hypothesis.log_weight)
        if key not in best or hypothesis.log_weight > best[key].log_weight:
            best[key] = hypothesis
    total = {key: float(logsumexp(values)) for key, values in logs.items()}
    ranked = sorted(total, key=total.get, reverse=True)
    beside = {}
    for key in {(), *ranked[:4]}:
        gain = _remainder_gain(search, best[key], amplitudes_of(best[key]))
        beside[key] = total[key] + gain + np.log(PRIOR_OF_UNKNOWN)
    everything = logsumexp([*total.values(), *beside.values()])
    return Weighed(
        {k: float(np.exp(v - everything)) for k, v in total.items()},
        best,
        float(np.exp(beside[()] - everything)),
        {k: float(np.exp(v - everything)) for k, v in beside.items() if k},
    )


def _remainder_gain(search: Search, hypothesis: Hypothesis, amplitudes) -> float:
    base = search.base
    residual, jacobian, tangent = (
        base.linearised(hypothesis.z, amplitudes) if hypothesis.atoms else base.at_null
    )
    own = tangent[:, list(hypothesis.atoms)]
    left, size = orthogonal(base.basis, np.concatenate([jacobian, own], axis=1))
    return log_evidence_gain(left, size, residual)


def judge(search: Search, weighed: Weighed, p_value: float) -> Verdict:
    """The verdict that the probabilities support."""
    null = weighed.best_of[()]
    nothing = weighed.sets[()]
    if p_value > _LEVEL or nothing > 0.5:
        return Verdict("none", (), nothing, (), p_value, null)
    named = {k: v for k, v in weighed.sets.items() if k}
    together = {k: v + weighed.unknown_beside.get(k, 0.0) for k, v in named.items()}
    best = max(together, key=together.get, default=None)
    if best is None or weighed.unknown_alone > together[best]:
        return Verdict(
            "unknown", ("unknown",), weighed.unknown_alone, (), p_value, null
        )
    chosen = weighed.best_of[best]
    if weighed.unknown_beside.get(best, 0.0) > named[best]:
        return Verdict(
            "incomplete", best, weighed.unknown_beside[best], (), p_value, chosen
        )
    rivals = _rivals(named, best)
    sure = named[best] >= SURE
    status = "named" if sure or not rivals else "cannot_tell"
    return Verdict(status, best, named[best], () if sure else rivals, p_value, chosen)


def _rivals(named, best) -> tuple[str, ...]:
    """Effects of other sets that are nearly as probable and no larger."""
    found: dict[str, float] = {}
    for key, probability in named.items():
        if key == best or probability < 0.1 * named[best]:
            continue
        for effect in set(key) - set(best):
            if len(key) <= len(best):
                found[effect] = max(found.get(effect, 0.0), probability)
    return tuple(sorted(found, key=found.get, reverse=True))
