"""Effects of the measurement: offsets, drifting zeros, the definition of the slip, the
inertia of the wheel, crosstalk of channels, camber and conicity; and effects that differ
between runs: new zeros, changed tires or surfaces."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tirefit.diagnosis.effects.record import (
    PER_MILLE,
    Code,
    Constants,
    Prior,
    adds,
    blend,
    multiplies,
    seldom,
    xp,
)
from tirefit.diagnosis.effects.state import Covariates, State
from tirefit.diagnosis.rows.rig import AGAINST, BESIDE, FOR, Rig
from tirefit.diagnosis.rows.slips import shown_runs
from tirefit.params import Values

if TYPE_CHECKING:
    from tirefit.diagnosis.rows.prepared import Prepared


def _of_this_wheel(prior: Prior, prepared: "Prepared", rig: Rig) -> Prior:
    """The prior: a force computed from the torque lacks the inertia that the rig states."""
    if not (known := rig.wheel_inertia):
        return prior
    # Hub, disc and shaft turn too.
    return Prior(0.3 * known, known, prior.low, max(prior.high, 2 * known))


def _definition_odds(prepared: "Prepared") -> float:
    """Log odds from the slip of the wheel speed, whose errors are linear."""
    check = prepared.slip_check
    if check is None:
        return 0.0
    if check.fits != check.read_as:
        return FOR
    return AGAINST if check.told_apart else 0.0


def _seen_between_slips(prior: Prior, prepared: "Prepared", rig: Rig) -> Prior:
    """The prior, wide enough for the offset from the slip of the wheel speed."""
    check = prepared.slip_check
    if check is None or not check.shifted:
        return prior
    size = max(prior.scale, abs(check.offset))
    return Prior(size, prior.center, min(prior.low, -2 * size), max(prior.high, 2 * size))


def _offset_odds(prepared: "Prepared") -> float:
    """Log odds from the slip of the wheel speed; the radius may be wrong as well."""
    check = prepared.slip_check
    if check is None or check.fits != check.read_as:
        return 0.0
    if check.shifted:
        return BESIDE
    # An offset of zero is evidence against it if it is known to 5e-4.
    return AGAINST if check.agrees and check.offset_std < 5e-4 else 0.0


def _camber(state: State, share: float, constants: Constants, rows: Covariates) -> State:
    shift = state.shift + constants[0] * share * rows.gamma
    # A usual cornering stiffness of 10 loads per radian, so that both forms share a scale.
    thrust = constants[1] * 10.0 * share * rows.gamma * rows.fz * rows.load
    return state._replace(shift=shift, force=state.force + thrust)


def _settled(rows: Covariates, constants: Constants) -> Values | float:
    """A drift that is linear over the record, or faster at first, with a fifth of the record as
    time constant, while an amplifier warms up; zero at the middle."""
    late = 0.5 - xp.exp(-(rows.time + 0.5) / 0.2)
    return blend(constants, rows.time, late)


def _force_hysteresis(size: float, constants: Constants, rows: Covariates) -> Values:
    plain, grown = constants
    way = rows.turning * rows.side * (plain + grown * rows.usage)
    return PER_MILLE * size * rows.load * way


RELATIVE = "relative"
"""Unit of a relative change of a parameter of the tire; its mean over the runs is zero."""


class Offset(NamedTuple):
    """A quantity that may differ between runs."""

    field: str  # of the state, that changes
    pattern: str  # covariate with the pattern of the runs
    unit: str
    of_load: bool = False  # the amplitude is in thousandths of the mean load


RUN_OFFSETS = {
    "slip_offset": Offset("shift", "run_slip", "-"),
    "force_offset": Offset("force", "run_force", "N", of_load=True),
    "friction": Offset("friction", "run_friction", RELATIVE),
    "stiffness": Offset("stiffness", "run_stiffness", RELATIVE),
}
"""Id of an effect without ``_run`` -> the quantity that differs between runs."""


def _one_each(prepared: "Prepared") -> float:
    """Prior log odds: the pattern has a number for every run, and each beyond the first
    costs as much as a parameter in BIC."""
    count = len(shown_runs(prepared.run, prepared.data.runs))
    further = max(count - 2, 0)
    return seldom(prepared) - 0.5 * further * np.log(prepared.n / max(count, 1))


_IN_PROPORTION = adds("force", lambda a, _, rows: PER_MILLE * a * rows.load * rows.fz)

_OF_RUNS: Code = {
    "slip_offset": adds("shift", lambda a, _, rows: a * rows.run_slip),
    "force_offset": adds("force", lambda a, _, rows: PER_MILLE * a * rows.load * rows.run_force),
    "friction": multiplies("friction", lambda a, _, rows: xp.exp(a * rows.run_friction)),
    "stiffness": multiplies("stiffness", lambda a, _, rows: xp.exp(a * rows.run_stiffness)),
}
"""Changes by the patterns of :data:`RUN_OFFSETS`."""

CODE: Code = {
    "slip_offset": dict(
        change=adds("shift", lambda a, _, rows: a), odds=_offset_odds, prior=_seen_between_slips
    ),
    "force_offset": adds("force", lambda a, _, rows: PER_MILLE * a * rows.load),
    "slip_definition": dict(
        change=adds("curvature", lambda a, constants, _: constants[0] * a),
        odds=_definition_odds,
        # With the sign of the conversion that the reading of the slip requires.
        prior=lambda prior, rows, rig: prior._replace(center=prior.center * rows.definition),
    ),
    "wheel_inertia": dict(
        change=adds("force", lambda a, _, rows: -a * rows.spin), prior=_of_this_wheel
    ),
    "camber_thrust": _camber,
    "conicity": _IN_PROPORTION,
    "slip_zero_drift": adds("shift", lambda a, which, rows: a * _settled(rows, which)),
    "force_zero_drift": adds(
        "force", lambda a, which, rows: PER_MILLE * a * rows.load * _settled(rows, which)
    ),
    "load_crosstalk": _IN_PROPORTION,
    # A brush with another load equals one with another friction; this is exact if the
    # stiffness does not depend on the load.
    "load_offset": multiplies(
        "friction", lambda a, _, rows: (1 + PER_MILLE * a / rows.fz) / (1 + PER_MILLE * a)
    ),
    "force_crosstalk": adds("force", lambda a, _, rows: a * rows.across),
    "force_hysteresis": adds("force", _force_hysteresis),
    **{f"{kind}_run": dict(change=change, odds=_one_each) for kind, change in _OF_RUNS.items()},
}
