"""Effects by id: typical amplitude, needs, and several forms of each.

The first form is the textbook one; the last is used only in sealed trials. A form takes
(world, amplitude, generator) and changes the world.
"""

from collections.abc import Callable
from typing import NamedTuple

from fits.withheld import forms, forms_rig

__all__ = ["EFFECTS", "Effect", "NOISE_EFFECTS", "family_of"]

NOISE_EFFECTS = ("outliers", "noise_heteroscedastic", "noise_autocorrelated", "slip_noise")


class Effect(NamedTuple):
    """``sign``: +1, -1 or 0 (either). ``needs``: properties of a design or columns."""

    family: str
    typical: float
    sign: int
    needs: frozenset
    forms: dict[str, Callable]


def _effect(family, typical, sign, needs, *choices):
    return Effect(
        family,
        typical,
        sign,
        frozenset(needs.split()),
        {choice.__name__: choice for choice in choices},
    )


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
    "slip_zero_drift": _effect(
        "slip x time", 0.006, 0, "",
        forms_rig.slip_zero_creeps, forms_rig.slip_zero_settles,
        forms_rig.slip_zero_turns),
    "force_zero_drift": _effect(
        "force x time", 0.03, 0, "",
        forms_rig.force_zero_creeps, forms_rig.force_zero_settles,
        forms_rig.force_zero_root),
    "load_crosstalk": _effect(
        "force x load", 0.02, 0, "loads longitudinal",
        forms_rig.load_leaks, forms_rig.load_leaks_evenly,
        forms_rig.load_leaks_more),
    "load_offset": _effect(
        "friction x load", 0.06, 0, "loads knee",
        forms_rig.load_zero, forms_rig.load_zero_bent,
        forms_rig.load_zero_and_gain),
    "force_crosstalk": _effect(
        "force x force", 0.03, 0, "across",
        forms_rig.across_leaks, forms_rig.across_leaks_bent),
    "force_hysteresis": _effect(
        "force x direction", 0.015, 0, "sweeps",
        forms_rig.dry_friction, forms_rig.dry_friction_smooth,
        forms_rig.dry_friction_grows),
    "slip_offset_load": _effect(
        "slip x load", 0.006, 0, "loads",
        forms_rig.slip_follows_load, forms_rig.radius_under_load,
        forms_rig.radius_root_of_load),
    "slip_offset_speed": _effect(
        "slip x speed", 0.004, 0, "speeds",
        forms_rig.slip_follows_speed, forms_rig.radius_by_spinning,
        forms_rig.radius_saturating),
    "speed_zero": _effect(
        "slip x speed", 0.04, 0, "speeds",
        forms_rig.speed_is_off, forms_rig.speed_is_off_of_wheel,
        forms_rig.speed_is_off_when_slow),
    "speed_drag": _effect(
        "force x speed", 0.02, 1, "speeds longitudinal",
        forms_rig.drag_of_bearings, forms_rig.drag_of_air, forms_rig.drag_of_both),
    "friction_ellipse": _effect(
        "friction x force", 1.0, 1, "across knee",
        forms_rig.friction_ellipse, forms_rig.friction_ellipse_of_force,
        forms_rig.friction_superellipse),
    "friction_pressure": _effect(
        "friction x inflation", 0.1, 0, "pressure knee",
        forms_rig.friction_inflated, forms_rig.friction_inflated_power,
        forms_rig.friction_inflated_bell),
    "stiffness_pressure": _effect(
        "stiffness x inflation", 0.15, 0, "pressure",
        forms_rig.stiffness_inflated, forms_rig.stiffness_inflated_power,
        forms_rig.stiffness_inflated_saturating),
    "friction_warming": _effect(
        "friction x work", 0.12, 0, "sweeps knee",
        forms_rig.friction_worked, forms_rig.friction_worked_cooling,
        forms_rig.friction_worked_exponential),
    "stiffness_warming": _effect(
        "stiffness x work", 0.2, 0, "sweeps",
        forms_rig.stiffness_worked, forms_rig.stiffness_worked_cooling,
        forms_rig.stiffness_worked_exponential),
    "stiffness_speed": _effect(
        "stiffness x speed", 0.12, 0, "speeds",
        forms_rig.stiffness_rolled, forms_rig.stiffness_rolled_evenly,
        forms_rig.stiffness_rolled_logarithm),
}  # fmt: skip


def family_of(effect: str) -> str:
    """Family of an effect's id; "noise" for ids of noise."""
    return "noise" if effect in NOISE_EFFECTS else EFFECTS[effect].family
