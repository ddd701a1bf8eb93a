"""Tire property files (``.tir``): :func:`read_tir`, :func:`new_tir`.

The text of a file is kept: sections, order, comments and unknown keys are not changed;
only changed values are rewritten. Numbers are converted to SI on reading and back to
the units of the file on writing.
"""

import math
import re
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from tirefit.data.text import decoded
from tirefit.data.tir_check import notes_on, problems_of
from tirefit.data.tir_file import TirFile, parsed, shortest
from tirefit.data.tir_keys import COEFFICIENTS, LIMITS, ONLY_IN
from tirefit.data.tire_file import other_tire
from tirefit.door import TIRE, content_of, control_character
from tirefit.results import DataError, InputProblem, UsageError

__all__ = ["TirFile", "brush_of", "notes_on", "parse_tir", "read_tir", "reduced_tir"]


def parse_tir(text: str, path: str = "", notes: Sequence[str] = ()) -> TirFile:
    """Parse and check the text of a ``.tir`` file; ``notes`` precede its own.

    Raises:
        DataError: text that cannot be understood, missing or contradicting keys, content
            that is not supported; it lists all problems, each with key and remedy.
    """
    DataError.raise_for(other_tire(text, path))
    tir, problems = parsed(text, path, notes)
    problems += problems_of(tir)
    DataError.raise_for(problems)
    return tir


def read_tir(path) -> TirFile:
    """Read a ``.tir`` file.

    Raises:
        DataError: as :func:`parse_tir`; or the file does not exist or is not text.
    """
    content = content_of(path, TIRE, DataError, "give a .tir file")
    if len(content) > 1 and 0 in content[:2]:  # UTF-16 without byte order mark
        low_first = content[1] == 0
        content = (BOM_UTF16_LE if low_first else BOM_UTF16_BE) + content
    text, notes = decoded(content, Path(path))
    # Windows-1252 has letters at the control characters of Latin-1.
    text = re.sub(
        "[\x80-\x9f]", lambda found: found[0].encode("latin-1").decode("cp1252", "replace"), text
    )
    odd = control_character(text)
    if odd is not None:
        row, name = odd
        reason = f"not a text file: it holds the control character {name}"
        raise DataError(reason, "remove it", str(path), row)
    return parse_tir(text, str(path), notes)


_UNITS = """\
[UNITS]
LENGTH                   = 'meter'
FORCE                    = 'newton'
ANGLE                    = 'radians'
MASS                     = 'kg'
TIME                     = 'second'
"""

_CURVATURE = -0.44  # E that follows the brush best where C = 1, see :func:`reduced_tir`

_REDUCED = (
    "Reduced: an isotropic brush tire of constant friction as a Magic Formula. At FNOMIN",
    "both pure slips have the slope 2 c_p a^2 at rest and tend to mu F_z without a peak",
    "before (C = 1); E follows the curve of the brush, which no Magic Formula has. The",
    "lateral stiffness is that of the brush at every load, the longitudinal one stationary",
    "at FNOMIN. Combined slip keeps to the friction circle there. No aligning moment.",
    "c_p a^2 = PKX1 FNOMIN / 2 and mu = PDX1, exactly: tirefit reads them back.",
)


def reduced_tir(cpa2: float, mu: float, fz: float, radius: float) -> TirFile:
    r"""The smallest ``.tir`` file of a brush tire, from c_p a^2 and mu.

    PKX1 FNOMIN = 2 c_p a^2 and PDX1 = mu, and the same for F_y. The force of a brush of
    constant friction rises to mu F_z and stays there, as with C = 1; a larger C has a
    peak and falls beyond it. E = -0.44 minimises the largest difference between
    :math:`\sin\arctan\{x - E (x - \arctan x)\}` and the brush curve
    :math:`x - x^2/3 + x^3/27`, x = 2 c_p a^2 sigma / (mu F_z): it is 4.6 % of mu F_z.

    In combined slip, the weighting functions of C = 1 and B = 2 c_p a^2 / (mu F_z) turn
    :math:`x / \sqrt{1 + x^2}` (E = 0) exactly into
    :math:`x_i / \sqrt{1 + x^2 + y^2}`, the force of the isotropic tire.

    Args:
        cpa2: bristle stiffness c_p a^2 [N].
        mu: friction coefficient [-].
        fz: nominal load [N], at which both hold.
        radius: radius of the free tire [m].

    Raises:
        UsageError: values that are not positive; it lists all of them.
    """
    given = {"cpa2": cpa2, "mu": mu, "fz": fz, "radius": radius}
    UsageError.raise_for(
        [
            InputProblem(f"{name} = {value:g} is not positive", "give it in SI")
            for name, value in given.items()
            if not 0 < value < math.inf
        ]
    )
    slope, weight = 2 * cpa2 / fz, 2 * cpa2 / (mu * fz)
    values = {"UNLOADED_RADIUS": radius, "FNOMIN": fz, "QBZ1": 0.0, "QCZ1": 1.0, "QDZ1": 0.0}
    values |= {"PKX3": -1.0, "PKY2": 1e-8, "PKY4": 1.0}
    notes = {"FNOMIN": "Nominal wheel load", "UNLOADED_RADIUS": "Free tyre radius"}
    notes |= dict.fromkeys(("PKY2", "PKY4"), "Stiffness the same at every load")
    notes |= {"PKX3": "Stiffness stationary at FNOMIN", "QBZ1": "No aligning moment"}
    for axis, sign in (("X", 1), ("Y", -1)):  # in ISO-W axes the cornering stiffness is negative
        for start, value, note in (
            ("PC", 1.0, "Shape: no peak"),
            ("PD", mu, "mu"),
            ("PE", _CURVATURE, "Curvature of the brush"),
            ("PK", sign * slope, f"{2 * sign} c_p a^2 / FNOMIN"),
            ("RB", weight, "2 c_p a^2 / (mu FNOMIN)"),
            ("RC", 1.0, "Friction circle"),
        ):
            values[f"{start}{axis}1"], notes[f"{start}{axis}1"] = value, note
        values[f"RB{axis}2"] = weight
    tir = new_tir("6.1", values, {}, notes, _REDUCED, number=_exact)
    return replace(tir.with_values({"TYRESIDE": "SYMMETRIC"}), path="reduced.tir")


def _exact(number: float) -> str:
    """The shortest text that is read as exactly this number."""
    text = shortest(number)
    return text if float(text) == number else repr(float(number))


def brush_of(tir: TirFile) -> dict[str, float] | None:
    """``cpa2`` [N] and ``mu`` of a file that :func:`reduced_tir` wrote, else None.

    Every coefficient must be that of the brush; with a changed one, the file is an
    ordinary Magic Formula.
    """
    numbers = tir.numbers
    try:
        nominal, radius = numbers["FNOMIN"], numbers["UNLOADED_RADIUS"]
        cpa2, mu = numbers["PKX1"] * nominal / 2, numbers["PDX1"]
        ours = reduced_tir(cpa2, mu, nominal, radius).numbers
    except (KeyError, UsageError):
        return None
    if ours.keys() != numbers.keys():
        return None
    alike = (math.isclose(numbers[k], ours[k], rel_tol=1e-12) for k in ours)
    return {"cpa2": cpa2, "mu": mu} if all(alike) else None


_FITTYP = {"5.2": 6, "6.1": 61, "6.2": 62}
_RANGES = {
    "kappa": "LONG_SLIP_RANGE",
    "alpha": "SLIP_ANGLE_RANGE",
    "gamma": "INCLINATION_ANGLE_RANGE",
    "fz": "VERTICAL_FORCE_RANGE",
    "pressure": "INFLATION_PRESSURE_RANGE",
}
_HEAD = """\
[MDI_HEADER]
FILE_TYPE                = 'tir'
FILE_VERSION             = 3.0
FILE_FORMAT              = 'ASCII'
{comment}{units}[MODEL]
PROPERTY_FILE_FORMAT     = 'MF{format}'
FITTYP                   = {fittyp}
TYRESIDE                 = 'UNKNOWN'
"""


def new_tir(
    version: str,
    values: Mapping[str, float],
    ranges: Mapping[str, tuple[float, float]],
    notes: Mapping[str, str],
    comment: Sequence[str] = (),
    number: Callable[[float], str] = shortest,
) -> TirFile:
    """A file of this version with these coefficients, in SI units.

    Args:
        version: 5.2, 6.1 or 6.2; keys of other versions are left out.
        values: SI values by key, including all that a tire needs.
        ranges: (least, largest) value by input of :data:`tir_keys.LIMITS`, in ISO-W.
        notes: comment behind the value of a key.
        comment: lines above the first section of values.
        number: the text of a value.

    Raises:
        DataError: values that do not describe a tire.
    """
    above = "".join(f"$ {line}\n" for line in comment)
    kind = "-Tyre" if version == "5.2" else version.replace(".", "")
    text = _HEAD.format(units=_UNITS, comment=above, fittyp=_FITTYP[version], format=kind)
    lines = text.splitlines()
    section = "MODEL"
    of_version = [k for k in COEFFICIENTS if ONLY_IN.get(k, version[0]) == version[0]]
    # The head has begun the section [MODEL].
    for key in sorted(of_version, key=lambda key: COEFFICIENTS[key] != "MODEL"):
        if key not in values:
            continue
        if COEFFICIENTS[key] != section:
            section = COEFFICIENTS[key]
            lines.append(f"[{section}]")
        message = f"          ${notes[key]}" if key in notes else ""
        lines.append(f"{key:<24} = {number(float(values[key]))}{message}")
    for name, (low, high) in ranges.items():
        lines.append(f"[{_RANGES[name]}]")
        for key, value in zip(LIMITS[name], (low, high), strict=True):
            lines.append(f"{key:<24} = {shortest(value)}")
    return parse_tir("\n".join(lines) + "\n", "fit.tir")
