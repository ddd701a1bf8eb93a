"""The posterior over sets of effects, without and beside one that is not listed."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import logsumexp, softmax

from tirefit.diagnosis.engine.fit import Fit, Key
from tirefit.diagnosis.engine.search import Search
from tirefit.diagnosis.negligible import NONZERO

PRIOR_OF_UNKNOWN = 0.1
"""Prior probability of an unlisted effect, in addition to any set."""

_SHOWS = 3.0
"""Log evidence over no effect above which the data show a set of effects: 20 to 1."""

_LEADING = 8
"""Numbers of the most probable sets, and of the most probable single effects, that are
also weighed beside an unlisted one."""


@dataclass(frozen=True)
class Weighed:
    """Every refitted set of effects: its best fit; log evidence over no effect plus log
    prior; the same beside an unlisted effect (leading sets only); log evidence.
    ``hidden`` is the probability of sets that were not refitted and that these data could
    not show."""

    best_of: Mapping[Key, Fit]
    log_weight: Mapping[Key, float]
    log_beside: Mapping[Key, float]
    evidence: Mapping[Key, float]
    log_total: float
    hidden: float

    @property
    def best(self) -> Key:
        """The most probable set of effects; () without a fit."""
        log = self.log_weight
        return max((k for k in log if k), key=lambda k: log[k], default=())

    @property
    def best_beside(self) -> Key:
        """The most probable set of effects beside an unlisted one."""
        log = self.log_beside
        return max((k for k in log if k), key=lambda k: log[k], default=())

    @property
    def ranked(self) -> list[Key]:
        """The sets of one effect and more, the most probable first."""
        log = self.log_weight
        return sorted((k for k in log if k), key=lambda k: log[k], reverse=True)

    @cached_property
    def sets(self) -> dict[Key, float]:
        """Probability of every set, without an unlisted effect."""
        return self._probabilities(self.log_weight)

    @cached_property
    def beside(self) -> dict[Key, float]:
        """Probability of the leading sets, each beside an unlisted effect."""
        return self._probabilities(self.log_beside)

    def _probabilities(self, log: Mapping[Key, float]) -> dict[Key, float]:
        return {k: float(np.exp(v - self.log_total)) for k, v in log.items()}

    @property
    def unlisted(self) -> float:
        """Probability of an unlisted effect, alone or beside a set."""
        return min(sum(self.beside.values()), 1.0)

    @cached_property
    def listed(self) -> dict[Key, float]:
        """Probability of every set, given that there is no unlisted effect."""
        log = self.log_weight
        return dict(zip(log, softmax([*log.values()]).tolist(), strict=True))

    def holding(self, effects) -> float:
        """Probability of the sets that hold these effects, given an effect, all listed."""
        return _holding({k: p for k, p in self.listed.items() if k}, effects)

    def holding_beside(self, effects) -> float:
        """Probability of the sets that hold these effects, beside an unlisted one."""
        return _holding(self.beside, effects)

    @property
    def nothing_shown(self) -> float:
        """Probability of the sets that these data could not show."""
        weak = (p for k, p in self.sets.items() if self.evidence[k] < _SHOWS)
        return min(self.hidden + sum(weak), 1.0)


def _holding(sets: Mapping[Key, float], effects) -> float:
    held = sum(p for k, p in sets.items() if set(effects) <= set(k))
    return held / max(sum(sets.values()), NONZERO)


def weighed(search: Search) -> Weighed:
    """Posterior probabilities of all sets, alone and beside an unlisted effect."""
    logs: dict[Key, list[float]] = {}
    best: dict[Key, Fit] = {}
    for fit in search.ranked:
        logs.setdefault(fit.key, []).append(search.weight(fit))
        best.setdefault(fit.key, fit)
    total = {key: float(logsumexp(values)) for key, values in logs.items()}
    ranked = sorted(total, key=lambda key: total[key], reverse=True)
    singles = [key for key in ranked if len(key) == 1]
    beside = {
        key: total[key]
        + search.subject.discrepancy.log_evidence(best[key])
        + float(np.log(PRIOR_OF_UNKNOWN))
        for key in dict.fromkeys([*ranked[:_LEADING], *singles[:_LEADING], ()])
    }
    rest = search.rest()
    everything = float(logsumexp([*total.values(), *beside.values(), *(w for w, _ in rest)]))
    weak = [weight for weight, evidence in rest if evidence < _SHOWS]
    return Weighed(
        best_of=best,
        log_weight=total,
        log_beside=beside,
        evidence={key: search.evidence(fit) for key, fit in best.items()},
        log_total=everything,
        hidden=float(np.sum(np.exp(np.array(weak) - everything))),
    )
