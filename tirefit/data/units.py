"""Convert units and signs of a file to canonical SI values, and back.

Units are exact factors in a table. A leading minus (``-N``) declares a column whose sign is
opposite to the convention of the file.
"""

from typing import NamedTuple

import numpy as np

from tirefit.data.table import WHEELS
from tirefit.results import DataError, did_you_mean
from tirefit.slip import CONVENTIONS, GRAVITY, LOCKED, SLIP_DEFINITIONS, kappa_from_sigma

MEANING_OF_SLIP = {
    "sigma_x": "v_sx / (Omega R_e)",
    "kappa": "v_sx / v_x",
    "s": "v_sx / |v|",
    "slip_ratio": "v_sx / max(v_x, Omega R_e)",
}
"""Name of a slip column -> its formula in the symbols of S Table 1."""

SPINNING = -1 + 1e-6
"""Physical slip used for a wheel that spins on the spot (sigma = -1)."""


class Unit(NamedTuple):
    """SI value = scale * value + offset; ``dimension`` is a plain word."""

    dimension: str
    scale: float
    offset: float = 0.0

    def to_si(self, values, is_std=False):
        """Convert file values to SI; a standard deviation has no sign and no offset."""
        return abs(self.scale) * values if is_std else self.scale * values + self.offset

    def from_si(self, values, is_std=False):
        """Inverse of :meth:`to_si`."""
        if is_std:
            return values / abs(self.scale)
        return (values - self.offset) / self.scale


_DIMENSION = {
    "time": "time", "alpha": "angle", "gamma": "angle", "omega": "angular speed",
    "fx": "force", "fy": "force", "fz": "force", "mz": "moment", "v": "speed",
    "mx": "moment", "my": "moment",
    "pressure": "pressure", "brake_pressure": "pressure", "temperature": "temperature",
    "torque": "moment",
    "alpha_rate": "angular speed", "steering_rate": "angular speed",
    "a_x": "acceleration", "a_y": "acceleration",
    "yaw_rate": "angular speed", "yaw_acceleration": "angular acceleration",
    "heading": "angle", "x": "length", "y": "length", "steering": "angle",
    "roll_rate": "angular speed", "offset": "length", "road_heading": "angle",
    **{f"omega_{wheel}": "angular speed" for wheel in WHEELS},
    **{f"torque_{wheel}": "moment" for wheel in WHEELS},
    **dict.fromkeys(SLIP_DEFINITIONS, "ratio"),
}  # fmt: skip

_TURN = 2 * np.pi

_FACTORS = {
    "time": {"s": 1, "sec": 1, "second": 1, "seconds": 1, "ms": 1e-3, "us": 1e-6,
             "ns": 1e-9,
             "min": 60, "h": 3600},
    "ratio": {"-": 1, "": 1, "1": 1, "none": 1, "dimensionless": 1, "ratio": 1,
              "%": 0.01, "pct": 0.01, "percent": 0.01},
    "angle": {"rad": 1, "mrad": 1e-3, "deg": np.pi / 180, "degree": np.pi / 180,
              "degrees": np.pi / 180},
    "angular speed": {"rad/s": 1, "radps": 1, "rads": 1, "1/s": 1, "deg/s": np.pi / 180,
                      "degps": np.pi / 180, "rpm": _TURN / 60, "1/min": _TURN / 60,
                      "rev/min": _TURN / 60, "rev/s": _TURN, "Hz": _TURN},
    "force": {"N": 1, "kN": 1e3, "daN": 10, "kgf": GRAVITY,
              "kip": 4448.2216152605,
              **dict.fromkeys(("lbf", "lb", "lbs"), 4.4482216152605)},
    "moment": {"Nm": 1, "N-m": 1, "kNm": 1e3, "Nmm": 1e-3,
               **dict.fromkeys(("lbfft", "ftlbf", "ft-lb", "ft-lbs", "ft-lbf", "lb-ft"),
                               1.3558179483314004), "in-lb": 0.11298482902761668},
    "speed": {"m/s": 1, "mps": 1, "km/h": 1 / 3.6, "kmh": 1 / 3.6, "kph": 1 / 3.6,
              "mph": 0.44704, "mm/s": 1e-3, "mmps": 1e-3, "cm/s": 1e-2, "ft/s": 0.3048,
              "knot": 1852 / 3600},
    "pressure": {"Pa": 1, "hPa": 100, "kPa": 1e3, "MPa": 1e6, "bar": 1e5, "mbar": 100,
                 "psi": 6894.757293168361},
    "acceleration": {"m/s2": 1, "m/s^2": 1, "m/s²": 1, "g": GRAVITY, "mm/s2": 1e-3,
                     "ft/s2": 0.3048},
    "angular acceleration": {"rad/s2": 1, "rad/s^2": 1, "rad/s²": 1,
                             "deg/s2": np.pi / 180, "deg/s^2": np.pi / 180},
    "length": {"m": 1, "cm": 1e-2, "mm": 1e-3, "ft": 0.3048},
}  # fmt: skip

_KNOWN = {
    name: Unit(dimension, float(factor))
    for dimension, factors in _FACTORS.items()
    for name, factor in factors.items()
} | {
    **dict.fromkeys(("degC", "C", "celsius"), Unit("temperature", 1.0)),
    **dict.fromkeys(("K", "kelvin"), Unit("temperature", 1.0, -273.15)),
    **dict.fromkeys(("degF", "F", "fahrenheit"), Unit("temperature", 5 / 9, -160 / 9)),
}
# MPa is left out: reading mPa as MPa would be wrong by a factor of 1e9.
_ANY_CASE = {name.casefold(): unit for name, unit in _KNOWN.items() if name != "MPa"}

_SPELLING = str.maketrans({"°": "deg", "·": "", "⋅": "", "*": "", " ": "", "_": "", "\xa0": ""})


def base_column(column: str) -> str:
    """The column of ``<column>_std`` or ``<column>_sim``; else the name itself."""
    return column.removesuffix("_std").removesuffix("_sim")


def dimension_of(column: str) -> str:
    """The dimension (a plain word) of a canonical or slip column, std or not."""
    return _DIMENSION[base_column(column)]


def known_unit(text: str) -> Unit | None:
    """The unit if it is in the table of common units, else None."""
    spelled = text.strip().strip("[](){}").translate(_SPELLING)
    return _KNOWN.get(spelled) or _ANY_CASE.get(spelled.casefold())


def resolve_unit(text: str, column: str) -> Unit:
    """The unit of a column, its dimension checked.

    Args:
        text: the unit as written, e.g. ``kN``; a leading minus flips the sign.
        column: canonical name, a slip definition, or either with ``_std``.

    Raises:
        DataError: the unit is unknown or has another dimension than the column.
    """
    text = text.strip()
    if text.startswith("-") and len(text) > 1:
        opposite = resolve_unit(text[1:], column)
        return opposite._replace(scale=-opposite.scale)
    wanted = dimension_of(column)
    unit = known_unit(text)
    if unit is None:
        raise DataError(f"unknown unit {text!r}", _unit_remedy(text, column, wanted))
    if unit.dimension != wanted:
        raise DataError(
            f"unit {text!r} is a unit of {unit.dimension}, but {column} is of dimension {wanted}",
            _unit_remedy(text, column, wanted),
        )
    return unit


def units_of(dimension: str) -> list[str]:
    """Common units of a dimension as text, SI first."""
    return [name for name, unit in _KNOWN.items() if name and unit[0] == dimension]


def _unit_remedy(text: str, column: str, dimension: str) -> str:
    units = units_of(dimension)
    listed = ", ".join(map(repr, units))
    meant = did_you_mean(text, units)
    return f"{meant}give a unit of {dimension} with --unit {column}=...: {listed}"


def sign_of(convention: str, column: str) -> int:
    """Sign that converts a value of the file to the canonical one; 1 for a std."""
    if column.endswith("_std"):
        return 1
    field = "slip" if column in SLIP_DEFINITIONS else base_column(column)
    return getattr(CONVENTIONS[convention], field, 1)


def slip_to_sigma(slip, definition, alpha=None):
    """Slip of any definition, in canonical signs, to physical slip sigma_x.

    Args:
        slip: (n,) array; NaN stays NaN.
        definition: a key of ``SLIP_DEFINITIONS``.
        alpha: (n,) slip angle [rad]; with it ``s`` becomes kappa = s / cos(alpha).

    Returns:
        (n,) sigma_x, limited to ``SPINNING`` (driving) and ``LOCKED`` (braking).
    """
    if definition == "s" and alpha is not None:
        slip = slip / np.cos(alpha)
    with np.errstate(divide="ignore", invalid="ignore"):
        sigma = SLIP_DEFINITIONS[definition][0](slip)
    if definition != "sigma_x":
        sigma = np.where(slip >= kappa_from_sigma(LOCKED), LOCKED, sigma)
    return np.clip(sigma, SPINNING, LOCKED)


def slip_from_speeds(omega, v, rolling_radius):
    """Physical slip (v - omega R) / (omega R), limited to SPINNING and LOCKED.

    Args:
        omega: (n,) wheel speed [rad/s], >= 0.
        v: (n,) forward speed [m/s], >= 0.
        rolling_radius: effective rolling radius R [m].

    Returns:
        (n,) sigma_x, NaN at standstill.
    """
    speed = omega * rolling_radius
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        sigma = (v - speed) / speed
    return np.clip(sigma, SPINNING, LOCKED)


def slip_from_sigma(sigma, definition, alpha=None):
    """Inverse of :func:`slip_to_sigma` within its limits."""
    slip = SLIP_DEFINITIONS[definition][1](sigma)
    if definition != "sigma_x":
        slip = np.where(sigma >= LOCKED, 1.0, slip)
    if definition == "s" and alpha is not None:
        slip = slip * np.cos(alpha)
    return slip


def sigma_derivative(sigma, definition, alpha=None):
    """d sigma_x / d slip at ``sigma`` (n,), to convert a standard deviation."""
    kappa_like = (1 + sigma) ** 2
    if definition == "sigma_x":
        return np.ones_like(sigma)
    if definition == "slip_ratio":
        return np.where(sigma > 0, kappa_like, 1.0)
    if definition == "s" and alpha is not None:
        return kappa_like / np.cos(alpha)
    return kappa_like
