"""Effects by id: typical amplitude, what they need, and several forms of each.

The first form is the textbook one; the last is kept for sealed trials. A form takes
(world, amplitude, generator) and changes the world.
"""

from collections.abc import Callable
from typing import NamedTuple

from fits.withheld import forms

__all__ = ["EFFECTS", "Effect", "NOISE_EFFECTS", "family_of"]

NOISE_EFFECTS = (
    "outliers",
    "noise_heteroscedastic",
    "noise_autocorrelated",
    "slip_noise",
)


class Effect(NamedTuple):
    """``sign``: +1, -1 or 0 (either). ``needs``: properties of a design or columns."""

    family: str
    typical: float
    sign: int
    needs: frozenset
    forms: dict[str, Callable]


def _effect(family, typical, sign, needs, *choices):
    return Effect(
        family, typical, sign, frozenset(needs.split()),
        {choice.__name__: choice for choice in choices},
    )  # fmt: skip


EFFECTS = {
    "pressure_asymmetry": _effect(
        "pressure", 0.2, 1, "knee",
        forms.skewed, forms.skewed_beta, forms.skewed_warp),
    "pressure_flatness": _effect(
        "pressure", 0.6, 1, "knee",
        forms.quartic_mix, forms.power_pressure, forms.trapezoid, forms.sixth_order),
    "kinetic_friction": _effect(
        "friction", 0.2, 1, "knee",
        forms.two_frictions, forms.slip_weakening, forms.slow_weakening),
    "friction_speed_linear": _effect(
        "friction x speed", 0.01, 1, "knee",
        forms.speed_linear, forms.speed_saturating, forms.speed_power),
    "friction_speed_exponential": _effect(
        "friction x speed", 0.15, 1, "knee",
        forms.speed_root, forms.stribeck, forms.stribeck_squared,
        forms.speed_logarithm),
    "load_stiffness": _effect(
        "stiffness x load", 0.4, 1, "loads",
        forms.stiffness_power, forms.stiffness_affine, forms.stiffness_saturating),
    "load_friction": _effect(
        "friction x load", 0.1, -1, "loads knee",
        forms.friction_power, forms.friction_affine, forms.friction_log_square),
    "friction_temperature": _effect(
        "friction x temperature", 0.1, -1, "temperature knee",
        forms.friction_heat, forms.friction_heat_exponential,
        forms.friction_heat_bell),
    "stiffness_temperature": _effect(
        "stiffness x temperature", 0.15, -1, "temperature",
        forms.stiffness_heat, forms.stiffness_heat_exponential),
    "friction_drift": _effect(
        "friction x time", 0.1, 0, "knee",
        forms.friction_drift, forms.friction_wear_in, forms.friction_root_of_time),
    "stiffness_drift": _effect(
        "stiffness x time", 0.15, 0, "",
        forms.stiffness_drift, forms.stiffness_settling),
    "friction_step": _effect(
        "friction x time", 0.1, 0, "knee",
        forms.road_step, forms.road_blend, forms.road_stretch),
    "friction_hysteresis": _effect(
        "friction x direction", 0.04, 0, "sweeps knee",
        forms.hysteresis, forms.hysteresis_smooth, forms.hysteresis_polarised),
    "drive_brake_asymmetry": _effect(
        "friction x sign", 0.1, 0, "signs knee",
        forms.sign_friction, forms.sign_friction_smooth, forms.sign_both),
    "slip_offset": _effect(
        "measurement", 0.003, 0, "",
        forms.slip_zero, forms.slip_radius),
    "force_offset": _effect(
        "measurement", 0.02, 0, "",
        forms.force_zero, forms.force_tare),
    "slip_definition": _effect(
        "measurement", 1, 1, "knee longitudinal",
        forms.practical_slip, forms.inverse_slip, forms.mean_speed_slip),
    "channel_delay": _effect(
        "measurement", 0.02, 1, "sweeps",
        forms.delay, forms.delay_of_filter),
    "relaxation_length": _effect(
        "transient", 0.3, 1, "sweeps",
        forms.slip_lag, forms.force_lag, forms.shortening_lag),
    "wheel_inertia": _effect(
        "measurement", 11, 1, "sweeps longitudinal omega",
        forms.inertia, forms.inertia_filtered),
    "combined_slip": _effect(
        "inputs", 0.05, 1, "longitudinal alpha",
        forms.combined, forms.combined_stiff, forms.combined_ellipse),
    "camber_thrust": _effect(
        "lateral inputs", 0.6, 1, "lateral gamma",
        forms.camber_force, forms.camber_angle, forms.camber_half),
    "conicity": _effect(
        "lateral inputs", 0.02, 0, "loads lateral",
        forms.conicity, forms.conicity_square),
    "pressure_shift_load": _effect(
        "pressure x force", 0.3, 1, "loads knee",
        forms.shift_by_force, forms.shift_by_load),
    "carcass_flexibility": _effect(
        "structure", 0.01, 1, "knee",
        forms.carcass_bow, forms.carcass_slip),
}  # fmt: skip


def family_of(effect: str) -> str:
    """Family of an effect's id; noise ids are of the family "noise"."""
    return "noise" if effect in NOISE_EFFECTS else EFFECTS[effect].family
