"""What carries over to a run that was left out: where a file holds several logs, its
effects are chosen by that.

Logs of one vehicle differ more than their rows do, and effects together draw the
differences of those that are there. What another log is predicted by is no drawing.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import stdtr, stdtrit

from tirefit.diagnosis.decide.conclusion import Judge, unknown
from tirefit.diagnosis.decide.verdict import Verdict, Weighed
from tirefit.diagnosis.evidence.base import Base
from tirefit.diagnosis.evidence.forward import MOST
from tirefit.diagnosis.evidence.runs import KINDS
from tirefit.diagnosis.evidence.search import Hypothesis, Search
from tirefit.diagnosis.negligible import NONZERO
from tirefit.diagnosis.rows.rates import shown_runs

_FEWEST = 4
"""Runs from which leaving them out in turn says something: of three, two are left to
fit, and Student's t of two degrees of freedom hardly tells any set from none."""

_LEVEL = 0.95
"""Quantile of Student's t up to which a set is no worse than the best."""

_CARRIES = 0.8
"""Probability of predicting another run better than none, from which a set is named."""

_OF_ONE_RUN = tuple(f"{kind}_run" for kind in KINDS)
"""Effects that nothing outside their run can show."""


class Carried(NamedTuple):
    """The set of effects that carries over, and the others of its size that the runs
    cannot tell from it; ``()`` where none helps. ``probability`` is that of its
    predicting another run better than none, by Student's t over the runs."""

    effects: tuple[str, ...]
    also: tuple[tuple[str, ...], ...]
    probability: float


def losses_left_out(base: Base, candidates: list[Hypothesis]) -> np.ndarray:
    """Mean square of what each candidate misses on each run when fitted to the others
    [N^2], first channel: (R, candidates), at most :data:`MOST` of them."""
    rows, main = base.rows, base.rows.channels[0]
    observed, losses = rows.observed[main], []
    sets = [h.atoms for h in candidates]
    starts = [(h.z, h.amplitude) for h in candidates]
    for code in shown_runs(rows.run, rows.data.runs):
        out = rows.run == code
        keep = np.array(base.design.keep)
        good = out & (keep[: rows.n] > 0)
        keep[: rows.n] *= ~out
        refitted = base.refit(starts, sets, base.design._replace(keep=keep))
        each = []
        for k, atoms in enumerate(sets):
            amplitudes = base.amplitudes(atoms, refitted.amplitude[k])
            missed = observed - base.forces(refitted.z[k], amplitudes)[main]
            each.append(np.mean(missed[good] ** 2))
        losses.append(each)
    return np.array(losses)


def chosen_across_runs(names: list[tuple[str, ...]], losses, priors) -> Carried:
    """The smallest set that is not worse than the best beyond what so many runs differ
    by: Breiman's rule (1984, 3.4) with Student's t at 5 %. None where even that is
    hardly likely to predict another run better than no effect does.

    Args:
        names: sets of effects, () for none.
        losses: (R, sets) on each run left out; runs count alike.
        priors: (sets,) log odds that choose between sets which the runs cannot tell
            apart; of those that are alike, the smaller loss.
    """
    count = len(losses)

    def over(reference):
        """Mean and standard error of each loss less that of one set."""
        behind = losses - losses[:, [reference]]
        return behind.mean(axis=0), behind.std(axis=0, ddof=1) / np.sqrt(count)

    none = names.index(())
    some = [k for k in range(len(names)) if k != none]
    if not some:
        return Carried((), (), 1.0)
    mean, error = over(some[int(np.argmin(losses[:, some].mean(axis=0)))])
    alike = [k for k in some if mean[k] <= stdtrit(count - 1, _LEVEL) * error[k]]
    size = min(len(names[k]) for k in alike)
    smallest = [k for k in alike if len(names[k]) == size]
    smallest.sort(key=lambda k: (-priors[k], losses[:, k].mean()))
    first, *others = smallest
    gained, error = over(first)
    sure = stdtr(count - 1, gained[none] / max(error[none], NONZERO))
    if sure < _CARRIES:
        return Carried((), (), float(1 - sure))
    return Carried(names[first], tuple(names[k] for k in others), float(sure))


def _candidates(search: Search, weighed: Weighed, verdict: Verdict):
    """None, the verdict's own set, every effect by itself, the most probable others."""
    singles: dict[tuple[str, ...], Hypothesis] = {}
    for hypothesis in search.hypotheses:
        key = hypothesis.effects
        if len(key) == 1 and (
            key not in singles or hypothesis.log_weight > singles[key].log_weight
        ):
            singles[key] = hypothesis
    log = weighed.log_weight
    ranked = sorted(log, key=lambda k: log[k], reverse=True)
    key = tuple(sorted(verdict.chosen.effects))
    wanted = {(): weighed.best_of[()], key: verdict.chosen} | singles
    wanted |= {k: weighed.best_of[k] for k in ranked if k not in wanted}
    usable = {k: h for k, h in wanted.items() if not set(k) & set(_OF_ONE_RUN)}
    return dict(list(usable.items())[:MOST])


def held_across_runs(
    verdict: Verdict, search: Search, weighed: Weighed, generator
) -> tuple[Verdict, Weighed]:
    """The verdict that the runs allow, each left out in turn, with its set among those
    that were weighed. Unchanged for fewer than four runs, where there is no gap, and
    where the set that carries over may not be named.

    Args:
        generator: of simulated residuals.
    """
    base = search.base
    runs = shown_runs(base.rows.run, base.rows.data.runs)
    if len(runs) < _FEWEST or verdict.status == "none" or base.simulator is not None:
        return verdict, weighed
    if set(verdict.effects) & set(_OF_ONE_RUN):
        return verdict, weighed
    candidates = _candidates(search, weighed, verdict)
    losses = losses_left_out(base, list(candidates.values()))
    # The usual before the rare; not by how many forms its family has.
    priors = [_odds(search, hypothesis) for hypothesis in candidates.values()]
    carried = chosen_across_runs(list(candidates), losses, priors)
    key = tuple(sorted(carried.effects))
    if key == tuple(sorted(verdict.effects)):
        return verdict, weighed
    if not key:
        nothing = unknown(verdict, weighed, verdict.adequacy, carried.probability)
        return nothing, weighed
    if verdict.status in ("unknown", "incomplete"):
        return _carried_beside(verdict, weighed, key), weighed
    hypothesis = _fitted(base, candidates[carried.effects])
    wider = replace(
        weighed, best_of=weighed.best_of | {key: hypothesis},
        sets={key: 0.0} | weighed.sets,
        log_weight={key: -np.inf} | weighed.log_weight,
    )  # fmt: skip
    judge = Judge(search, wider, generator)
    if judge.imitates(key) or not judge.is_known(key):
        return verdict, weighed
    left = judge.of(key).adequacy
    rivals = {e for other in carried.also for e in other} - set(key)
    status = "incomplete"
    if left.passed:
        status = "cannot_tell" if rivals else "named"
    chosen = replace(
        verdict, status=status, effects=key, chosen=hypothesis, adequacy=left,
        probability=carried.probability,
        also_possible=tuple(sorted(rivals)),
    )  # fmt: skip
    return chosen, wider


def _carried_beside(verdict: Verdict, weighed: Weighed, key) -> Verdict:
    """A verdict with something unlisted, without what does not carry over: runs that
    are alike carry over what only draws the rest, and no name is added for that."""
    kept = tuple(e for e in verdict.effects if e in key)
    if verdict.status == "unknown" or kept == verdict.effects:
        return verdict
    if not kept or kept not in weighed.best_of:
        return unknown(verdict, weighed, verdict.adequacy, verdict.unlisted)
    return replace(verdict, effects=kept, chosen=weighed.best_of[kept])


def _odds(search: Search, hypothesis: Hypothesis) -> float:
    """Log odds of a set's effects before any force is looked at."""
    rows, atoms = search.base.rows, search.base.atoms
    effects = [atoms[k].effect for k in hypothesis.atoms]
    return float(sum(e.odds(rows) for e in effects if e.odds is not None))


def _fitted(base: Base, hypothesis: Hypothesis) -> Hypothesis:
    """The hypothesis refitted to all rows, where the search had not."""
    if hypothesis.refitted:
        return hypothesis
    start = [(hypothesis.z, hypothesis.amplitude)]
    fit, size = base.refit(start, [hypothesis.atoms]), len(hypothesis.atoms)
    p = len(fit.z[0])
    return replace(
        hypothesis, z=np.asarray(fit.z[0]), refitted=True,
        amplitude=np.asarray(fit.amplitude[0][:size]),
        covariance=np.asarray(fit.covariance[0][: p + size, : p + size]),
        chi2=float(fit.chi2[0]),
    )  # fmt: skip
