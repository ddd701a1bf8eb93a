"""How much each of several effects closes, whatever the order they are added in."""

from collections.abc import Callable
from itertools import combinations
from math import factorial

from tirefit.diagnosis.evidence.base import Base
from tirefit.diagnosis.evidence.search import Hypothesis


def shapley(players: tuple, worth: Callable[[tuple], float]) -> dict:
    """Shapley value of every player: its mean gain over all orders.

    Args:
        players: distinct, few.
        worth: of a tuple of players in the order of ``players``; of () too.
    """
    count, known = len(players), {}
    for size in range(count + 1):
        for chosen in combinations(players, size):
            known[chosen] = worth(chosen)
    values = {}
    for player in players:
        value = 0.0
        for without in known:
            if player not in without:
                joined = tuple(p for p in players if p in without or p == player)
                weight = factorial(len(without)) * factorial(count - len(without) - 1)
                value += weight / factorial(count) * (known[joined] - known[without])
        values[player] = value
    return values


def closed_by_each(base: Base, chosen: Hypothesis) -> dict[str, float]:
    """Shares of the misfit's energy that the effects of a hypothesis take away; they
    sum to one. Every subset is refitted. Empty for fewer than two effects."""
    if len(chosen.atoms) < 2:
        return {}
    sets = [
        subset
        for size in range(len(chosen.atoms) + 1)
        for subset in combinations(range(len(chosen.atoms)), size)
    ]
    starts = [(chosen.z, chosen.amplitude[list(subset)]) for subset in sets]
    atoms = [tuple(chosen.atoms[k] for k in subset) for subset in sets]
    refitted = base.refit(starts, atoms)
    chi2 = dict(zip(atoms, refitted.chi2.tolist(), strict=True))
    closed = chi2[()] - chi2[chosen.atoms]
    if not closed > 0:
        return {}
    values = shapley(chosen.atoms, lambda subset: (chi2[()] - chi2[subset]) / closed)
    return {base.atoms[k].effect.id: value for k, value in values.items()}
