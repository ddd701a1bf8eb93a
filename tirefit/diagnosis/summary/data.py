"""What was read, and what is known of it before any effect is looked for."""

from itertools import combinations

import numpy as np
from scipy.stats import spearmanr

from tirefit.data.table import TireData
from tirefit.diagnosis.effects.known import said_of_motion
from tirefit.diagnosis.evidence.base import Base
from tirefit.diagnosis.rows.patterns import quantities
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.diagnosis.rows.rig import Rig
from tirefit.diagnosis.summary.records import DataSummary

_CONDITIONS = ("time", "fz", "v", "temperature", "gamma", "pressure")

_TOGETHER = 0.9
"""Rank correlation from which two conditions are told apart by the form of their laws
alone: of the order of a change in one, the other knows four fifths."""


def data_summary(data: TireData, base: Base, rig: Rig) -> DataSummary:
    """The file of a diagnosis.

    Args:
        data: the table as it was read.
        base: the fit to its rows.
        rig: what is known of the measurement.
    """
    said = base.simulator.doubt if base.simulator else ""
    doubts = (f"warning: {said}",) if said else ()
    return DataSummary(
        name=data.name, path=data.source.path, sha256=data.source.sha256,
        convention=data.source.convention, channels=base.prepared.channels,
        assumptions=(*doubts, *data.source.notes, *rig.notes, *rig.beside(data)),
        set_aside=data.first_masked(), motion=said_of_motion(base, rig),
        together=moving_together(base.prepared),
    )  # fmt: skip


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
