"""Search for sets of effects: a screen in closed form, then refits."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from math import factorial

import numpy as np
from scipy.special import log_ndtr

from tirefit.diagnosis.evidence.base import Base
from tirefit.diagnosis.evidence.fits import one_of
from tirefit.diagnosis.negligible import ROUNDING, UNSEEN
from tirefit.diagnosis.rows.basis import without

PRIOR_OF_SIZE = (0.4, 0.4, 0.1, 0.015)
"""Prior probability by number of effects: none and one are equally likely, and each
further effect is four to seven times rarer."""

PRIOR_OF_UNKNOWN = 0.1
"""Prior probability of an unlisted effect, in addition to any set."""

_WITHIN = 15.0
"""A single effect is refitted if its log evidence in the linear screen, which is inaccurate for a
large gap, is at most this far below the best. Sets that are twice as far below are not extended."""

_SOME, _BEYOND_TWO = 6, (2, 4)
"""Smallest numbers of refits: single effects, pairs of the linear screen, and effects added to the
best sets of one; number of sets of two that are extended, and of effects added to each."""

_WORTH_A_REFIT = 4.0
"""A set is not refitted if its log weight by the linear step is this far below the best:
less than a fiftieth of its weight."""

_FAR, _SMALL, _TINY = 4.0, 0.3, 0.1
"""Starts of a refit, in prior scales: largest amplitude, second start, and smallest
amplitude of an effect with one sign."""

_LIKELY = 3
"""Number of variants of an effect that are refitted, and of single effects that are extended."""


@dataclass(frozen=True)
class Hypothesis:
    """A set of atoms. ``log_evidence`` is relative to the base model, ``amplitude`` in
    prior scales, ``covariance`` that of (z, amplitude). ``due_to_doubt`` is the change
    of the evidence by the slip uncertainty, to first order. ``refitted`` is False for a
    linear estimate, of a set too improbable to refit."""

    atoms: tuple[int, ...]
    effects: tuple[str, ...]
    log_evidence: float
    log_prior: float
    z: np.ndarray
    amplitude: np.ndarray
    covariance: np.ndarray
    chi2: float
    due_to_doubt: float = 0.0
    refitted: bool = True

    @property
    def log_weight(self) -> float:
        return self.log_evidence + self.log_prior


def amplitudes_of(base: Base, hypothesis: Hypothesis) -> np.ndarray:
    """Amplitudes of all atoms (K,) in their own units."""
    return base.amplitudes(hypothesis.atoms, hypothesis.amplitude)


def _log_bayes(gram, score, center, sign, sets) -> np.ndarray:
    """Log Bayes factors (s,) of Gaussian amplitudes, prior scale 1, on the columns of
    each of the sets (s, k), all of one size."""
    sets = np.asarray(sets)
    own = np.arange(sets.shape[1])
    g, m = gram[sets[:, :, None], sets[:, None, :]], center[sets]
    gm = np.einsum("sij,sj->si", g, m)
    shifted = score[sets] - gm
    a = g + np.eye(len(own))
    # Solve instead of inverting, which loses most digits for similar effects.
    solved = np.linalg.solve(a, shifted[:, :, None])[:, :, 0]
    value = np.sum((score[sets] - 0.5 * gm) * m + 0.5 * shifted * solved, axis=1)
    value -= 0.5 * np.linalg.slogdet(a)[1]
    z = (m + solved) / np.sqrt(np.linalg.inv(a)[:, own, own])
    one_sided = np.log(2) + log_ndtr(sign[sets] * z)
    return value + np.sum(np.where(sign[sets] != 0, one_sided, 0.0), axis=1)


class Search:
    """The search on one file. ``tried`` holds the fit of every set of atoms so far."""

    def __init__(self, base: Base, testable: Sequence[int]):
        self.base, self.testable = base, tuple(testable)
        self.effects = [atom.effect for atom in base.atoms]
        self.low, self.high = base.design.low, base.design.high
        # Half of the prior is excluded if only one sign is physical.
        self.sign = np.where(self.low >= 0, 1.0, np.where(self.high <= 0, -1.0, 0.0))
        self.center = np.asarray(base.design.prior_center)
        self.ids = [effect.id for effect in self.effects]
        self.odds = [e.odds(base.rows) if e.odds else 0.0 for e in self.effects]
        self.variants = Counter(self.ids[k] for k in self.testable)
        kinds = {(self.effects[k].family, self.ids[k]) for k in self.testable}
        self.forms = Counter(family for family, _ in kinds)
        self.null = one_of(base.alone, 0)
        z = self.null.z
        self.tried: dict[tuple[int, ...], Hypothesis] = {
            (): Hypothesis(
                (),
                (),
                0.0,
                self.log_prior(()),
                z,
                np.zeros(0),
                self.null.covariance[: len(z), : len(z)],
                float(self.null.chi2),
            )
        }
        self.gram, self.scores, self.projected = self.columns(self.tried[()])

    @property
    def hypotheses(self) -> list[Hypothesis]:
        return list(self.tried.values())

    @property
    def fitted(self) -> list[Hypothesis]:
        """Hypotheses that were refitted, the most probable first."""
        fitted = [h for h in self.tried.values() if h.refitted]
        return sorted(fitted, key=lambda h: -h.log_weight)

    @property
    def best(self) -> Hypothesis:
        return self.fitted[0]

    @property
    def score(self) -> dict[str, float]:
        """Score of each effect at the base fit in standard errors: the largest one of its
        variants."""
        largest: dict[str, float] = {}
        for k in self.testable:
            if self.gram[k, k] > UNSEEN:
                z = float(self.scores[k] / np.sqrt(self.gram[k, k]))
                largest[self.ids[k]] = max(largest.get(self.ids[k], 0.0), z, key=abs)
        return largest

    def log_prior(self, atoms: tuple[int, ...]) -> float:
        """Log prior of each atom: equal for families, then forms, then variants."""
        total = np.log(PRIOR_OF_SIZE[len(atoms)])
        for k in atoms:
            total -= np.log(len(self.forms) * self.forms[self.effects[k].family])
            total += self.odds[k] - np.log(self.variants[self.ids[k]])
        return float(total + np.log(factorial(len(atoms))))

    def columns(self, hypothesis: Hypothesis):
        """(gram, score, projected columns (m, K)) around a refitted hypothesis."""
        base, amplitudes = self.base, amplitudes_of(self.base, hypothesis)
        residual, jacobian, columns, _ = base.linearised(hypothesis.z, amplitudes)
        used_up = np.concatenate([jacobian, columns[:, hypothesis.atoms]], 1)
        return self._projected(*map(base.sure, (columns, used_up, residual)))

    def _projected(self, columns, used_up, residual):
        left = without(columns, used_up)
        return left.T @ left, left.T @ without(residual, used_up), left

    @cached_property
    def _without_doubt(self) -> tuple:
        """(gram, score) around the base fit without the slip uncertainty."""
        residual, jacobian, columns, _ = self.base.at_null
        return self._projected(columns, jacobian, residual)[:2]

    def _due_to_doubt(self, atoms) -> float:
        """Log evidence that a set loses by the slip uncertainty, to first order; refits
        include only the noise of each slip. A gain is not counted, as the data do not
        support an effect that only explains rows with uncertain slips (in pulses with
        noisy slips, a lag of 1.4 standard errors would gain a factor of a million)."""
        doubting, sure = (
            _log_bayes(gram, score, self.center, self.sign, [atoms])[0]
            for gram, score in ((self.gram, self.scores), self._without_doubt)
        )
        return float(min(doubting - sure, 0.0))

    def screened(self, gram, score, sets) -> list[float]:
        """Log Bayes factor of each of the sets, all of one size, in closed form."""
        if not sets:
            return []
        values = _log_bayes(gram, score, self.center, self.sign, sets)
        # Round, as identical variants differ in last digits; only units of evidence count.
        return np.round(values, 6).tolist()

    def refit(self, sets: Sequence[tuple[int, ...]], guesses: dict) -> None:
        """Refit sets of atoms, each from two starts if the sign is not known."""
        done = {s for s, known in self.tried.items() if known.refitted}
        sets = [s for s in dict.fromkeys(sets) if s and s not in done]
        starts = [self._starts(atoms, guesses.get(atoms)) for atoms in sets]
        if not sets:
            return
        index = [s for s, mine in zip(sets, starts, strict=True) for _ in mine]
        every = self.base.refit([one for mine in starts for one in mine], index)
        total = every.chi2 + every.penalty
        total = np.where(np.isfinite(total), total, np.inf)
        for atoms in sets:
            mine = [k for k, other in enumerate(index) if other == atoms]
            self._record(atoms, one_of(every, mine[int(np.argmin(total[mine]))]))

    def estimate(self, atoms, guess, within: Hypothesis, value: float) -> None:
        """Record a set too improbable to refit, from the linear step to it."""
        p, (z, amplitude) = len(within.z), guess
        wide = np.eye(p + len(atoms))
        wide[:p, :p] = within.covariance[:p, :p]
        found = Hypothesis(
            atoms,
            tuple(self.ids[k] for k in atoms),
            within.log_evidence + value,
            self.log_prior(atoms),
            z,
            amplitude,
            wide,
            within.chi2,
            refitted=False,
        )
        self.tried.setdefault(atoms, found)

    def within(self, atoms, amplitude) -> np.ndarray:
        """Amplitudes of these atoms, in prior scales, limited to their physical range."""
        return np.clip(amplitude, self.low[list(atoms)], self.high[list(atoms)])

    def _starts(self, atoms, guess) -> list[tuple]:
        z = self.base.off_bounds(self.base.z)
        sign, center = self.sign[list(atoms)], self.center[list(atoms)]

        def at(size, default):
            first = np.where(sign != 0, size * sign, default)
            return z, self.within(atoms, np.where(center != 0, center, first))

        if guess is None:
            return [at(1.0, 1.0), at(_SMALL, -1.0)]
        first = self.base.off_bounds(guess[0]), guess[1]
        far = any(self.effects[k].far for k in atoms)
        return [first, at(_SMALL, -1.0)] if far else [first]

    def _record(self, atoms, refit) -> None:
        if not np.isfinite(refit.chi2):
            return
        p, size = len(refit.z), len(atoms)
        value = -0.5 * (refit.chi2 - self.null.chi2) - 0.5 * refit.penalty
        value -= 0.5 * (refit.log_det - self.null.log_det)
        amplitude = refit.amplitude[:size]
        cov = refit.covariance[: p + size, : p + size]
        spread = np.sqrt(np.maximum(np.diag(cov)[p:], ROUNDING))
        for k, a, s in zip(atoms, amplitude, spread, strict=True):
            if self.sign[k]:
                value += np.log(2) + log_ndtr(self.sign[k] * a / s)
        due = self._due_to_doubt(atoms)
        self.tried[atoms] = Hypothesis(
            atoms,
            tuple(self.ids[k] for k in atoms),
            float(value + due),
            self.log_prior(atoms),
            refit.z,
            amplitude,
            cov,
            float(refit.chi2),
            due,
        )

    def best_variants(self, gram, score, within=()) -> list[list[tuple[float, int]]]:
        """For each effect its best atoms added to ``within``, the best effect first:
        [[(log weight, atom), ...], ...]."""
        variants: dict[str, list[tuple[float, int]]] = {}
        inside = {self.ids[k] for k in within}
        seen = [k for k in self.testable if gram[k, k] >= UNSEEN]
        open_to = [k for k in seen if self.ids[k] not in inside]
        values = self.screened(gram, score, [(k,) for k in open_to])
        for value, k in zip(values, open_to, strict=True):
            variants.setdefault(self.ids[k], []).append((value, k))
        each = (sorted(v, reverse=True) for v in variants.values())
        return sorted(each, reverse=True)

    def guess(self, gram, score, hypothesis: Hypothesis, k: int):
        """A set with one more atom, and the start of its refit: the step that the
        linear score suggests."""
        shift = (score[k] - gram[k, k] * self.center[k]) / (gram[k, k] + 1)
        first = np.clip(self.center[k] + shift, -_FAR, _FAR)
        if self.sign[k]:  # a start at zero would stay there
            first = self.sign[k] * max(self.sign[k] * first, _TINY)
        amplitude = np.append(hypothesis.amplitude, self.within((k,), first))
        atoms = np.array((*hypothesis.atoms, k))
        order = np.argsort(atoms)
        return tuple(atoms[order].tolist()), (hypothesis.z, amplitude[order])

    def extend(self, size: int, beam: int, width: int) -> None:
        """Extend the best sets of this size by the effects that their remainders suggest."""
        sets = [h for h in self.tried.values() if len(h.atoms) == size]
        sets = sorted(sets, key=lambda h: -h.log_weight)[:beam]
        guesses: dict[tuple[int, ...], tuple] = {}
        top = max(h.log_weight for h in self.tried.values())
        for hypothesis in sets:
            if hypothesis.log_weight < top - 2 * _WITHIN and hypothesis is not sets[0]:
                continue
            gram, score, _ = self.columns(hypothesis)
            ranked = self.best_variants(gram, score, hypothesis.atoms)
            for value, k in [variants[0] for variants in ranked[:width]]:
                atoms, guess = self.guess(gram, score, hypothesis, k)
                expected = hypothesis.log_evidence + value + self.log_prior(atoms)
                if expected > top - _WORTH_A_REFIT:
                    guesses.setdefault(atoms, guess)
                else:
                    self.estimate(atoms, guess, hypothesis, value)
        self.refit(list(guesses), guesses)


def search(base: Base, testable: Sequence[int]) -> Search:
    """Screen and refit single effects, then add effects to the best sets."""
    searched = Search(base, testable)
    null, gram, score = searched.tried[()], searched.gram, searched.scores
    ranked = searched.best_variants(gram, score)
    guesses: dict[tuple[int, ...], tuple] = {}
    for rank, variants in enumerate(ranked):
        top, first = variants[0]
        near = rank < _SOME or top > ranked[0][0][0] - _WITHIN
        if near or searched.effects[first].far:
            more = [searched.guess(gram, score, null, k) for _, k in variants[:_LIKELY]]
            guesses |= dict(more)
    searched.refit(list(guesses), guesses)
    searched.extend(1, _LIKELY, _SOME)
    # Pairs of effects that are visible only together.
    pairs = list(combinations(sorted(variants[0][1] for variants in ranked), 2))
    values = zip(searched.screened(gram, score, pairs), pairs, strict=True)
    searched.refit([pair for _, pair in sorted(values, reverse=True)[:_SOME]], {})
    searched.extend(2, *_BEYOND_TWO)
    return searched
