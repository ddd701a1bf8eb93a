"""Which effects: screened in closed form, refitted one by one, weighed by evidence."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy.special import log_ndtr

from tirefit.diagnosis.evidence.base import Base
from tirefit.diagnosis.evidence.forward import MOST
from tirefit.diagnosis.negligible import ROUNDING
from tirefit.diagnosis.rows.basis import without

PRIOR_OF_SIZE = {0: 0.4, 1: 0.4, 2: 0.1, 3: 0.015}
"""Probability of so many effects at once; nothing and one are as likely, and every
further one is four to seven times rarer."""

PRIOR_OF_KIN = 0.1
"""That two effects of one set are of one family, against two families."""

PRIOR_OF_UNKNOWN = 0.1
"""That something is there that no listed effect explains, beside any set."""

_BEST_SINGLES, _WITHIN = 6, 15.0
"""Single effects that are refitted: so many, and all within so much log evidence of the
best by the linear screen, which may be wrong by some of it on a large gap."""

_PAIRS, _BEYOND_ONE, _BEYOND_TWO = 6, (3, 6), (2, 4)
"""Pairs of the linear screen that are refitted; sets of one and of two effects that are
extended, and effects that are tried beside each: what is less likely rarely wins."""

_UNSEEN = 1e-6
"""Squared length of a direction of whitened rows below which an effect of the usual
size changes them all by a thousandth of a standard error together."""

_HOPELESS = 30.0
"""Log weight below the best at which a set is not extended any more."""

_DIGITS = 6
"""Decimals of the log evidence of the linear screen: finer differences are rounding."""

_WORTH_A_REFIT = 4.0
"""Log weight below the best, by the linear step, at which a set is not refitted: less
than a fiftieth of the best each."""


@dataclass(frozen=True)
class Hypothesis:
    """A set of atoms, refitted: what it costs and explains.

    ``log_evidence`` is relative to the base model alone; ``log_prior`` that of the
    set. ``amplitude`` is in prior scales, ``covariance`` that of (z, amplitude).
    ``due_to_doubt`` is what of the evidence the doubt of the slips made, to first order
    around the base fit. ``refitted`` is False where the linear step showed that it is
    not worth it.
    """

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


@dataclass
class Search:
    """Everything the search has found out about one file: ``tried`` is every set of
    atoms with its fit, ``refit`` adds sets to it, from (z, amplitude) by set."""

    base: Base
    testable: tuple[int, ...]
    score: dict[str, float]
    tried: Mapping[tuple[int, ...], Hypothesis]
    projected: np.ndarray
    refit: Callable[[Sequence[tuple[int, ...]], dict], None]

    @property
    def hypotheses(self) -> list[Hypothesis]:
        return list(self.tried.values())

    @property
    def best(self) -> Hypothesis:
        fitted = [h for h in self.hypotheses if h.refitted]
        return max(fitted, key=lambda h: h.log_weight)


def _log_bayes(gram, score, center, sign, sets) -> np.ndarray:
    """Log Bayes factors (s,) of Gaussian amplitudes, prior scale 1, on the columns of
    each of the sets (s, k), all of one size."""
    sets = np.asarray(sets)
    own = np.arange(sets.shape[1])
    g, m = gram[sets[:, :, None], sets[:, None, :]], center[sets]
    gm = np.einsum("sij,sj->si", g, m)
    shifted = score[sets] - gm
    a = g + np.eye(len(own))
    # Solved, not by the inverse: like effects leave few digits of that.
    solved = np.linalg.solve(a, shifted[:, :, None])[:, :, 0]
    value = np.sum((score[sets] - 0.5 * gm) * m + 0.5 * shifted * solved, axis=1)
    value -= 0.5 * np.linalg.slogdet(a)[1]
    z = (m + solved) / np.sqrt(np.linalg.inv(a)[:, own, own])
    one_sided = np.log(2) + log_ndtr(sign[sets] * z)
    return value + np.sum(np.where(sign[sets] != 0, one_sided, 0.0), axis=1)


class _Searcher:
    """One search: it remembers what was refitted."""

    def __init__(self, base: Base, testable: Sequence[int]):
        self.base, self.testable = base, tuple(testable)
        effects = [atom.effect for atom in base.atoms]
        self.low, self.high = base.design.low, base.design.high
        # One half of the prior is gone where only one sign is physical.
        self.sign = np.where(self.low >= 0, 1.0, np.where(self.high <= 0, -1.0, 0.0))
        self.center = np.asarray(base.design.prior_center)
        self.ids = [effect.id for effect in effects]
        self.odds = [e.odds(base.rows) if e.odds else 0.0 for e in effects]
        self.singular = np.array([effect.far for effect in effects], bool)
        self.tried: dict[tuple[int, ...], Hypothesis] = {}
        families = {effects[k].family for k in self.testable}
        self.forms = {
            f: len({effects[k].id for k in self.testable if effects[k].family == f})
            for f in families
        }
        self.variants = {
            i: sum(1 for k in self.testable if self.ids[k] == i) for i in set(self.ids)
        }
        self._add_null()

    def log_prior(self, atoms: tuple[int, ...]) -> float:
        """Split evenly over families, then forms, then variants."""
        total = np.log(PRIOR_OF_SIZE[len(atoms)])
        for k in atoms:
            family = self.base.atoms[k].effect.family
            total -= np.log(len(self.forms) * self.forms[family])
            total += self.odds[k] - np.log(self.variants[self.ids[k]])
        families = {self.base.atoms[k].effect.family for k in atoms}
        total += np.log(PRIOR_OF_KIN) * (len(atoms) - len(families))
        return float(total + np.log(np.prod(np.arange(1, len(atoms) + 1))))

    def _add_null(self) -> None:
        refit = self.base.fit.refit
        self.null_chi2 = float(refit.chi2[0])
        self.null_log_det = float(refit.log_det[0])
        z = np.asarray(refit.z)[0]
        self.tried[()] = Hypothesis(
            (), (), 0.0, self.log_prior(()), z, np.zeros(0),
            np.asarray(refit.covariance)[0][: len(z), : len(z)], self.null_chi2,
        )  # fmt: skip

    def columns(self, hypothesis: Hypothesis):
        """(gram, score, projected columns (m, K)) around a refitted hypothesis."""
        base = self.base
        if hypothesis.atoms:
            amplitudes = amplitudes_of(base, hypothesis)
            residual, jacobian, columns, _ = base.linearised(hypothesis.z, amplitudes)
        else:
            residual, jacobian, columns, _ = base.at_null
        used_up = np.concatenate([jacobian, columns[:, hypothesis.atoms]], 1)
        return self._projected(*map(base.sure, (columns, used_up, residual)))

    def _projected(self, columns, used_up, residual):
        left = without(columns, used_up)
        return left.T @ left, left.T @ without(residual, used_up), left

    @cached_property
    def _with_doubt_and_without(self) -> tuple[tuple, tuple]:
        """(gram, score) around the base fit, twice."""
        residual, jacobian, columns, _ = self.base.at_null
        gram, score, _ = self._projected(columns, jacobian, residual)
        return self.columns(self.tried[()])[:2], (gram, score)

    def _due_to_doubt(self, atoms) -> float:
        """What the doubt of the slips takes from the log evidence of a set, to first
        order. Refits know nothing of it: of each slip's own noise only.

        It adds nothing: what an effect explains only where the slips are doubted is not
        seen in the data. Of pulses with noisy slips, doubt of their phase made a lag of
        1.4 standard errors likelier by a factor of a million.
        """
        doubting, sure = (
            _log_bayes(gram, score, self.center, self.sign, [atoms])[0]
            for gram, score in self._with_doubt_and_without
        )
        return float(min(doubting - sure, 0.0))

    def screened(self, gram, score, sets) -> list[float]:
        """Log Bayes factor of each of the sets, all of one size, in closed form."""
        if not sets:
            return []
        values = _log_bayes(gram, score, self.center, self.sign, sets)
        # Variants that are the same on a file differ by their last digits alone.
        return np.round(values, _DIGITS).tolist()

    def refit(self, sets: Sequence[tuple[int, ...]], guesses: dict) -> None:
        """Refit sets of atoms, two starts each where the sign is open."""
        sets = [s for s in dict.fromkeys(sets) if s and s not in self.tried]
        half = MOST // 2  # each set may have two starts
        for begin in range(0, len(sets), half):
            self._refit_some(sets[begin : begin + half], guesses)

    def _refit_some(self, sets, guesses) -> None:
        starts, index, owner = [], [], []
        for number, atoms in enumerate(sets):
            for z, amplitude in self._starts(atoms, guesses.get(atoms)):
                starts.append((z, amplitude))
                index.append(atoms)
                owner.append(number)
        every = self.base.refit(starts, index)
        for number, atoms in enumerate(sets):
            mine = [k for k, o in enumerate(owner) if o == number]
            total = every.chi2[mine] + every.penalty[mine]
            total = np.where(np.isfinite(total), total, np.inf)
            best = mine[int(np.argmin(total))]
            self._record(atoms, type(every)(*(part[best] for part in every)))

    def estimate(self, atoms, guess, within: Hypothesis, value: float) -> None:
        """Record a set too improbable to refit, from the linear step to it."""
        if atoms in self.tried:
            return
        p, size = len(within.z), len(atoms)
        z, amplitude = guess
        wide = np.eye(p + size)
        wide[:p, :p] = within.covariance[:p, :p]
        self.tried[atoms] = Hypothesis(
            atoms, tuple(self.ids[k] for k in atoms), within.log_evidence + value,
            self.log_prior(atoms), z, amplitude, wide, within.chi2, refitted=False,
        )  # fmt: skip

    def within(self, atoms, amplitude) -> np.ndarray:
        """Amplitudes of these atoms, in prior scales, where physics allows them."""
        return np.clip(amplitude, self.low[list(atoms)], self.high[list(atoms)])

    def _starts(self, atoms, guess):
        z = self.base.off_bounds(self.base.z)
        if guess is not None:
            yield self.base.off_bounds(guess[0]), guess[1]
        else:
            sign, center = self.sign[list(atoms)], self.center[list(atoms)]
            first = np.where(sign != 0, sign, 1.0)
            yield z, self.within(atoms, np.where(center != 0, center, first))
        if guess is None or any(self.singular[k] for k in atoms):
            sign, center = self.sign[list(atoms)], self.center[list(atoms)]
            other = np.where(sign != 0, _SMALL * sign, -1.0)
            yield z, self.within(atoms, np.where(center != 0, center, other))

    def _record(self, atoms, refit) -> None:
        if not np.isfinite(refit.chi2):
            return
        p, size = len(refit.z), len(atoms)
        value = -0.5 * (refit.chi2 - self.null_chi2) - 0.5 * refit.penalty
        value -= 0.5 * (refit.log_det - self.null_log_det)
        amplitude, cov = (
            refit.amplitude[:size],
            refit.covariance[: p + size, : p + size],
        )
        spread = np.sqrt(np.maximum(np.diag(cov)[p:], ROUNDING))
        for k, a, s in zip(atoms, amplitude, spread, strict=True):
            if self.sign[k]:
                value += np.log(2) + log_ndtr(self.sign[k] * a / s)
        due = self._due_to_doubt(atoms)
        self.tried[atoms] = Hypothesis(
            atoms, tuple(self.ids[k] for k in atoms), float(value + due),
            self.log_prior(atoms), refit.z, amplitude, cov, float(refit.chi2), due,
        )  # fmt: skip


_FAR, _SMALL, _TINY = 4.0, 0.3, 0.1
"""Amplitudes in prior scales where refits start: farthest, second start and nearest to
zero of an effect of one sign."""

_LIKELY_VARIANTS = 3
"""Variants of one effect that are refitted: those that the linear screen likes best."""


def _best_variants(searcher: _Searcher, gram, score, within=()):
    """For each effect its best atoms added to ``within``, the best effect first:
    [[(log weight, atom), ...], ...]."""
    variants: dict[str, list[tuple[float, int]]] = {}
    inside = {searcher.ids[k] for k in within}
    open_to = [
        k
        for k in searcher.testable
        if searcher.ids[k] not in inside and gram[k, k] >= _UNSEEN
    ]
    for value, k in zip(searcher.screened(gram, score, [(k,) for k in open_to]),
                        open_to, strict=True):  # fmt: skip
        variants.setdefault(searcher.ids[k], []).append((value, k))
    return sorted((sorted(v, reverse=True) for v in variants.values()), reverse=True)


def _guess(searcher, gram, score, hypothesis: Hypothesis, k: int):
    """Start of a refit: the step that the linear score suggests."""
    shift = (score[k] - gram[k, k] * searcher.center[k]) / (gram[k, k] + 1)
    first = np.clip(searcher.center[k] + shift, -_FAR, _FAR)
    if searcher.sign[k]:  # at zero itself it would stay
        first = searcher.sign[k] * max(searcher.sign[k] * first, _TINY)
    amplitude = np.append(hypothesis.amplitude, searcher.within((k,), first))
    order = np.argsort((*hypothesis.atoms, k))
    return tuple(np.array((*hypothesis.atoms, k))[order].tolist()), (
        hypothesis.z, amplitude[order]
    )  # fmt: skip


def search(base: Base, testable: Sequence[int]) -> Search:
    """Screen and refit singles, then what each of the best still lacks."""
    searcher = _Searcher(base, testable)
    null = searcher.tried[()]
    gram, score, left = searcher.columns(null)
    ranked = _best_variants(searcher, gram, score)
    singles, guesses = [], {}
    for rank, variants in enumerate(ranked):
        top, first = variants[0]
        near = rank < _BEST_SINGLES or top > ranked[0][0][0] - _WITHIN
        if near or searcher.singular[first]:
            for _, k in variants[:_LIKELY_VARIANTS]:
                atoms, guess = _guess(searcher, gram, score, null, k)
                singles.append(atoms)
                guesses[atoms] = guess
    searcher.refit(singles, guesses)
    _extend(searcher, 1, *_BEYOND_ONE)
    _pairs_by_screen(searcher, gram, score, [variants[0] for variants in ranked])
    _extend(searcher, 2, *_BEYOND_TWO)
    return Search(
        base, searcher.testable, _scores(searcher, gram, score), searcher.tried, left,
        searcher.refit,
    )  # fmt: skip


def _pairs_by_screen(searcher, gram, score, ranked, count: int = _PAIRS) -> None:
    """Pairs that only show together."""
    atoms = [k for _, k in ranked]
    pairs = list(combinations(sorted(atoms), 2))
    values = zip(searcher.screened(gram, score, pairs), pairs, strict=True)
    best = sorted(values, reverse=True)[:count]
    searcher.refit([pair for _, pair in best], {})


def _extend(searcher: _Searcher, size: int, beam: int, width: int) -> None:
    """Add to the best sets of this size what their remainders point at."""
    sets = [h for h in searcher.tried.values() if len(h.atoms) == size]
    sets = sorted(sets, key=lambda h: -h.log_weight)[:beam]
    wanted: list[tuple[int, ...]] = []
    guesses: dict[tuple[int, ...], tuple] = {}
    top = max(h.log_weight for h in searcher.tried.values())
    for hypothesis in sets:
        if hypothesis.log_weight < top - _HOPELESS and hypothesis is not sets[0]:
            continue
        gram, score, _ = searcher.columns(hypothesis)
        ranked = _best_variants(searcher, gram, score, hypothesis.atoms)
        for value, k in [variants[0] for variants in ranked[:width]]:
            atoms, guess = _guess(searcher, gram, score, hypothesis, k)
            expected = hypothesis.log_evidence + value + searcher.log_prior(atoms)
            if expected > top - _WORTH_A_REFIT:
                wanted.append(atoms)
                guesses.setdefault(atoms, guess)
            else:
                searcher.estimate(atoms, guess, hypothesis, value)
    searcher.refit(wanted, guesses)


def _scores(searcher: _Searcher, gram, score) -> dict[str, float]:
    """z of each effect at the base fit: the largest of its variants."""
    largest: dict[str, float] = {}
    for k in searcher.testable:
        if gram[k, k] > _UNSEEN:
            z = float(score[k] / np.sqrt(gram[k, k]))
            if abs(z) > abs(largest.get(searcher.ids[k], 0.0)):
                largest[searcher.ids[k]] = z
    return largest
