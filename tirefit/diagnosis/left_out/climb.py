"""Which set of effects predicts whole runs that its fit did not see: a climb from no
effect on, one effect at a time."""

import numpy as np

from tirefit.diagnosis.evidence.base import Base
from tirefit.diagnosis.evidence.changes import MOST_EFFECTS
from tirefit.diagnosis.evidence.search import Hypothesis, Search
from tirefit.diagnosis.left_out.folds import Folds
from tirefit.diagnosis.left_out.ladder import gained
from tirefit.diagnosis.left_out.predicted import predicted

_SINGLES, _SETS = 8, 12
"""Single effects, and sets, the most probable of each, whose effects may be steps."""


def climbed(base: Base, search: Search, folds: Folds, needed: float) -> Hypothesis:
    """The set that the climb ends at; every set on its way is refitted to all rows.

    A step adds the effect that predicts the runs left out best; then each of the others
    may give way to one that predicts them better. Of sets that differ by less than
    ``needed`` standard errors the most probable by evidence is taken, and the climb
    ends where no step gains more than that.
    """
    atoms = _steps(base, search)

    def better(now: Hypothesis, sets) -> Hypothesis:
        fits = {h.atoms: h for h in search.hypotheses if h.refitted}
        search.refit(
            sets, {s: _start(now, s, fits) for s in sets if _known(now, s, fits)}
        )
        fits = {h.atoms: h for h in search.hypotheses if h.refitted}
        tried = [now, *(fits[s] for s in sets if s in fits)]
        out = predicted(base, tried, folds)
        best = int(np.argmin(out.whitened.sum(axis=0)))

        def beats(new: int, old: int) -> bool:
            gain = gained(out, new, old, 0.0)
            return gain.gain > needed * gain.std

        steps = [k for k in range(len(tried)) if beats(k, 0) and not beats(best, k)]
        chosen = max(steps, key=lambda k: tried[k].log_weight, default=0)
        return tried[chosen]

    now, size = search.tried[()], 0
    while size == len(now.atoms) < MOST_EFFECTS:
        now, size = better(now, _one_more(base, now.atoms, atoms)), size + 1
        for gone in now.atoms if size == len(now.atoms) > 1 else ():
            kept = tuple(k for k in now.atoms if k != gone)
            now = better(now, _one_more(base, kept, atoms))
    return now


def of_one_run(base: Base) -> set[str]:
    """Effects that belong to a single run, or to one moment of it: other runs tell
    nothing of them."""
    effects = [atom.effect for atom in base.atoms]
    return {e.id for e in effects if "runs" in e.needs or e.scans_time}


def _steps(base: Base, search: Search) -> dict[str, int]:
    """Effects that may be steps, each by its atom in the best set that holds it."""
    ranked = search.fitted
    singles = [h for h in ranked if len(h.atoms) == 1][:_SINGLES]
    atoms: dict[str, int] = {}
    own = of_one_run(base)
    for hypothesis in (*ranked[:_SETS], *singles):
        for k in hypothesis.atoms:
            effect = base.atoms[k].effect
            if effect.id not in own:
                atoms.setdefault(effect.id, k)
    return atoms


def _one_more(base: Base, kept, atoms) -> list[tuple[int, ...]]:
    """Sets of these atoms and one more."""
    there = {base.atoms[k].effect.id for k in kept}
    new = [k for effect, k in atoms.items() if effect not in there]
    return [tuple(sorted((*kept, k))) for k in new]


def _known(now: Hypothesis, wanted, fits) -> bool:
    """Whether a size of every effect is known to start from."""
    return all(k in now.atoms or (k,) in fits for k in wanted)


def _start(now: Hypothesis, wanted, fits) -> tuple[np.ndarray, np.ndarray]:
    """Where the refit of a set starts: what is known of each of its effects."""
    sizes = dict(zip(now.atoms, now.amplitude.tolist(), strict=True))
    alone = {k: fits[(k,)].amplitude[0] for k in wanted if k not in sizes}
    return now.z, np.array([(sizes | alone)[k] for k in wanted])
