"""Conditions that move together in a file: what follows one may follow the other."""

from itertools import combinations

import numpy as np
from scipy.stats import spearmanr

from tirefit.diagnosis.patterns import quantities
from tirefit.diagnosis.rows import Prepared

__all__ = ["moving_together"]

_CONDITIONS = ("time", "fz", "v", "temperature", "gamma", "pressure")

_TOGETHER = 0.9
"""Rank correlation from which two conditions are told apart by the form of their laws
alone: of the order of a change in one, the other knows four fifths."""


def moving_together(rows: Prepared) -> tuple[str, ...]:
    """A sentence on every two conditions of the tire that rise, or rise and fall,
    together; none in a design that crosses them."""
    values = quantities(rows, np.zeros(rows.n))
    said = []
    for one, other in combinations([c for c in _CONDITIONS if c in values], 2):
        rank = float(spearmanr(values[one], values[other]).statistic)
        if abs(rank) > _TOGETHER:
            how = "rises" if rank > 0 else "falls"
            said.append(
                f"{other} {how} with {one} in this file (rank correlation {rank:.2f}):"
                " what follows the one may be said to follow the other"
            )
    return tuple(said)
