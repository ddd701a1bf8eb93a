"""Convert units and signs of a file to canonical SI values, and back.

Units are exact factors in a table. A leading minus (``-N``) declares a column whose sign is
opposite to the convention of the file.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tirefit.data.table import CANONICAL
from tirefit.results import DataError, did_you_mean
from tirefit.slip import CONVENTIONS, GRAVITY, LOCKED, SLIP_DEFINITIONS, kappa_from_sigma

if TYPE_CHECKING:  # it imports JAX
    from tirefit.arrays import Kept

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

    def to_si(self, values: "Kept", is_std: bool = False) -> "Kept":
        """Convert file values to SI; a standard deviation has no sign and no offset."""
        return abs(self.scale) * values if is_std else self.scale * values + self.offset

    def from_si(self, values: "Kept", is_std: bool = False) -> "Kept":
        """Inverse of :meth:`to_si`."""
        if is_std:
            return values / abs(self.scale)
        return (values - self.offset) / self.scale


_TURN = 2 * np.pi

_DEG, _FOOT, _INCH = np.pi / 180, 0.3048, 0.0254
_LBF = 4.4482216152605  # pound-force [N]

_USUAL = {
    "time": {1: "s sec second seconds", 1e-3: "ms msec millisecond milliseconds",
             1e-6: "us microsecond", 1e-9: "ns nanosecond", 60: "min minute minutes",
             3600: "h hr hour hours"},
    "ratio": {1: "- 1 none dimensionless ratio", 0.01: "% pct percent"},
    "angle": {1: "rad radian radians", 1e-3: "mrad", _DEG: "deg degree degrees"},
    "angular speed": {
        1: "rad/s radps rads 1/s rad/sec radian/second",
        _DEG: "deg/s degps deg/sec degree/second degrees/second",
        _TURN / 60: "rpm 1/min rev/min revolutionsperminute", _TURN: "rev/s Hz"},
    "force": {1: "N newton newtons", 1e3: "kN kilonewton knewton", 10: "daN dekanewton",
              GRAVITY: "kgf kgforce kilogramforce", _LBF: "lbf lb lbs poundforce"},
    "moment": {1: "Nm N-m newtonmeter", 1e3: "kNm", 1e-3: "Nmm", _LBF * _INCH: "in-lb inlbf lbfin",
               _LBF * _FOOT: "lbfft ftlbf ft-lb ft-lbs ft-lbf lb-ft"},
    "speed": {1: "m/s mps meter/second", 1 / 3.6: "km/h kmh kph kilometer/hour",
              0.44704: "mph mile/hour", 1e-3: "mm/s mmps", 1e-2: "cm/s",
              _FOOT: "ft/s foot/second", 1852 / 3600: "knot knots kt"},
    "pressure": {1: "Pa pascal", 100: "hPa mbar millibar", 1e3: "kPa kilopascal", 1e6: "MPa N/mm2",
                 1e5: "bar", _LBF / _INCH**2: "psi"},
    "acceleration": {1: "m/s2 m/s^2 m/s² meter/second2", GRAVITY: "g g0 gravity",
                     1e-3: "mm/s2 mm/s^2", _FOOT: "ft/s2 ft/s^2"},
    "angular acceleration": {1: "rad/s2 rad/s^2 rad/s²", _DEG: "deg/s2 deg/s^2 degree/second2"},
    "length": {1: "m meter meters metre", 1e-2: "cm centimeter", 1e-3: "mm millimeter",
               _FOOT: "ft foot feet"},
}  # fmt: skip
"""Dimension -> size in SI -> the names, without blanks, points and underscores."""

_RARE = {
    "angle": {_DEG / 60: "arcmin arcminute", _DEG / 3600: "arcsec", _TURN: "turn"},
    "angular speed": {_DEG / 60: "deg/min"},
    "force": {1e6: "MN", 1e-3: "mN", GRAVITY / 1e3: "gf", 1e3 * GRAVITY: "metrictonforce",
              _LBF / 16: "ozf", 1e3 * _LBF: "kip", 1e-5: "dyn dyne"},
    "moment": {10: "daNm", 0.01: "Ncm", GRAVITY: "kgfm"},
    "speed": {1e3: "km/s", 1 / 60: "m/min", _INCH: "in/s"},
    "pressure": {101_325: "atm", 3386.38864: "inHg", 133.32238741: "mmHg", 101_325 / 760: "torr",
                 1e4 * GRAVITY: "kgf/cm2"},
    "acceleration": {1e-2: "cm/s2 cm/s^2 Gal"},
    "length": {1e3: "km kilometer", _INCH: "inch inches", 3 * _FOOT: "yd yard",
               1609.344: "mi mile"},
}  # fmt: skip
"""Units that are read, but not proposed as the one that a column may be in."""

_KNOWN = {
    name: Unit(dimension, float(factor))
    for table in (_USUAL, _RARE)
    for dimension, sizes in table.items()
    for factor, names in sizes.items()
    for name in names.split()
} | {
    "": Unit("ratio", 1.0),
    **dict.fromkeys(("degC", "C", "celsius"), Unit("temperature", 1.0)),
    **dict.fromkeys(("K", "kelvin"), Unit("temperature", 1.0, -273.15)),
    **dict.fromkeys(("degF", "F", "fahrenheit"), Unit("temperature", 5 / 9, -160 / 9)),
}
# Milli and mega differ by their case alone: mPa read as MPa would be wrong by a factor of 1e9.
_MEGA = ("MPa", "MN", "mN")
_ANY_CASE = {name.casefold(): unit for name, unit in _KNOWN.items() if name not in _MEGA}

_SPELLING = str.maketrans({"°": "deg", "·": "", "⋅": "", "*": "", " ": "", "_": "", "\xa0": ""})


def base_column(column: str) -> str:
    """The column of ``<column>_std`` or ``<column>_sim``; else the name itself."""
    return column.removesuffix("_std").removesuffix("_sim")


def dimension_of(column: str) -> str:
    """The dimension (a plain word) of a canonical or slip column, std or not."""
    unit, _ = CANONICAL.get(base_column(column), CANONICAL["sigma_x"])
    return _KNOWN[unit.replace(" ", "")].dimension


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
    wanted, unit = dimension_of(column), known_unit(text)
    if unit and unit.dimension == wanted:
        return unit
    reason = f"unknown unit {text!r}"
    if unit:
        reason = f"unit {text!r} is a unit of {unit.dimension}, but {column} is of dimension"
        reason += f" {wanted}"
    units = units_of(wanted)
    how = f"give a unit of {wanted} with --unit {column}=...: {', '.join(map(repr, units))}"
    raise DataError(reason, did_you_mean(text, units) + how)


def units_of(dimension: str) -> list[str]:
    """A name of each usual unit of a dimension, SI first."""
    if dimension == "temperature":
        return ["degC", "K", "degF"]
    return [names.split()[0] for names in _USUAL[dimension].values()]


def names_of(dimension: str) -> list[str]:
    """Every name of the usual units of a dimension."""
    return [name for names in _USUAL[dimension].values() for name in names.split()]


def sign_of(convention: str, column: str) -> int:
    """Sign that converts a value of the file to the canonical one; 1 for a std."""
    if column.endswith("_std"):
        return 1
    field = "slip" if column in SLIP_DEFINITIONS else base_column(column)
    return getattr(CONVENTIONS[convention], field, 1)


def slip_to_sigma(slip: np.ndarray, definition: str, alpha: np.ndarray | None = None) -> np.ndarray:
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


def slip_from_speeds(omega: np.ndarray, v: np.ndarray, rolling_radius: float) -> np.ndarray:
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


def slip_from_sigma(
    sigma: np.ndarray, definition: str, alpha: np.ndarray | None = None
) -> np.ndarray:
    """Inverse of :func:`slip_to_sigma` within its limits."""
    slip = SLIP_DEFINITIONS[definition][1](sigma)
    if definition != "sigma_x":
        slip = np.where(sigma >= LOCKED, 1.0, slip)
    if definition == "s" and alpha is not None:
        slip = slip * np.cos(alpha)
    return slip


def sigma_derivative(
    sigma: np.ndarray, definition: str, alpha: np.ndarray | None = None
) -> np.ndarray:
    """d sigma_x / d slip at ``sigma`` (n,), to convert a standard deviation."""
    if definition == "sigma_x":
        return np.ones_like(sigma)
    if definition == "slip_ratio":
        return np.where(sigma > 0, (1 + sigma) ** 2, 1.0)
    return (1 + sigma) ** 2 / (np.cos(alpha) if definition == "s" and alpha is not None else 1.0)
