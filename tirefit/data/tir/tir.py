"""Tire property files (``.tir``): :func:`read_tir`, :func:`new_tir`, and checks of their values.

The text of a file is kept: sections, order, comments and unknown keys are not changed;
only changed values are rewritten. Numbers are converted to SI on reading and back to
the units of the file on writing.
"""

import re
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from tirefit.data.readers.text import decoded
from tirefit.data.tir.tir_file import Entry, TirFile, parsed, shortest
from tirefit.data.tir.tir_keys import (
    COEFFICIENTS,
    FITTYP,
    LIMITS,
    ONLY_IN,
    POSITIVE,
    PRESSURE_TERMS,
    REQUIRED,
    SIDES,
    UNITS,
)
from tirefit.data.tir.tire_file import other_tire
from tirefit.data.units import names_of
from tirefit.door import TIRE, content_of, control_character
from tirefit.results import DataError, InputProblem

__all__ = ["TirFile", "notes_on", "parse_tir", "read_tir", "reduced_tir"]

PRESSURES = (1e4, 5e6)
"""Range of inflation pressures [Pa], from a kart to an aircraft."""

_NAMED = 6  # largest number of keys or values that a sentence lists; it counts the others


def notes_on(tir: TirFile) -> list[str]:
    """Sentences on assumptions, and on content that is not used."""
    messages = list(tir.notes)
    if tir.numbers.get("FITTYP") not in FITTYP:
        messages.append(f"taken as Magic Formula {tir.version}: {tir.stated.because}")
    messages += [f"no {force} in this file: {why}" for force, why in tir.lacks.items()]
    if empty := [e.key for e in tir.wanted() if not e.text]:
        messages.append(f"keys without a value are ignored: {_listed(empty)}")
    if tir.foreign:
        messages.append(
            f"MF {tir.version} has no {_listed(tir.foreign)}: ignored, which changes"
            " the tire against programs that use them"
        )
    entry = tir.find("FE_METHOD")
    if entry and entry.text.upper() == "YES" and not tir.ellipse:
        messages.append(f"FE_METHOD = 'YES' is not used: MF {tir.version} has no friction ellipse")
    if tir.is_infofile:
        messages.append("read as an infofile of CarMaker, in SI units")
    elif not any(entry.section == "UNITS" for entry in tir.entries):
        messages.append("there is no [UNITS] section: SI units assumed")
    if tir.numbers.get("PKY1", 0) > 0 and tir.numbers.get("PDY1", 0) > 0:
        messages.append(
            "PKY1 > 0 gives F_y > 0 for alpha > 0: these are not the ISO-W axes of a"
            " .tir file (--signs adapted-sae reads such a file)"
        )
    return messages


def _problem(
    tir: TirFile, key: str, reason: str, remedy: str, section: str | None = None
) -> InputProblem:
    entry = tir.find(key, section)
    return InputProblem(reason, remedy, tir.path, entry.row if entry else None)


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more


def _of_units(tir: TirFile) -> Iterator[InputProblem]:
    for quantity, dimension in UNITS.items():
        entry = tir.find(quantity, "UNITS")
        if entry is None or entry.size_of(dimension):
            continue
        reason = f"{quantity} = {entry.value} in [UNITS] is not supported"
        remedy = f"write the file with one of {', '.join(names_of(dimension))}"
        yield _problem(tir, quantity, reason, remedy, "UNITS")


def _of_model(tir: TirFile) -> Iterator[InputProblem]:
    if tir.stated.name is None and {"FNOMIN", *COEFFICIENTS} & set(tir.numbers):
        known = ", ".join(f"{number} (MF {name})" for number, name in FITTYP.items())
        remedy = f"write FITTYP to [MODEL]: {known}"
        yield _problem(tir, "FITTYP", tir.stated.because, remedy)
    entry = tir.find("TYRESIDE")
    if entry and tir.side not in SIDES:
        reason = f"TYRESIDE = {entry.value} is not a side"
        yield _problem(tir, "TYRESIDE", reason, f"one of {', '.join(SIDES)}")
    if tir.numbers.get("USE_MODE", 0) < 0:
        reason = f"USE_MODE = {tir.numbers['USE_MODE']:g} mirrors the tire"
        remedy = "that is not supported: drop the minus and choose the side with --side"
        yield _problem(tir, "USE_MODE", reason, remedy)


def _of_keys(tir: TirFile) -> Iterator[InputProblem]:
    """Keys with two values, which a coefficient must not have even in two sections; and one
    problem for all values that are not numbers."""
    seen: dict[tuple[str | None, str], Entry] = {}
    for entry in tir.entries:
        anywhere = entry.key in COEFFICIENTS and entry.section != "UNITS"
        first = seen.setdefault((None if anywhere else entry.section, entry.key), entry)
        if (tir.number(first) or first.text) != (tir.number(entry) or entry.text):
            reason = (
                f"{entry.key} = {entry.value} contradicts {entry.key} = {first.value}"
                f" in row {first.row}"
            )
            yield InputProblem(reason, "remove one of them", tir.path, entry.row)
    bad = [e for e in tir.wanted() if e.text and tir.number(e) is None]
    if bad:
        message = f"{bad[0].key} = {bad[0].value} is not a number"
        if len(bad) > 1:
            some = [f"{entry.key} = {entry.value}" for entry in bad]
            message = f"{len(bad)} values are not numbers: {_listed(some)}"
        remedy = "give numbers such as 1.5 or -2e-3; removing a line changes the tire"
        yield InputProblem(message, remedy, tir.path, bad[0].row)


def _missing(tir: TirFile) -> Iterator[InputProblem]:
    there = tir.numbers
    if not {"FNOMIN", *COEFFICIENTS} & set(there):
        reason = "this is no .tir file: it has no coefficient of a Magic Formula"
        yield InputProblem(reason, "give a tire of Magic Formula 5.2, 6.1 or 6.2", tir.path)
        return
    if "FNOMIN" not in there:
        reason = "FNOMIN is missing: the nominal load of all forces"
        yield InputProblem(reason, "add it to [VERTICAL]", tir.path)
    if len(tir.lacks) == len(REQUIRED):
        reasons = "; ".join(f"no {force}: {why}" for force, why in tir.lacks.items())
        remedy = "add the coefficients of at least one force"
        yield InputProblem(f"no force is described: {reasons}", remedy, tir.path)
    acting = [key for key in PRESSURE_TERMS if tir.numbers.get(key)]
    if acting and "NOMPRES" not in there:
        reason = f"NOMPRES is missing: the nominal pressure, to which {acting[0]} refers"
        remedy = f"add it to [OPERATING_CONDITIONS], or set {', '.join(acting)} to 0"
        yield InputProblem(reason, remedy, tir.path)
    if tir.numbers.get("LMUV") and "LONGVL" not in there:
        reason = "LONGVL is missing: LMUV refers to the nominal speed"
        yield InputProblem(reason, "add it to [MODEL], or set LMUV to 0", tir.path)


def _of_values(tir: TirFile) -> Iterator[InputProblem]:
    numbers = tir.numbers
    for key in POSITIVE:
        if numbers.get(key, 1.0) <= 0:
            reason = f"{key} = {numbers[key]:g} is not positive"
            yield _problem(tir, key, reason, f"correct {key}")
    low, high = PRESSURES
    for key in ("NOMPRES", "INFLPRES"):
        pressure = numbers.get(key)
        if pressure is not None and pressure > 0 and not low <= pressure <= high:
            reason = f"{key} is {pressure:g} Pa by [UNITS], which no tire has"
            remedy = "correct it, or add PRESSURE = 'pascal' or 'bar' to [UNITS]"
            yield _problem(tir, key, reason, remedy)
    for least, most in LIMITS.values():
        if least in numbers and most in numbers and numbers[least] > numbers[most]:
            reason = f"{least} = {numbers[least]:g} contradicts {most} = {numbers[most]:g}"
            remedy = "the smallest value is above the largest: correct one"
            yield _problem(tir, least, reason, remedy)


def parse_tir(text: str, path: str = "", notes: Sequence[str] = ()) -> TirFile:
    """Parse and check the text of a ``.tir`` file; ``notes`` precede its own.

    Raises:
        DataError: text that cannot be understood, missing or contradicting keys, content
            that is not supported; it lists all problems, each with key and remedy.
    """
    DataError.raise_for(other_tire(text, path))
    tir, problems = parsed(text, path, notes)
    checks = (_of_units, _of_model, _of_keys, _missing, _of_values)
    of_values = [problem for check in checks for problem in check(tir)]
    problems += sorted(of_values, key=lambda problem: problem.row or 0)
    DataError.raise_for(problems)
    return tir


def read_tir(path: str | Path) -> TirFile:
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
        "[\x80-\x9f]", lambda match: match[0].encode("latin-1").decode("cp1252", "replace"), text
    )
    odd = control_character(text)
    if odd is not None:
        row, name = odd
        reason = f"not a text file: it holds the control character {name}"
        raise DataError(reason, "remove it", str(path), row)
    return parse_tir(text, str(path), notes)


_CURVATURE = -0.44  # E that follows the brush best where C = 1, see :func:`reduced_tir`

_REDUCED = (
    "Reduced: an isotropic brush tire of constant friction as a Magic Formula. At FNOMIN",
    "both pure slips have the slope 2 c_p a^2 at rest and tend to mu F_z without a peak",
    "before (C = 1); E follows the curve of the brush, which no Magic Formula has. The",
    "lateral stiffness is that of the brush at every load, the longitudinal one stationary",
    "at FNOMIN. Combined slip keeps to the friction circle there. No aligning moment.",
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
    """
    slope, weight = 2 * cpa2 / fz, 2 * cpa2 / (mu * fz)
    values = {"UNLOADED_RADIUS": radius, "FNOMIN": fz, "QBZ1": 0.0, "QCZ1": 1.0, "QDZ1": 0.0}
    values |= {"PKX3": -1.0, "PKY2": 1e-8, "PKY4": 1.0}
    for axis, sign in (("X", 1), ("Y", -1)):  # in ISO-W axes the cornering stiffness is negative
        values |= {f"PC{axis}1": 1.0, f"PD{axis}1": mu, f"PE{axis}1": _CURVATURE}
        values |= {f"PK{axis}1": sign * slope, f"RC{axis}1": 1.0}
        values |= {f"RB{axis}1": weight, f"RB{axis}2": weight}
    tir = new_tir("6.1", values, {}, {}, _REDUCED)
    return replace(tir.with_values({"TYRESIDE": "SYMMETRIC"}), path="reduced.tir")


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
{comment}[UNITS]
LENGTH                   = 'meter'
FORCE                    = 'newton'
ANGLE                    = 'radians'
MASS                     = 'kg'
TIME                     = 'second'
[MODEL]
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
) -> TirFile:
    """A file of this version with these coefficients, in SI units.

    Args:
        version: 5.2, 6.1 or 6.2; keys of other versions are left out.
        values: SI values by key, including all that a tire needs.
        ranges: (least, largest) value by input of :data:`tir_keys.LIMITS`, in ISO-W.
        notes: comment behind the value of a key.
        comment: lines above the first section of values.

    Raises:
        DataError: values that do not describe a tire.
    """
    above = "".join(f"$ {line}\n" for line in comment)
    kind = "-Tyre" if version == "5.2" else version.replace(".", "")
    text = _HEAD.format(comment=above, fittyp=_FITTYP[version], format=kind)
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
        lines.append(f"{key:<24} = {shortest(float(values[key]))}{message}")
    for name, (low, high) in ranges.items():
        lines.append(f"[{_RANGES[name]}]")
        for key, value in zip(LIMITS[name], (low, high), strict=True):
            lines.append(f"{key:<24} = {shortest(value)}")
    return parse_tir("\n".join(lines) + "\n", "fit.tir")
