"""Whether the signs of the data fit the convention in which they were read."""

from collections.abc import Mapping

import numpy as np

from tirefit.data.declared import Signs
from tirefit.data.evidence import Evidence, evidence_of
from tirefit.data.evidence import fitting_conventions as _fitting
from tirefit.data.evidence import turning as turning_of
from tirefit.data.table import SlipCheck
from tirefit.data.units import slip_from_sigma, slip_to_sigma
from tirefit.results import InputProblem
from tirefit.slip import CONVENTIONS, slip_ratio_from_sigma

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
    evidence = evidence_of(columns, definition)
    wrong = [item for item in evidence if item.trend < 0 and _is_refused(item)]
    if not wrong:
        return []
    fitting = _fitting(evidence, convention)
    problems = []
    for item in wrong:
        (field, other), (slip, force) = item.fields, item.columns
        names = f"{headers.get(slip, slip)!r} and {headers.get(force, force)!r}"
        reason = (
            f"signs contradict the convention {convention!r}: {names} have"
            f" {_relation(convention, field, other)} signs there, but not in the data"
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


def _relation(convention: str, field: str, force: str) -> str:
    signs = CONVENTIONS[convention]
    return "equal" if getattr(signs, field) == getattr(signs, force) else "opposite"


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
    turning = turning_of(columns)
    pairs, convention = evidence_of(columns, definition), signs.convention
    if signs.is_declared:
        if turning <= 0:
            return None
        fitting = _fitting(pairs, convention)
        remedy = f"these signs fit --convention {' or '.join(fitting)}"
        return (
            f"the slip contradicts omega / v: by the signs of {convention!r}, the wheel turns"
            " slower while driven; " + (remedy if fitting else "check --convention")
        )
    header, sign = headers["sigma_x"], CONVENTIONS[convention].slip
    slip = slip_from_sigma(columns["sigma_x"], definition, columns.get("alpha"))
    low, high = np.percentile(slip, [1, 99])
    has_driving = low < -_LEAST_DRIVING
    if turning < 0 or not (turning or has_driving):
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
    if turning > 0:
        way = "rises" if brakes else "falls"
        reason = f", but the wheel turns faster as it {way} (omega / v)"
    elif definition in ("kappa", "s") and low < -0.98 and high < 0.9:
        reason = f", but {-sign} is where a wheel locks if {other} is positive"
    elif brakes and header in _DRIVING_POSITIVE:
        reason = f", but in {_DRIVING_POSITIVE[header]} files driving is positive"
    forces = [item for item in pairs if _is_refused(item)]
    either = _fitting(pairs, convention), _fitting(forces, convention)
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
    fitting = _fitting(evidence, convention)
    if fitting:
        ways.append(f"these signs fit --convention {' or '.join(fitting)}")
    elif turned := _fitting(evidence, convention, load=-1):
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
