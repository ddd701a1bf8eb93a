"""Effects, covariates and needs of a diagnosis in words, and what to do about them."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from tirefit.data.table import CANONICAL
from tirefit.diagnosis.effects import NOISE_EFFECTS
from tirefit.report.numbers import format_estimate, format_number

__all__ = [
    "WORDS",
    "Words",
    "covariate_text",
    "names_an_effect",
    "needs_text",
    "p_text",
    "parameter_text",
    "range_text",
    "share_text",
    "untestable_groups",
    "words_on",
]


class Words(NamedTuple):
    """What an effect is, and what to do once it is named."""

    means: str
    remedy: str


_SPLIT = "fit the two parts as runs of their own"
_PER_RUN = "cut the record into runs and fit {} per run"

WORDS: dict[str, Words] = {
    "pressure_asymmetry": Words("the contact pressure is skewed", "fit brush-d"),
    "pressure_flatness": Words(
        "the contact pressure is flatter or sharper than a parabola",
        "fit quartic or elliptic",
    ),
    "kinetic_friction": Words("friction falls once the bristles slide", "fit brush-m"),
    "friction_speed_linear": Words(
        "friction falls in proportion to the sliding speed", "fit brush-n"
    ),
    "friction_speed_exponential": Words(
        "friction falls exponentially with the sliding speed", "fit brush-h"
    ),
    "load_stiffness": Words("stiffness is a power of the load", "fit brush-load"),
    "load_friction": Words("friction is a power of the load", "fit brush-load"),
    "friction_temperature": Words(
        "friction changes with temperature", "fit mu for each range of temperature"
    ),
    "stiffness_temperature": Words(
        "stiffness changes with temperature", "fit cpa2 for each range of temperature"
    ),
    "friction_drift": Words(
        "friction changes slowly over the record", _PER_RUN.format("mu")
    ),
    "stiffness_drift": Words(
        "stiffness changes slowly over the record", _PER_RUN.format("cpa2")
    ),
    "friction_step": Words(
        "friction changes at one time", "cut the record there and fit mu per run"
    ),
    "friction_hysteresis": Words(
        "friction differs between growing and shrinking slip", _SPLIT
    ),
    "drive_brake_asymmetry": Words(
        "friction differs between the two signs of slip", _SPLIT
    ),
    "slip_offset": Words(
        "the slip is off by a constant",
        "add it to the slip; check the rolling radius, or the zero of heading or"
        " steering",
    ),
    "force_offset": Words(
        "the force is off by a constant",
        "subtract it; check the zero of the force sensor",
    ),
    "slip_definition": Words(
        "the slip follows another definition than it was read by",
        "read its column by the other one: --column kappa=HEADER or sigma_x=HEADER",
    ),
    "channel_delay": Words(
        "force and slip are shifted in time", "shift the force back by the delay"
    ),
    "relaxation_length": Words(
        "the force lags the slip over a rolling distance", "fit brush-relaxation"
    ),
    "wheel_inertia": Words(
        "the force lacks the torque that spins the wheel up",
        "add J (d omega / dt) / r to the force",
    ),
    "combined_slip": Words(
        "the other slip takes its part of the friction",
        "fit brush-anisotropic or magic-formula-combined to both slips",
    ),
    "camber_thrust": Words(
        "camber adds to the lateral force", "measure without camber, or correct for it"
    ),
    "conicity": Words(
        "a lateral force in proportion to load stands at zero slip",
        "measure again with the tire turned round, and take the mean",
    ),
    "pressure_shift_load": Words(
        "the contact pressure shifts with force or load",
        "fit brush-d-force or brush-d-load",
    ),
    "carcass_flexibility": Words(
        "the carcass gives way with the force",
        "use a carcass of tirefit.models.carcass; M_z tells it from skewed pressure",
    ),
    "outliers": Words("rows far off all others", "set [noise] loss = 'huber'"),
    "noise_heteroscedastic": Words(
        "noise that differs over the range", "give fx_std row by row"
    ),
    "noise_autocorrelated": Words(
        "neighbouring rows share their noise",
        "none needed: rows count at their effective number",
    ),
    "slip_noise": Words("the slip is measured with noise", "give sigma_x_std"),
}
"""Effect id -> words; effects of the user's own are called by their id alone."""

_NEEDS = {
    "loads": "more than one load",
    "speeds": "more than one speed",
    "signs": "slips of both signs",
    "sweeps": "slow sweeps of slip with time",
    "time": "time",
    "v": "speed v",
    "omega": "wheel speed omega",
    "temperature": "a temperature that varies",
    "gamma": "a camber gamma that varies",
    "other slip": "the other slip, not zero",
    "mz": "the aligning moment mz",
    "fx": "fx",
    "fy": "fy",
}
_COVARIATES = {
    "slip_fraction": "slip / slip of full sliding",
    "fz": "load F_z",
    "v": "speed v",
    "time": "time",
    "direction": "size of the slip",
    "sign": "sign of the slip",
    "temperature": "temperature",
    "gamma": "camber gamma",
}
_NAMED_VALUES = {
    "direction": {-1.0: "shrinking", 0.0: "steady", 1.0: "growing"},
    "sign": {-1.0: "negative", 0.0: "zero", 1.0: "positive"},
}


def words_on(effect: str) -> Words:
    """Words on an effect; empty for one that is not in the library."""
    return WORDS.get(effect, Words("", ""))


def names_an_effect(verdict: Mapping) -> bool:
    """Whether a verdict names effects on the mean force."""
    effects = [e for e in verdict["effects"] if e not in NOISE_EFFECTS]
    return bool(effects) and effects != ["unknown"]


def needs_text(needs: Sequence[str]) -> str:
    """``needs`` of an untestable effect in words."""
    return ", ".join(_NEEDS.get(need, need) for need in needs)


def untestable_groups(untestable: Sequence[Mapping]) -> list[tuple[str, str]]:
    """(what is needed, effects that need it), both in words."""
    groups: dict[str, list[str]] = {}
    for item in untestable:
        groups.setdefault(needs_text(item["needs"]), []).append(item["effect"])
    return [(needs, ", ".join(effects)) for needs, effects in groups.items()]


def covariate_text(name: str) -> str:
    """A covariate of ``where`` in words."""
    return _COVARIATES.get(name, name)


def range_text(region: Mapping) -> str:
    """Where a region of ``where`` lies: one value, or from - to, with its unit."""
    name, low, high = region["covariate"], region["low"], region["high"]
    if name in _NAMED_VALUES:
        return _NAMED_VALUES[name][round(low)]
    unit = CANONICAL.get(name, ("", ""))[0]
    tail = f" {unit}" if unit not in ("", "-") else ""
    if low == high:
        return f"{format_number(low)}{tail}"
    return f"{_end(low, high)} to {_end(high, high)}{tail}"


def _end(value: float, largest: float) -> str:
    """Three digits of the larger end are enough for both."""
    return format_number(0.0 if abs(value) < 5e-4 * abs(largest) else value, 3)


def parameter_text(candidate: Mapping) -> str:
    """Amplitudes of a candidate: ``name = value ± std unit``, named by effect where
    there are several."""
    several = len(candidate["parameters"]) > 1
    parts = []
    for name, found in candidate["parameters"].items():
        effect, _, parameter = name.partition(": ")
        unit = "" if found["unit"] in ("", "-") else f" {found['unit']}"
        label = f"{effect}: {parameter}" if several else parameter
        value = format_estimate(found["value"], found["std"])
        parts.append(f"{label} = {value}{unit}")
    return "; ".join(parts)


def share_text(share: float | None, ends=None) -> str:
    """``95 % [80 %, 96 %]``; ``-`` for a share that cannot be told."""
    if share is None:
        return "-"
    if ends is None or ends[0] is None:
        return f"{100 * share:.0f} %"
    low, high = ends
    return f"{100 * share:.0f} % [{100 * low:.0f} %, {100 * high:.0f} %]"


def p_text(p: float) -> str:
    """A p-value with two digits; tiny ones as a bound, as nobody knows them better."""
    return "< 1e-12" if p < 1e-12 or math.isnan(p) else f"{p:.2g}"
