"""What a ``.tir`` file must satisfy to be evaluated: every problem, with its remedy."""

from collections.abc import Iterator

from tirefit.data.columns import is_number
from tirefit.data.tir_file import Entry, TirFile
from tirefit.data.tir_keys import (
    COEFFICIENTS,
    DIMENSIONS,
    FITTYP,
    FORMATS_REFUSED,
    LIMITS,
    NEUTRAL,
    NONZERO,
    ONLY_IN,
    POSITIVE,
    PRESSURE_TERMS,
    REQUIRED,
    SIDES,
    UNITS,
)
from tirefit.results import InputProblem

__all__ = ["notes_on", "problems_of"]

_PRESSURES = (1e4, 5e6)
"""Inflation pressures [Pa] of tires, from a kart's to an aircraft's."""


def problems_of(tir: TirFile) -> list[InputProblem]:
    """All that keeps the file from being evaluated, in the order of its lines."""
    problems = [
        *_of_units(tir),
        *_of_model(tir),
        *_twice(tir),
        *_no_numbers(tir),
        *_missing(tir),
        *_of_values(tir),
        *_of_limits(tir),
        *_of_version(tir),
    ]
    return sorted(problems, key=lambda problem: problem.row or 0)


def notes_on(tir: TirFile) -> list[str]:
    """What was assumed of the file or is not used of it, in sentences."""
    said = []
    entry = tir.find("FE_METHOD")
    if entry and entry.text.upper() == "YES":
        said.append(
            "FE_METHOD = 'YES' is not used: combined slip by weighting functions, not"
            " by a friction ellipse"
        )
    use_mode = tir.numbers.get("USE_MODE")
    if use_mode is not None and use_mode % 10 < 4:
        said.append(
            f"USE_MODE = {use_mode:g} is not used: all forces, with combined slip"
        )
    if tir.numbers.get("FITTYP") == 5:
        said.append("FITTYP = 5 (MF-Tyre 5.0) is evaluated by the equations of 5.2")
    if not any(entry.section == "UNITS" for entry in tir.entries):
        said.append("there is no [UNITS] section: SI units assumed")
    if tir.numbers["PKY1"] > 0 and tir.numbers["PDY1"] > 0:
        said.append(
            "PKY1 > 0 gives F_y > 0 for alpha > 0: these are not the ISO-W axes of a"
            " .tir file"
        )
    return said


def _problem(
    tir: TirFile, key: str, reason: str, remedy: str, section=None
) -> InputProblem:
    entry = tir.find(key, section)
    return InputProblem(reason, remedy, tir.path, entry.row if entry else None)


def _of_units(tir: TirFile) -> Iterator[InputProblem]:
    for quantity, sizes in UNITS.items():
        entry = tir.find(quantity, "UNITS")
        if entry is None or entry.text.lower() in sizes:
            continue
        reason = f"{quantity} = {entry.value} in [UNITS] is not supported"
        remedy = f"write the file with one of {', '.join(sizes)}"
        if quantity == "ANGLE":
            reason += ": coefficients such as PKY1 and PHY1 hold angles in radians"
        yield InputProblem(reason, remedy, tir.path, entry.row)


def _of_model(tir: TirFile) -> Iterator[InputProblem]:
    known = ", ".join(f"{number} (MF {name})" for number, name in FITTYP.items())
    entry = tir.find("FITTYP")
    if entry is None:
        reason = "FITTYP is missing: the version of the Magic Formula is unknown"
        remedy = f"add it to [MODEL]: {known}"
        yield _problem(tir, "PROPERTY_FILE_FORMAT", reason, remedy)
    elif tir.numbers.get("FITTYP") not in FITTYP:
        reason = f"FITTYP = {entry.value} is not a supported version"
        yield InputProblem(reason, f"supported: {known}", tir.path, entry.row)
    entry = tir.find("PROPERTY_FILE_FORMAT")
    if entry and entry.text.upper() in FORMATS_REFUSED:
        model = FORMATS_REFUSED[entry.text.upper()]
        reason = f"PROPERTY_FILE_FORMAT = {entry.value}: the {model} model"
        remedy = "it is not supported; give a file of MF 5.2, 6.1 or 6.2"
        yield InputProblem(reason, remedy, tir.path, entry.row)
    entry = tir.find("FILE_TYPE")
    if entry and entry.text.lower() != "tir":
        reason = f"FILE_TYPE = {entry.value}, not 'tir'"
        yield InputProblem(reason, "give a tire property file", tir.path, entry.row)
    entry = tir.find("TYRESIDE")
    if entry and tir.side not in SIDES:
        reason = f"TYRESIDE = {entry.value} is not a side"
        yield InputProblem(reason, f"one of {', '.join(SIDES)}", tir.path, entry.row)
    if tir.numbers.get("USE_MODE", 0) < 0:
        reason = f"USE_MODE = {tir.numbers['USE_MODE']:g} mirrors the tire"
        remedy = "that is not supported: drop the minus and choose the side with --side"
        yield _problem(tir, "USE_MODE", reason, remedy)


def _twice(tir: TirFile) -> Iterator[InputProblem]:
    """Keys with two values; a coefficient must not have them even in two sections."""
    seen: dict[tuple[str | None, str], Entry] = {}
    for entry in tir.entries:
        anywhere = entry.key in COEFFICIENTS and entry.section != "UNITS"
        first = seen.setdefault((None if anywhere else entry.section, entry.key), entry)
        if _value(first) != _value(entry):
            reason = (
                f"{entry.key} = {entry.value} contradicts {entry.key} = {first.value}"
                f" in row {first.row}"
            )
            yield InputProblem(reason, "remove one of them", tir.path, entry.row)


def _value(entry):
    return float(entry.value) if is_number(entry.value) else entry.text


def _no_numbers(tir: TirFile) -> Iterator[InputProblem]:
    limits = {key for pair in LIMITS.values() for key in pair}
    wanted = {*COEFFICIENTS, *DIMENSIONS, *limits, "USE_MODE"}
    for entry in tir.entries:
        if entry.key not in wanted or entry.section == "UNITS":
            continue
        if not is_number(entry.value):
            what = entry.value if entry.value else "(nothing)"
            reason = f"{entry.key} = {what} is not a number"
            remedy = "give a plain number, as in 1.5 or -2e-3"
            if entry.key not in REQUIRED:
                remedy += ", or remove the line"
            yield InputProblem(reason, remedy, tir.path, entry.row)


def _missing(tir: TirFile) -> Iterator[InputProblem]:
    there = {entry.key for entry in tir.entries}
    for key, meaning in REQUIRED.items():
        if key not in there:
            reason = f"{key} is missing: {meaning}"
            yield InputProblem(reason, f"add it to [{COEFFICIENTS[key]}]", tir.path)
    acting = [key for key in PRESSURE_TERMS if tir.numbers.get(key)]
    if acting and "NOMPRES" not in there:
        reason = (
            f"NOMPRES is missing: the nominal pressure, to which {acting[0]} refers"
        )
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
    for key in NONZERO:
        if numbers.get(key) == 0:
            reason = f"{key} = 0 contradicts a stiffness: {REQUIRED[key]} is not zero"
            yield _problem(tir, key, reason, f"correct {key}")
    low, high = _PRESSURES
    for key in ("NOMPRES", "INFLPRES"):
        pressure = numbers.get(key)
        if pressure is not None and pressure > 0 and not low <= pressure <= high:
            reason = f"{key} is {pressure:g} Pa by [UNITS], which no tire has"
            remedy = "correct it, or add PRESSURE = 'pascal' or 'bar' to [UNITS]"
            yield _problem(tir, key, reason, remedy)


def _of_limits(tir: TirFile) -> Iterator[InputProblem]:
    for least, most in LIMITS.values():
        low, high = tir.numbers.get(least), tir.numbers.get(most)
        if low is not None and high is not None and low > high:
            reason = f"{least} = {low:g} contradicts {most} = {high:g}"
            remedy = "the smallest value is above the largest: correct one"
            yield _problem(tir, least, reason, remedy)


def _of_version(tir: TirFile) -> Iterator[InputProblem]:
    """Coefficients that act in the other generation only: not to be passed over."""
    version = FITTYP.get(tir.numbers.get("FITTYP", 0), "")
    for key, generation in ONLY_IN.items():
        value = tir.numbers.get(key)
        neutral = NEUTRAL.get(key, 1.0 if key.startswith("L") else 0.0)
        if version and value not in (None, neutral) and version[0] != generation:
            reason = f"{key} = {value:g} contradicts FITTYP: MF {version} has no {key}"
            other = "52" if generation == "5" else "61"
            remedy = f"set {key} = {neutral:g}, or FITTYP = {other} if it is meant"
            yield _problem(tir, key, reason, remedy)
