"""Offsets that every run has of its own: each is set up anew."""

from typing import NamedTuple

import numpy as np

from tirefit.diagnosis.effects.record import PER_MILLE, Effect, adds, seldom
from tirefit.diagnosis.rows.rates import shown_runs


class Offset(NamedTuple):
    """An offset that each run may have of its own: the ``field`` of the state that it
    moves, the covariate with the ``pattern`` of the runs, its unit, and whether its
    amplitude is in thousandths of the mean load."""

    field: str
    pattern: str
    unit: str
    of_load: bool


OFFSETS = {
    "slip_offset": Offset("shift", "run_slip", "-", False),
    "force_offset": Offset("force", "run_force", "N", True),
}
"""Effect for all runs -> its offsets of single runs."""


def _one_each(prepared) -> float:
    """One amplitude stands for a pattern that has a number for every run: each further
    one costs what a parameter costs by BIC."""
    count = len(shown_runs(prepared.run, prepared.data.runs))
    further = max(count - 2, 0)
    return seldom(prepared) - 0.5 * further * np.log(prepared.n / max(count, 1))


SLIP_OFFSET_RUN = Effect(
    id="slip_offset_run",
    family="slip x run",
    change=adds("shift", lambda a, _, rows: a * rows.run_slip),
    scale=0.1,
    per=("slip",),
    unit="- of slip",
    formula="slip + offset of the run, spread by amplitude: a random effect",
    means="the zero of the slip differs from run to run",
    remedy=(
        "zero heading, steering or wheel speed before every run; fit the runs with an"
        " offset each"
    ),
    parameter="spread",
    bounds=((0.0, 4.0),),
    odds=_one_each,
    needs=("runs",),
    looks_like=("slip_offset", "slip_zero_drift", "force_offset_run"),
    told_apart_by="both signs",
)
FORCE_OFFSET_RUN = Effect(
    id="force_offset_run",
    family="force x run",
    change=adds("force", lambda a, _, rows: PER_MILLE * a * rows.load * rows.run_force),
    scale=15.0,
    unit="1e-3 mean F_z",
    formula="force + offset of the run, spread by amplitude: a random effect",
    means="the zero of the force differs from run to run",
    remedy="tare before every run; fit the runs with an offset each",
    parameter="spread",
    bounds=((0.0, 300.0),),
    odds=_one_each,
    needs=("runs",),
    looks_like=("force_offset", "force_zero_drift", "slip_offset_run"),
    told_apart_by="loads",
)

EFFECTS = (SLIP_OFFSET_RUN, FORCE_OFFSET_RUN)
