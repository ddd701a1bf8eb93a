"""Whether the signs of the data fit the convention in which they were read.

In the canonical signs of :mod:`tirefit.slip`, physics determines how some columns are
related: the force rises with the slip, the aligning moment reduces a small slip angle, a
tire pushes to the side to which it leans, and a brake slows the wheel.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tirefit.data.declared import Signs
from tirefit.data.table import SlipCheck
from tirefit.data.units import slip_from_sigma, slip_to_sigma
from tirefit.results import InputProblem
from tirefit.slip import CONVENTIONS, slip_ratio_from_sigma

_SMALL_ANGLE = np.radians(4.0)
"""Slip angle up to which the aligning moment does not change its sign."""

_SMALL_SLIP = 0.03  # largest longitudinal slip of rows that show the effect of alpha

_LEAST_ANGLE, _LEAST_CAMBER = np.radians([0.5, 1.0])
_FEWEST = 10  # rows that show the effect of camber
_LEAST_BRAKING = 0.5  # acceleration [m/s2] above the noise of its sensor


class Evidence(NamedTuple):
    """Two related columns. ``trend`` is 1 if they are related as physics requires in
    canonical signs, -1 if in the opposite way, 0 if the data do not determine it."""

    fields: tuple[str, ...]  # fields of a convention whose signs multiply in the trend
    columns: tuple[str, str]  # the canonical columns
    trend: int
    rule: str  # the relation that must hold, for messages


def trend(x: np.ndarray, y: np.ndarray, least: float) -> int:
    """Sign of a significant straight line through zero; 0 if there is none.

    Significant: correlation above 0.25, t above 5, and some |x| above ``least``.
    """
    energy = np.sum(x * x) * np.sum(y * y)
    if len(x) < 3 or energy == 0 or np.max(abs(x)) < least:
        return 0
    correlation = np.clip(np.sum(x * y) / np.sqrt(energy), -1, 1)
    unexplained = max(1 - correlation**2, 1e-12)
    t = correlation * np.sqrt((len(x) - 1) / unexplained)
    return int(np.sign(correlation)) if abs(t) > 5 and abs(correlation) > 0.25 else 0


def evidence_of(columns: Mapping[str, np.ndarray], definition: str = "kappa") -> list[Evidence]:
    """The evidence of the columns on their signs.

    Args:
        columns: (n,) canonical columns, finite, used rows only.
        definition: of the file's slip column, a key of ``slip.SLIP_DEFINITIONS``.
    """
    return [
        *_of_forces(columns),
        *_of_small_angles(columns),
        *_of_brakes(columns),
        *_of_slip(columns, definition),
    ]


def _of_forces(columns) -> Iterator[Evidence]:
    for end in ("", "_sim"):
        if {"sigma_x", f"fx{end}"} <= columns.keys():
            slip = slip_ratio_from_sigma(columns["sigma_x"])
            sign = trend(slip, columns[f"fx{end}"], 0.005)
            rule = "the force rises with the slip"
            yield Evidence(("slip", "fx"), ("sigma_x", f"fx{end}"), sign, rule)
        if {"alpha", f"fy{end}"} <= columns.keys():
            sign = trend(columns["alpha"], columns[f"fy{end}"], _LEAST_ANGLE)
            rule = "the side force rises with the slip angle"
            yield Evidence(("alpha", "fy"), ("alpha", f"fy{end}"), sign, rule)


def _of_small_angles(columns) -> Iterator[Evidence]:
    """Evidence of the aligning moment, and of camber thrust (the part of F_y / F_z that
    alpha does not explain), in rows of small slip angle and no other slip."""
    if "alpha" not in columns:
        return
    angle = abs(columns["alpha"])
    free = abs(columns.get("sigma_x", 0 * angle)) < _SMALL_SLIP
    rows = (angle < _SMALL_ANGLE) & free
    if "mz" in columns and rows.any():
        alpha, moment = columns["alpha"][rows], columns["mz"][rows]
        sign = -trend(alpha - alpha.mean(), moment - moment.mean(), _LEAST_ANGLE)
        rule = "the aligning moment reduces a small slip angle"
        yield Evidence(("alpha", "mz"), ("alpha", "mz"), sign, rule)
    rows = (angle < _SMALL_ANGLE / 2) & free
    if {"fy", "fz", "gamma"} <= columns.keys() and np.count_nonzero(rows) >= _FEWEST:
        alpha, gamma, fy, fz = (columns[k][rows] for k in ("alpha", "gamma", "fy", "fz"))
        if np.ptp(gamma) < _LEAST_CAMBER:
            return
        others = np.stack([np.ones(len(gamma)), alpha], axis=1)
        both = np.stack([gamma, fy / fz], axis=1)
        left = both - others @ np.linalg.lstsq(others, both)[0]
        sign = trend(left[:, 0], left[:, 1], _LEAST_CAMBER / 4)
        rule = "a tire pushes to the side that it leans to"
        yield Evidence(("gamma", "fy"), ("gamma", "fy"), sign, rule)


def _of_brakes(columns) -> Iterator[Evidence]:
    """Evidence of the brake pressure and of the acceleration of the vehicle."""
    if {"brake_pressure", "fx"} <= columns.keys():
        pressure, force = columns["brake_pressure"], columns["fx"]
        sign = trend(pressure - pressure.mean(), force - force.mean(), 1.0)
        rule = "the braking force rises with the brake pressure"
        yield Evidence(("fx",), ("brake_pressure", "fx"), sign, rule)
    if {"a_x", "fx"} <= columns.keys():
        sign = -trend(columns["a_x"], columns["fx"], _LEAST_BRAKING)
        rule = "a force that brakes slows the vehicle"
        yield Evidence(("fx",), ("a_x", "fx"), sign, rule)


def _of_slip(columns, definition: str) -> Iterator[Evidence]:
    """Evidence of the speeds of wheel and vehicle, and of a locked wheel."""
    if "sigma_x" not in columns:
        return
    rule = "a braked wheel turns slower than a freely rolling one (omega / v)"
    yield Evidence(("slip",), ("omega", "sigma_x"), -turning(columns), rule)
    if definition in ("kappa", "s") and len(columns["sigma_x"]):
        slip = slip_from_sigma(columns["sigma_x"], definition, columns.get("alpha"))
        low, high = np.percentile(slip, [1, 99])
        sign = int(high > 0.98 and low > -0.9) - int(low < -0.98 and high < 0.9)
        rule = "a slip of 1 is that of a wheel locked by its brake"
        yield Evidence(("slip",), ("sigma_x", "sigma_x"), sign, rule)


def turning(columns: Mapping[str, np.ndarray]) -> int:
    """Sign of the trend of omega / v over the slip; 0 if there is none."""
    if not {"omega", "v"} <= columns.keys():
        return 0
    moving = columns["v"] > 0
    if not moving.any():
        return 0
    slip = slip_ratio_from_sigma(columns["sigma_x"][moving])
    wheel = columns["omega"][moving] / columns["v"][moving]
    return trend(slip - slip.mean(), wheel - wheel.mean(), 0.005)


def fitting_conventions(evidence: Sequence[Evidence], convention: str, load: int = 1) -> list[str]:
    """Conventions in which all evidence, and the load, would have the right sign.

    Args:
        evidence: of columns that were read in ``convention``.
        convention: a key of ``slip.CONVENTIONS``.
        load: 1 if the loads read are positive, -1 if they are negative.
    """
    read = CONVENTIONS[convention]
    fitting = []
    for name, other in CONVENTIONS.items():
        turned = {f: getattr(read, f) * getattr(other, f) for f in read._fields[1:]}
        signs = [
            item.trend * int(np.prod([turned[field] for field in item.fields])) for item in evidence
        ]
        if turned["fz"] == load and min(signs, default=1) >= 0:
            fitting.append(name)
    return fitting


_REFUSED = ("fx", "fy", "fx_sim", "fy_sim")
"""Forces that must rise with their slip: the opposite sign is an error."""

_TURNED = {"mz": "Nm", "gamma": "deg"}
"""Columns that often have the opposite sign alone -> a unit with which to flip it."""

_LEAST_DRIVING = 0.01
"""Driving slip above the noise about zero in a braking test."""

_SLIGHT = 0.002
"""Difference of slips that rounding of a rolling radius may cause."""

_LIMIT = 0.01
"""Median difference of slip ratios that noise and an offset of the slip may cause; a
fifth of the scatter of the slips if that is larger."""

_DRIVING_POSITIVE = {
    "LONGSLIP": "TYDEX",
    "SR": "Tire Test Consortium",
    "SL": "Tire Test Consortium",
}
"""Headers of a slip -> the files that have them, where driving is positive."""


def check_signs(
    columns: Mapping[str, np.ndarray],
    headers: Mapping[str, str],
    convention: str,
    file: str,
    definition: str = "sigma_x",
    is_derived: bool = False,
) -> list[InputProblem]:
    """Problems if force and slip have a negative correlation in canonical signs.

    Args:
        columns: (n,) canonical columns, used rows only.
        headers: the header of each column in the file.
        convention: the one in which the file was read.
        file: named in the problems.
        definition: of the file's slip column, a key of ``slip.SLIP_DEFINITIONS``.
        is_derived: whether ``tirefit derive`` wrote the file, whose signs are known.
    """
    evidence, signs = evidence_of(columns, definition), CONVENTIONS[convention]
    fitting, problems = fitting_conventions(evidence, convention), []
    for item in evidence:
        if item.trend >= 0 or not _is_refused(item):
            continue
        (field, other), (slip, force) = item.fields, item.columns
        names = f"{headers.get(slip, slip)!r} and {headers.get(force, force)!r}"
        relation = "equal" if getattr(signs, field) == getattr(signs, other) else "opposite"
        reason = (
            f"signs contradict the convention {convention!r}: {names} have {relation}"
            " signs there, but not in the data"
        )
        remedy = (
            "if the sign of one column differs, put a minus before its unit:"
            f" --unit {force}=-N, or {force}=-kN if it is in kN"
        )
        if is_derived:
            reason = (
                f"{names} have the wrong signs against each other: the force would act in the"
                " direction of the axle's slip"
            )
            remedy = (
                "tirefit derive wrote this file: correct tracked_point, or the signs in [units],"
                " of vehicle.toml and derive it again; its report names the point that the log"
                " fits"
            )
        elif fitting:
            remedy = f"these signs fit --convention {' or '.join(fitting)}; {remedy}"
        problems.append(InputProblem(reason, remedy, file, column=headers.get(force, force)))
    return problems


def _is_refused(item: Evidence) -> bool:
    return item.columns[0] in ("sigma_x", "alpha") and item.columns[1] in _REFUSED


def check_slip(
    given: np.ndarray,
    computed: np.ndarray,
    definition: str,
    alpha: np.ndarray | None,
    radius: float,
) -> SlipCheck:
    """Compare a slip column with (v - omega R) / (omega R).

    Args:
        given: (n,) sigma_x of the slip column.
        computed: (n,) sigma_x of the speeds.
        definition: in which the slip column was read, a key of ``SLIP_DEFINITIONS``.
        alpha: (n,) slip angle [rad], if there is one.
        radius: R [m].
    """
    logged, rolled = slip_ratio_from_sigma(given), slip_ratio_from_sigma(computed)
    difference = float(np.median(abs(logged - rolled)))
    limit = max(_LIMIT, 0.2 * np.std(logged))
    cause = _cause(given, computed, definition, alpha, radius)
    if difference <= limit:
        text = cause and (
            f"the slip differs from (v - omega R)/(omega R) by {difference:.2g} in the"
            f" median; {cause}"
        )
        return SlipCheck(radius, difference, False, text)
    cause = cause or "check the rolling radius, the slip definition (--slip), the units"
    if np.median(abs(-logged - rolled)) < limit:
        cause = "it has the opposite sign: declare the file's --convention"
    text = (
        "the slip contradicts (v - omega R)/(omega R): they differ by"
        f" {difference:.3g} in the median; {cause}"
    )
    return SlipCheck(radius, difference, True, text)


def _cause(given, computed, definition: str, alpha, radius: float) -> str:
    """A sentence on the probable cause of a systematic difference of the two slips.

    The cause may be another definition of slip, another scale or another radius. The
    text is empty if the two agree or no cause explains most of the difference. Arguments
    are those of :func:`check_slip`.
    """

    def apart(one, other):
        difference = slip_ratio_from_sigma(one) - slip_ratio_from_sigma(other)
        return float(np.median(abs(difference)))

    logged = slip_from_sigma(given, definition, alpha)
    meant = slip_from_sigma(computed, definition, alpha)
    explained = {}
    for other in ("kappa", "sigma_x", "slip_ratio"):
        if other != definition and (definition, other) != ("s", "kappa"):
            text = f"it agrees if read as {other}: pass --slip {other}"
            explained[text] = apart(slip_to_sigma(logged, other), computed)
    clear = abs(meant) > max(np.median(abs(meant)), _SLIGHT)
    if clear.any():
        factor = np.median(logged[clear] / meant[clear])
        text = f"it agrees if divided by {factor:.3g}: check its unit and scale"
        mended = slip_to_sigma(logged / (factor or 1), definition, alpha)
        explained[text] = apart(mended, computed)
    ratio = np.median((1 + given) / (1 + computed))
    text = f"a rolling radius of {radius / ratio:.4g} m would give it, not {radius:g} m"
    explained[text] = apart(given, ratio * (1 + computed) - 1)
    now, best = apart(given, computed), min(explained, key=explained.__getitem__)
    if now <= _SLIGHT or explained[best] > now / 3:
        return ""
    return best


def doubt_convention(
    columns: Mapping[str, np.ndarray], headers: Mapping[str, str], definition: str, signs: Signs
) -> str | None:
    """A warning if the sign in which the slip was read may be wrong.

    Forces change their sign with the slip, so :func:`check_signs` cannot distinguish
    driving from braking: a file read with the wrong signs fits a mirrored tire as well.
    If no convention was declared, driving slips cause a warning unless the speeds of
    wheel and vehicle confirm them: omega / v falls as the braking slip rises.

    Args:
        columns, headers, definition: as in :func:`check_signs`.
        signs: convention in which the file was read.
    """
    if "sigma_x" not in headers or "sigma_x" not in columns:
        return None  # no slip column: computed from speeds, or none at all
    sense = turning(columns)
    pairs, convention = evidence_of(columns, definition), signs.convention
    if signs.is_declared:
        if sense <= 0:
            return None
        fitting = fitting_conventions(pairs, convention)
        remedy = f"these signs fit --convention {' or '.join(fitting)}"
        return (
            f"the slip contradicts omega / v: by the signs of {convention!r}, the wheel turns"
            " slower while driven; " + (remedy if fitting else "check --convention")
        )
    header, sign = headers["sigma_x"], CONVENTIONS[convention].slip
    slip = slip_from_sigma(columns["sigma_x"], definition, columns.get("alpha"))
    low, high = np.percentile(slip, [1, 99])
    has_driving = low < -_LEAST_DRIVING
    if sense < 0 or not (sense or has_driving):
        return None
    brakes = sign > 0  # whether a positive slip was read as braking
    taken = f"{'' if brakes else 'minus '}{header!r} is taken as braking"
    if has_driving:
        side, end = ("negative", "down") if brakes else ("positive", "up")
        worst = f"{end} to {sign * np.min(slip):.3g}"
        taken = f"{side} {header!r} ({worst}) is taken as driving"
    now, other = ("braking", "driving")[::sign]
    whose = signs.whose.removeprefix("assumed")
    reason = ""
    if sense > 0:
        way = "rises" if brakes else "falls"
        reason = f", but the wheel turns faster as it {way} (omega / v)"
    elif definition in ("kappa", "s") and low < -0.98 and high < 0.9:
        reason = f", but {-sign} is where a wheel locks if {other} is positive"
    elif brakes and header in _DRIVING_POSITIVE:
        reason = f", but in {_DRIVING_POSITIVE[header]} files driving is positive"
    forces = [item for item in pairs if _is_refused(item)]
    either = fitting_conventions(pairs, convention), fitting_conventions(forces, convention)
    turned = [[n for n in names if CONVENTIONS[n].slip != sign] for names in either]
    fitting = turned[0] or turned[1]
    return (
        f"no convention declared: read as {convention}{whose}, so {taken}"
        f"{reason}; if positive slip means {other} in this file, pass --convention"
        f" {' or '.join(fitting)}; if it means {now}, --convention {convention}"
    )


def doubt_signs(
    columns: Mapping[str, np.ndarray],
    headers: Mapping[str, str],
    definition: str,
    signs: Signs,
    units: Mapping[str, str],
) -> list[str]:
    """Warnings on signs that moment, camber, brakes or a locked wheel contradict.

    Args:
        columns, headers, definition: as in :func:`check_signs`.
        signs: convention in which the file was read. If it was not declared,
            :func:`doubt_convention` checks the slip.
        units: the unit in which each column was read.
    """
    evidence, messages = evidence_of(columns, definition), []
    convention, is_declared = signs.convention, signs.is_declared
    for item in evidence:
        of_slip = item.fields == ("slip",)
        refused = _is_refused(item) or item.columns[0] == "omega"
        if item.trend >= 0 or refused or (of_slip and not is_declared):
            continue
        names = dict.fromkeys(repr(headers.get(c, c)) for c in item.columns)
        assumed = "" if is_declared else ", which were assumed"
        messages.append(
            f"{' and '.join(names)}: {item.rule}, but not with the signs of"
            f" {convention!r}{assumed}: {_remedy(item, evidence, convention, units)}"
        )
    return messages


def _remedy(
    item: Evidence, evidence: list[Evidence], convention: str, units: Mapping[str, str]
) -> str:
    """The remedies: a declaration that fits, or one that flips a column."""
    ways = []
    fitting = fitting_conventions(evidence, convention)
    if fitting:
        ways.append(f"these signs fit --convention {' or '.join(fitting)}")
    elif turned := fitting_conventions(evidence, convention, load=-1):
        both = " or ".join(turned)
        ways.append(
            f"if the sign of F_z was turned: --convention {both} --unit fz=-{units.get('fz', 'N')}"
        )
    ways += [
        f"if the sign of {name} alone differs: --unit {name}=-{units.get(name, unit)}"
        for name, unit in _TURNED.items()
        if name in item.columns
    ]
    return "; ".join(ways) or "check --convention"
