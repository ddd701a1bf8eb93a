"""Names of models and effects as text, so that completion need not import JAX."""

_PRESSURE = ("brush", "brush-d", "uniform", "quartic", "elliptic")
_SPEED = ("", "n", "ns", "h", "hs")


def _spelled() -> list[str]:
    names = []
    for family in _PRESSURE:
        for letters in (level + speed for level in ("", "m") for speed in _SPEED):
            dash = "-" if letters and "-" not in family else ""
            names.append(f"{family}{dash}{letters}")
    return names


MODEL_NAMES = (
    *_spelled(),
    "brush-anisotropic",
    "brush-anisotropic-m",
    "brush-anisotropic-d",
    "brush-anisotropic-dm",
    "brush-m-peak",
    "brush-stribeck",
    "brush-stribeck-s",
    "brush-d-force",
    "brush-d-load",
    "brush-load",
    "brush-load-d",
    "brush-load-m",
    "brush-load-n",
    "brush-load-h",
    "brush-relaxation",
    "carcass-beam",
    "carcass-parabola",
    "carcass-thread",
    "liu-peng",
    "lugre",
    "lugre-lumped",
    "magic-formula",
    "magic-formula-combined",
    "magic-formula-relaxation",
)
"""Every key of ``tirefit.MODELS``."""

EFFECT_NAMES = (
    "pressure_asymmetry",
    "pressure_flatness",
    "kinetic_friction",
    "pressure_shift_load",
    "carcass_flexibility",
    "friction_speed_linear",
    "friction_speed_exponential",
    "load_stiffness",
    "load_friction",
    "friction_temperature",
    "stiffness_temperature",
    "friction_drift",
    "stiffness_drift",
    "friction_step",
    "friction_hysteresis",
    "drive_brake_asymmetry",
    "combined_slip",
    "slip_offset",
    "force_offset",
    "slip_definition",
    "wheel_inertia",
    "camber_thrust",
    "conicity",
    "channel_delay",
    "relaxation_length",
    "steering_delay",
    "steering_lag",
    "slip_zero_drift",
    "force_zero_drift",
    "load_crosstalk",
    "load_offset",
    "force_crosstalk",
    "force_hysteresis",
    "slip_offset_load",
    "slip_offset_speed",
    "speed_zero",
    "speed_drag",
    "friction_ellipse",
    "tracked_point",
    "load_transfer",
    "friction_pressure",
    "stiffness_pressure",
    "friction_warming",
    "stiffness_warming",
    "stiffness_speed",
    "yaw_inertia",
    "floor_slope",
    "toe",
    "lateral_load_transfer",
    "unlike_tires",
    "steering_gain",
    "slip_offset_run",
    "force_offset_run",
    "friction_run",
    "stiffness_run",
)
"""The id of every effect of ``tirefit diagnose``."""
