"""Effects that differ between runs: new zeros, changed tires or surfaces."""

from typing import Any, NamedTuple

import numpy as np

from tirefit.diagnosis.effects.arrays import xp
from tirefit.diagnosis.effects.record import PER_MILLE, SYMBOLS, Effect, adds, multiplies, seldom
from tirefit.diagnosis.rows.slips import shown_runs

RELATIVE = "relative"
"""Unit of a relative change of a parameter of the tire; its mean over the runs is zero."""


class Offset(NamedTuple):
    """A quantity that may differ between runs."""

    field: str  # of the state, that changes
    pattern: str  # covariate with the pattern of the runs
    unit: str
    of_load: bool = False  # the amplitude is in thousandths of the mean load


OFFSETS = {
    "slip_offset": Offset("shift", "run_slip", "-"),
    "force_offset": Offset("force", "run_force", "N", of_load=True),
    "friction": Offset("friction", "run_friction", RELATIVE),
    "stiffness": Offset("stiffness", "run_stiffness", RELATIVE),
}
"""Id of an effect without ``_run`` -> the quantity that differs between runs."""


def _one_each(prepared) -> float:
    """Prior log odds: the pattern has a number for every run, and each beyond the first
    costs as much as a parameter in BIC."""
    count = len(shown_runs(prepared.run, prepared.data.runs))
    further = max(count - 2, 0)
    return seldom(prepared) - 0.5 * further * np.log(prepared.n / max(count, 1))


def _run(id: str, family: str, told_apart_by: str, **given: Any) -> Effect:
    return Effect(
        id=id,
        family=f"{family} x run",
        parameter="spread",
        odds=_one_each,
        needs=("runs",),
        told_apart_by=told_apart_by,
        **given,
    )


def _parameter_of_runs(name: str, fitted: str, scale: float, *looks_like: str):
    def factor(a, _, rows):
        return xp.exp(a * getattr(rows, OFFSETS[name].pattern))

    return _run(
        f"{name}_run",
        name,
        "random order",
        change=multiplies(name, factor),
        scale=scale,
        formula=f"{SYMBOLS[name]} exp(difference of the run), spread by amplitude",
        means=f"{name} differs from run to run: another tire, surface or day",
        remedy=f"fit {fitted} for each run; compare runs of one tire and surface only",
        # The pattern of one is found without the other, so it may have its sign.
        bounds=((-1.5, 1.5),),
        looks_like=(f"{name}_drift", f"{name}_warming", *looks_like),
    )


EFFECTS = (
    _run(
        "slip_offset_run", "slip", "both signs", of="measurement",
        scale=0.1, per=("slip",),
        change=adds("shift", lambda a, _, rows: a * rows.run_slip), unit="- of slip",
        formula="slip + offset of the run, spread by amplitude: a random effect",
        means="the zero of the slip differs from run to run", bounds=((0.0, 4.0),),
        remedy="zero heading, steering or wheel speed before every run; fit the runs"
        " with an offset each",
        looks_like=("slip_offset", "slip_zero_drift", "force_offset_run"),
    ),
    _run(
        "force_offset_run", "force", "loads", of="measurement",
        scale=15.0, unit="1e-3 mean F_z",
        change=adds(
            "force", lambda a, _, rows: PER_MILLE * a * rows.load * rows.run_force
        ), formula="force + offset of the run, spread by amplitude: a random effect",
        means="the zero of the force differs from run to run", bounds=((0.0, 300.0),),
        remedy="tare before every run; fit the runs with an offset each",
        looks_like=("force_offset", "force_zero_drift", "slip_offset_run"),
    ),
    _parameter_of_runs("friction", "mu", 0.12, "friction_step", "stiffness_run"),
    _parameter_of_runs("stiffness", "cpa2", 0.18, "friction_run"),
)  # fmt: skip
