"""A beam search over sets of effects, and the posterior over the sets that it refitted,
without and beside an effect that is not listed. The linear evidence of further effects
proposes sets, refits weigh them."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, combinations
from math import factorial
from typing import TypeVar

import numpy as np
from scipy.special import log_ndtr, logsumexp, softmax

from tirefit.diagnosis.engine import NONZERO, UNSEEN
from tirefit.diagnosis.engine.fit import Fit, Forward, Key, Start

MOST_EFFECTS = 3
"""Largest number of effects of a set."""

PRIOR_OF_SIZE = (0.4, 0.4, 0.1, 0.015)
"""Prior probability by number of effects: none and one are equally likely, and each
further effect is four to seven times rarer."""


@dataclass(frozen=True)
class Effort:
    """How many sets are refitted.

    Attributes:
        singles: smallest number of single effects; ``variants`` of each.
        beam: number of sets of each size that are extended; ``width``: of effects that
            are added to each.
        pairs: number of pairs of the linear screen.
        near: log evidence below the best, in the linear screen, which is inaccurate for a large
            gap, within which a single effect is refitted.
    """

    singles: int = 6
    variants: int = 3
    beam: int = 3
    width: int = 6
    pairs: int = 6
    near: float = 15.0


_FAR, _SMALL = 4.0, 0.3
"""Starts of a refit, in prior scales: largest amplitude, and second start."""

Item = TypeVar("Item")


def parts_of(key: tuple[Item, ...]) -> list[tuple[Item, ...]]:
    """A set of effects and its subsets, the largest first."""
    sizes = range(len(key), 0, -1)
    return list(chain.from_iterable(combinations(key, size) for size in sizes))


def log_bayes(
    gram: np.ndarray, score: np.ndarray, center: np.ndarray, sign: np.ndarray,
    sets: Sequence[tuple[int, ...]],
) -> np.ndarray:  # fmt: skip
    """Log Bayes factors (s,) of Gaussian amplitudes, prior scale 1, on the columns of
    each of the sets (s, k), all of one size."""
    index = np.asarray(sets)
    along = np.arange(index.shape[1])
    g, m = gram[index[:, :, None], index[:, None, :]], center[index]
    gm = np.einsum("sij,sj->si", g, m)
    shifted = score[index] - gm
    a = g + np.eye(len(along))
    # Solve instead of inverting, which loses most digits for similar effects.
    solved = np.linalg.solve(a, shifted[:, :, None])[:, :, 0]
    value = np.sum((score[index] - 0.5 * gm) * m + 0.5 * shifted * solved, axis=1)
    value -= 0.5 * np.linalg.slogdet(a)[1]
    z = (m + solved) / np.sqrt(np.linalg.inv(a)[:, along, along])
    one_sided = np.log(2) + log_ndtr(sign[index] * z)
    # Round, as identical variants differ in last digits; only units of evidence count.
    return np.round(value + np.sum(np.where(sign[index] != 0, one_sided, 0.0), axis=1), 6)


class Search:
    """The search on one subject. ``fits`` holds every refitted set of atoms, ``guessed`` the
    log weight and log evidence of sets that are too improbable to refit."""

    def __init__(self, subject: Forward, effort: Effort = Effort()) -> None:
        self.subject, self.effort = subject, effort
        self.effects = [atom.effect for atom in subject.atoms]
        self.ids = [effect.id for effect in self.effects]
        self.variants = Counter(self.ids[k] for k in subject.testable)
        kinds = {(self.effects[k].family, self.ids[k]) for k in subject.testable}
        self.forms = Counter(family for family, _ in kinds)
        self.sign = subject.priors.sign
        self.fits: dict[tuple[int, ...], Fit] = {}
        self.guessed: dict[tuple[int, ...], tuple[float, float]] = {}
        self.fits[()] = subject.refit([subject.start], [()])[0]
        self.gram, self.scores, self.projected = self.further(self.null)

    @property
    def null(self) -> Fit:
        """The fit without effects."""
        return self.fits[()]

    def further(self, fit: Fit) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Products, scores and columns of all atoms beside a fit."""
        return fit.further(self.subject.tangents(fit))

    def evidence(self, fit: Fit) -> float:
        """Log evidence over no effect."""
        return fit.log_evidence - self.null.log_evidence

    def weight(self, fit: Fit) -> float:
        """Log evidence plus log prior."""
        return self.evidence(fit) + self.log_prior(fit.atoms)

    @property
    def ranked(self) -> list[Fit]:
        """All fits, the most probable first."""
        return sorted(self.fits.values(), key=self.weight, reverse=True)

    def log_prior(self, atoms: tuple[int, ...]) -> float:
        """Log prior of a set: equal for families, then forms, then variants."""
        total = np.log(PRIOR_OF_SIZE[len(atoms)])
        for k in atoms:
            total -= np.log(len(self.forms) * self.forms[self.effects[k].family])
            total += self.subject.priors.odds[k] - np.log(self.variants[self.ids[k]])
        return float(total + np.log(factorial(len(atoms))))

    def refit(self, starts: Mapping[tuple[int, ...], Sequence[Start]]) -> None:
        """Refit sets of atoms, each from its starts; the better one of several counts."""
        new = [(s, start) for s in starts if s and s not in self.fits for start in starts[s]]
        if not new:
            return
        for fit in self.subject.refit([start for _, start in new], [s for s, _ in new]):
            known = self.fits.get(fit.atoms)
            if np.isfinite(fit.log_evidence) and (
                known is None or fit.log_evidence > known.log_evidence
            ):
                self.fits[fit.atoms] = fit

    def best_variants(
        self, gram: np.ndarray, score: np.ndarray, inside: Sequence[str] = ()
    ) -> list[list[tuple[float, int]]]:
        """For each further effect its atoms, the best effect first: [[(log evidence,
        atom), ...], ...]."""
        open_to = [
            k for k in self.subject.testable if gram[k, k] >= UNSEEN and self.ids[k] not in inside
        ]
        variants: dict[str, list[tuple[float, int]]] = {}
        values = self._screened(gram, score, [(k,) for k in open_to])
        for value, k in zip(values, open_to, strict=True):
            variants.setdefault(self.ids[k], []).append((value, k))
        return sorted((sorted(v, reverse=True) for v in variants.values()), reverse=True)

    def _screened(
        self, gram: np.ndarray, score: np.ndarray, sets: Sequence[tuple[int, ...]]
    ) -> list[float]:
        center = self.subject.priors.center
        return log_bayes(gram, score, center, self.sign, sets).tolist() if sets else []

    def _start(self, fit: Fit, atoms: Sequence[int], amplitude: np.ndarray) -> Start:
        """A start of a refit: a fit with amplitudes of these atoms, within their bounds, in
        addition."""
        priors, index = self.subject.priors, list(atoms)
        more = np.clip(amplitude, priors.low[index], priors.high[index])
        order = np.argsort((*fit.atoms, *atoms))
        return Start(fit.z, np.append(fit.amplitude, more)[order], fit.state)

    def _with(
        self, fit: Fit, k: int, gram: np.ndarray, score: np.ndarray
    ) -> tuple[tuple[int, ...], list[Start]]:
        """A set with one more atom, and the starts of its refit: the step that the linear
        score suggests, and a small one of the other sign for a tangent that misleads."""
        center = self.subject.priors.center[k]
        shift = (score[k] - gram[k, k] * center) / (gram[k, k] + 1)
        first = float(np.clip(center + shift, -_FAR, _FAR))
        if self.sign[k]:  # a start at zero would stay there
            first = self.sign[k] * max(self.sign[k] * first, 0.1)
        atoms, sizes = tuple(sorted((*fit.atoms, k))), [first]
        if any(self.effects[j].misleads for j in atoms):
            sizes.append(center or _SMALL * (self.sign[k] or -1.0))
        return atoms, [self._start(fit, (k,), np.array([size])) for size in sizes]

    def singles(self) -> None:
        """Refit the likeliest single effects, and those whose tangent misleads."""
        ranked, starts = self.best_variants(self.gram, self.scores), {}
        for rank, variants in enumerate(ranked):
            near = variants[0][0] > ranked[0][0][0] - self.effort.near
            if rank < self.effort.singles or near or self.effects[variants[0][1]].misleads:
                for _, k in variants[: self.effort.variants]:
                    atoms, begin = self._with(self.null, k, self.gram, self.scores)
                    starts[atoms] = begin
        self.refit(starts)

    def pairs(self) -> None:
        """Refit pairs of effects that are visible only together."""
        ranked = self.best_variants(self.gram, self.scores)
        starts: dict[tuple[int, ...], list[Start]] = {}
        sets = list(combinations(sorted(variants[0][1] for variants in ranked), 2))
        values = zip(self._screened(self.gram, self.scores, sets), sets, strict=True)
        for _, pair in sorted(values, reverse=True)[: self.effort.pairs]:
            index, starts[pair] = list(pair), []
            # The linear step from no effect, and a small negative one.
            products = self.gram[np.ix_(index, index)] + np.eye(2)
            step = np.clip(np.linalg.solve(products, self.scores[index]), -_FAR, _FAR)
            center, sign = self.subject.priors.center[index], self.sign[index]
            for sizes in (step, -_SMALL):
                wanted = np.where(sign != 0, sign, np.where(center != 0, center, sizes))
                starts[pair].append(self._start(self.null, pair, wanted))
        self.refit(starts)

    def extend(self, size: int) -> None:
        """Extend the best sets of this size by the effects that their remainders suggest."""
        leading = [fit for fit in self.ranked if len(fit.atoms) == size][: self.effort.beam]
        starts: dict[tuple[int, ...], list[Start]] = {}
        top = max(self.weight(self.ranked[0]), *[w for w, _ in self.guessed.values()], -np.inf)
        for fit in leading:
            if self.weight(fit) < top - 30.0 and fit is not leading[0]:  # too far to catch up
                continue
            gram, score, _ = self.further(fit)
            ranked = self.best_variants(gram, score, fit.effects)
            for value, k in [variants[0] for variants in ranked[: self.effort.width]]:
                atoms, begin = self._with(fit, k, gram, score)
                evidence = self.evidence(fit) + value
                weight = evidence + self.log_prior(atoms)
                # Below by 4, it has less than a fiftieth of the weight of the best.
                if weight > top - 4.0:
                    starts.setdefault(atoms, begin)
                elif atoms not in self.fits:
                    self.guessed.setdefault(atoms, (weight, evidence))
        self.refit(starts)

    def refit_parts(self, fit: Fit) -> None:
        """Refit the subsets of the effects of a fit."""
        starts: dict[tuple[int, ...], list[Start]] = {}
        for part in parts_of(fit.atoms)[1:]:
            kept = [fit.atoms.index(k) for k in part]
            starts[part] = [Start(fit.z, fit.amplitude[kept], fit.state)]
        self.refit(starts)

    def refit_exchanged(self, fit: Fit) -> list[Fit]:
        """Refit a set with one of its effects replaced by an effect that is mistaken for it, for
        each such pair; the fits."""
        starts: dict[tuple[int, ...], list[Start]] = {}
        for atom in fit.atoms:
            rest = self.fits.get(tuple(k for k in fit.atoms if k != atom))
            if rest is None:
                continue
            gram, score, _ = self.further(rest)
            for variants in self.best_variants(gram, score, fit.effects):
                k = variants[0][1]
                replaced, other = self.effects[atom], self.effects[k]
                if other.id in replaced.looks_like or replaced.id in other.looks_like:
                    atoms, begin = self._with(rest, k, gram, score)
                    starts[atoms] = begin
        self.refit(starts)
        return [self.fits[atoms] for atoms in starts if atoms in self.fits]


def searched(subject: Forward, effort: Effort = Effort()) -> Search:
    """The fits of single effects, then of the best sets with further ones."""
    search = Search(subject, effort)
    search.singles()
    search.extend(1)
    search.pairs()
    for size in range(2, MOST_EFFECTS):
        search.extend(size)
    for fit in search.ranked[:2]:
        search.refit_parts(fit)
    return search


PRIOR_OF_UNKNOWN = 0.1
"""Prior probability of an unlisted effect, in addition to any set."""

_SHOWS = 3.0
"""Log evidence over no effect above which the data show a set of effects: 20 to 1."""


def _ranked(log_weight: Mapping[Key, float]) -> list[Key]:
    """The sets of one effect and more, the most probable first."""
    return sorted((k for k in log_weight if k), key=lambda k: log_weight[k], reverse=True)


@dataclass(frozen=True)
class Weighed:
    """Every refitted set of effects: its best fit; log evidence over no effect plus log
    prior; the same beside an unlisted effect (leading sets only); log evidence. ``hidden`` is the
    probability of sets that were not refitted and that these data could not show."""

    best_of: Mapping[Key, Fit]
    log_weight: Mapping[Key, float]
    log_beside: Mapping[Key, float]
    evidence: Mapping[Key, float]
    log_total: float
    hidden: float

    @property
    def ranked(self) -> list[Key]:
        """The sets of one effect and more, the most probable first."""
        return _ranked(self.log_weight)

    @property
    def best(self) -> Key:
        """The most probable set of effects; () without a fit."""
        return next(iter(self.ranked), ())

    @property
    def best_beside(self) -> Key:
        """The most probable set of effects beside an unlisted one."""
        return next(iter(_ranked(self.log_beside)), ())

    @cached_property
    def sets(self) -> dict[Key, float]:
        """Probability of every set, without an unlisted effect."""
        return {k: float(np.exp(v - self.log_total)) for k, v in self.log_weight.items()}

    @cached_property
    def beside(self) -> dict[Key, float]:
        """Probability of the leading sets, each beside an unlisted effect."""
        return {k: float(np.exp(v - self.log_total)) for k, v in self.log_beside.items()}

    @property
    def unlisted(self) -> float:
        """Probability of an unlisted effect, alone or beside a set."""
        return min(sum(self.beside.values()), 1.0)

    @cached_property
    def listed(self) -> dict[Key, float]:
        """Probability of every set, given that there is no unlisted effect."""
        log = self.log_weight
        return dict(zip(log, softmax([*log.values()]).tolist(), strict=True))

    def holding(self, effects: tuple[str, ...], beside: bool = False) -> float:
        """Probability of the sets that hold these effects: given an effect, all listed; or
        beside an unlisted one."""
        sets = self.beside if beside else {k: p for k, p in self.listed.items() if k}
        held = sum(p for k, p in sets.items() if set(effects) <= set(k))
        return held / max(sum(sets.values()), NONZERO)

    @property
    def nothing_shown(self) -> float:
        """Probability of the sets that these data could not show."""
        weak = (p for k, p in self.sets.items() if self.evidence[k] < _SHOWS)
        return min(self.hidden + sum(weak), 1.0)


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
    # The eight most probable sets and single effects are also weighed beside an unlisted one.
    beside = {
        key: total[key]
        + search.subject.discrepancy.log_evidence(best[key])
        + float(np.log(PRIOR_OF_UNKNOWN))
        for key in dict.fromkeys([*ranked[:8], *singles[:8], ()])
    }
    # (log weight, log evidence) of the sets that were not refitted.
    rest = [both for atoms, both in search.guessed.items() if atoms not in search.fits]
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
