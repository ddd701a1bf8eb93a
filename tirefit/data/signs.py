"""Whether the signs and units of the data are plausible in the way they were read.

In the canonical signs of :mod:`tirefit.slip`, physics determines how some columns are
related: the force rises with the slip, the aligning moment reduces a small slip angle, a
tire pushes to the side to which it leans, and a brake slows the wheel.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tirefit.data.columns import Plan
from tirefit.data.declared import Signs
from tirefit.data.table import CANONICAL, SlipCheck
from tirefit.data.units import slip_from_sigma, slip_to_sigma
from tirefit.results import InputProblem
from tirefit.slip import CONVENTIONS, LOCKED, slip_ratio_from_sigma

_DEG = np.pi / 180


class Evidence(NamedTuple):
    """Two related columns, and how the data relate them."""

    fields: tuple[str, ...]  # fields of a convention whose signs multiply in the trend
    columns: tuple[str, str]  # the canonical columns
    sign: int  # of their relation in canonical signs
    least: float  # smallest largest value of the first that shows it, in its unit
    rule: str  # the relation that must hold, for messages
    without: tuple[str, ...] = ()  # what is regressed out of both: 1 (the mean), columns
    within: float = np.inf  # largest slip angle [rad] of rows that show it, without other slip
    is_refused: bool = False  # whether the opposite relation is an error
    trend: int = 0  # 1 as required, -1 opposite, 0 if the data do not determine it


_RULES = (
    *(Evidence(("slip", "fx"), ("sigma_x", force), 1, 0.005,
               "the force rises with the slip", is_refused=True) for force in ("fx", "fx_sim")),
    *(Evidence(("alpha", "fy"), ("alpha", force), 1, 0.5 * _DEG,
               "the side force rises with the slip angle", is_refused=True)
      for force in ("fy", "fy_sim")),
    # Beyond 4 deg the aligning moment may change its sign; camber acts beside little force.
    Evidence(("alpha", "mz"), ("alpha", "mz"), -1, 0.5 * _DEG,
             "the aligning moment reduces a small slip angle", ("1",), 4 * _DEG),
    Evidence(("gamma", "fy"), ("gamma", "fy"), 1, 0.5 * _DEG,
             "a tire pushes to the side that it leans to", ("1", "alpha"), 2 * _DEG),
    Evidence(("fx",), ("brake_pressure", "fx"), 1, 1.0,
             "the braking force rises with the brake pressure", ("1",)),
    Evidence(("fx",), ("a_x", "fx"), -1, 0.5, "a force that brakes slows the vehicle"),
    Evidence(("slip",), ("sigma_x", "omega"), -1, 0.005,
             "a braked wheel turns slower than a freely rolling one (omega / v)", ("1",)),
)  # fmt: skip


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


def evidence_of(columns: Mapping[str, np.ndarray]) -> list[Evidence]:
    """The rules whose columns are known, with their trends.

    Args:
        columns: (n,) canonical columns, finite, used rows only.
    """
    known, evidence = dict(columns), []
    if "sigma_x" in known:  # bounded for a locked wheel
        known["sigma_x"] = slip_ratio_from_sigma(known["sigma_x"])
    if "omega" in known:
        v = known.get("v", np.zeros(len(known["omega"])))
        known["omega"] = np.full(len(v), np.nan)
        np.divide(columns["omega"], v, out=known["omega"], where=v > 0)
    for rule in _RULES:
        x, y = (known.get(name) for name in rule.columns)
        if x is None or y is None or "alpha" in rule.without and "alpha" not in known:
            continue
        rows = np.isfinite(x + y)
        if rule.within < np.inf:
            rows &= abs(known["alpha"]) < rule.within
            rows &= abs(known.get("sigma_x", np.zeros(len(x)))) < 0.03  # rows that show alpha alone
        if rule.columns[0] == "gamma":  # camber thrust is proportional to load
            y = y / known["fz"] if "fz" in known else np.zeros(len(x))
        both = np.stack([x, y], axis=1)[rows]
        if rule.without and len(both):
            others = [np.ones(len(x)) if name == "1" else known[name] for name in rule.without]
            base = np.stack(others, axis=1)[rows]
            both = both - base @ np.linalg.lstsq(base, both)[0]
        sign = rule.sign * trend(both[:, 0], both[:, 1], rule.least)
        evidence.append(rule._replace(trend=sign))
    return evidence


def fitting_conventions(evidence: Sequence[Evidence], convention: str) -> list[str]:
    """Conventions in which the load and all evidence would have the right sign.

    Args:
        evidence: of columns that were read in ``convention``.
        convention: a key of ``slip.CONVENTIONS``.
    """
    read, fitting = CONVENTIONS[convention], []
    for name, other in CONVENTIONS.items():
        turned = {f: getattr(read, f) * getattr(other, f) for f in read._fields[1:]}
        signs = (item.trend * math.prod(turned[f] for f in item.fields) for item in evidence)
        if turned["fz"] > 0 and min(signs, default=1) >= 0:
            fitting.append(name)
    return fitting


_ALONE = {"fx": "N", "fy": "N", "fx_sim": "N", "fy_sim": "N", "mz": "Nm"}
"""Columns whose sign is often opposite alone -> a unit with which to flip it."""


def judge_signs(
    columns: Mapping[str, np.ndarray],
    headers: Mapping[str, str],
    signs: Signs,
    file: str,
    definition: str,
    units: Mapping[str, str],
    is_derived: bool = False,
) -> tuple[list[InputProblem], list[str]]:
    """Problems if force and slip have a negative correlation in canonical signs, and warnings on
    signs that moment, camber, brakes or speeds contradict.

    Args:
        columns: (n,) canonical columns, used rows only.
        headers: the header of each column in the file.
        signs: convention in which the file was read. If it was not declared, the sign of the
            slip causes one warning, with all that the data tell about it.
        file: named in the problems.
        definition: of the file's slip column, a key of ``slip.SLIP_DEFINITIONS``.
        units: the unit in which each column was read.
        is_derived: whether ``tirefit derive`` wrote the file, whose signs are known.
    """
    evidence, problems, warnings = evidence_of(columns), [], list[str]()
    if not signs.is_declared:
        warnings += _undeclared(columns, headers, definition, signs, evidence)
    assumed = "" if signs.is_declared else ", which were assumed"
    for item in evidence:
        if item.trend >= 0:
            continue
        remedy = _remedy(item, evidence, signs.convention, units)
        names = " and ".join(dict.fromkeys(repr(headers.get(n, n)) for n in item.columns))
        if item.is_refused:
            reason = f"signs contradict the convention {signs.convention!r}: "
            reason += f"{names}: {item.rule}, but not in the data"
            if is_derived:
                remedy = "correct tracked_point or [units] of vehicle.toml, and derive it again"
            header = headers.get(item.columns[1], item.columns[1])
            problems.append(InputProblem(reason, remedy, file, column=header))
        elif signs.is_declared or item.fields != ("slip",):
            read_as = f"{signs.convention!r}{assumed}"
            warnings.append(f"{names}: {item.rule}, but not with the signs of {read_as}: {remedy}")
    return problems, warnings


def _remedy(
    item: Evidence, evidence: list[Evidence], convention: str, units: Mapping[str, str]
) -> str:
    """The remedies: a declaration that fits, or one that flips a column."""
    ways = []
    fitting = fitting_conventions(evidence, convention)
    if fitting:
        ways.append(f"these signs fit --convention {' or '.join(fitting)}")
    name = "gamma" if item.columns[0] == "gamma" else item.columns[1]
    if name in (*_ALONE, "gamma") and len(item.fields) == 2:
        unit = units.get(name) or _ALONE.get(name, "deg")
        flipped = unit[1:] if unit.startswith("-") else f"-{unit}"
        ways.append(f"if the sign of {name} alone differs: --unit {name}={flipped}")
    return "; ".join(ways) or "check --convention"


def _undeclared(
    columns: Mapping[str, np.ndarray],
    headers: Mapping[str, str],
    definition: str,
    signs: Signs,
    evidence: Sequence[Evidence],
) -> list[str]:
    """A warning that the sign of the slip may be wrong, as no convention was declared.

    Forces change their sign with the slip, so they do not distinguish driving from braking: a
    file read with the wrong signs fits a mirrored tire as well. Driving slips cause a warning
    unless the speeds of wheel and vehicle confirm them: omega / v falls as the braking slip
    rises.
    """
    if "sigma_x" not in headers.keys() & columns.keys():
        return []  # no slip column: computed from speeds, or none at all
    convention, sign = signs.convention, CONVENTIONS[signs.convention].slip
    speeds = sum(item.trend for item in evidence if item.columns == ("sigma_x", "omega"))
    slip = sign * slip_from_sigma(columns["sigma_x"], definition, columns.get("alpha"))
    # Driving slip above the noise about zero in a braking test.
    if speeds > 0 or not (speeds or np.percentile(sign * slip, 1) < -0.01):
        return []
    side = "positive" if sign > 0 else "negative"
    reason = ", but omega / v rises with it" if speeds < 0 else ""
    now, other = ("braking", "driving")[::sign]
    forces = [item for item in evidence if item.is_refused]
    either = fitting_conventions(evidence, convention), fitting_conventions(forces, convention)
    turned = [[n for n in names if CONVENTIONS[n].slip != sign] for names in either]
    return [
        f"no convention declared: read as {convention}{signs.whose.removeprefix('assumed')}, so"
        f" {side} {headers['sigma_x']!r} ({np.min(slip):.3g} to {np.max(slip):.3g}) is taken as"
        f" braking{reason}; if positive slip means {other} in this file, pass --convention"
        f" {' or '.join(turned[0] or turned[1])}; if it means {now}, --convention {convention}"
    ]


_SLIGHT = 0.002  # difference of slips that rounding of a rolling radius may cause


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

    Returns:
        Their difference, and a sentence on its probable cause: the one that explains two
        thirds of it.
    """
    rolled = slip_ratio_from_sigma(computed)

    def apart(sigma: np.ndarray) -> float:
        return float(np.median(abs(slip_ratio_from_sigma(sigma) - rolled)))

    def causes() -> Iterator[tuple[str, np.ndarray]]:
        """Sentence on a cause -> the slip sigma_x (n,) that would then be right."""
        logged = slip_from_sigma(given, definition, alpha)
        meant = slip_from_sigma(computed, definition, alpha)
        mirrored = "it has the opposite sign: declare the file's --convention"
        yield mirrored, slip_to_sigma(-logged, definition, alpha)
        for other in ("kappa", "sigma_x", "slip_ratio"):
            if other != definition and (definition, other) != ("s", "kappa"):
                text = f"it agrees if read as {other}: pass --slip {other}"
                yield text, slip_to_sigma(logged, other)
        clear = abs(meant) > max(np.median(abs(meant)), _SLIGHT)
        factor = np.median(logged[clear] / meant[clear]) if clear.any() else 0.0
        if factor > 0:
            text = f"it agrees if divided by {factor:.3g}: check its unit and scale"
            yield text, slip_to_sigma(logged / factor, definition, alpha)
        ratio = np.median((1 + given) / (1 + computed))
        text = f"a rolling radius of {radius / ratio:.4g} m would give it, not {radius:g} m"
        yield text, (1 + given) / ratio - 1

    difference = apart(given)
    # Median difference of slip ratios that noise and an offset of the slip may cause; a fifth of
    # the scatter of the slips if that is larger.
    contradicts = difference > max(0.01, 0.2 * np.std(slip_ratio_from_sigma(given)))
    possible = dict(causes())
    cause = min(possible, key=lambda text: apart(possible[text]))
    if difference <= _SLIGHT or apart(possible[cause]) > difference / 3:
        cause = "check the rolling radius, the slip definition (--slip), the units"
        if not contradicts:
            return SlipCheck(radius, difference, False)
    verb = "contradicts" if contradicts else "differs from"
    text = f"the slip {verb} (v - omega R)/(omega R): by {difference:.3g} in the median; {cause}"
    return SlipCheck(radius, difference, contradicts, text)


# --- units ------------------------------------------------------------------------------

_SHARES = (5e-3, 5.0)
"""Smallest and largest force over load: it is some 5 to 30 times the slip until the tire slides,
then about the friction."""
_FOLLOWED = 0.5  # smallest correlation of a force with the slip that it follows
_STEEPEST = 100.0
"""Largest force over load, over the slip: the stiffest tire of ``fits`` has 42 at zero slip, and
of all data the largest is 30. Radians read as degrees multiply it by 57, shares read as
percent by 100."""
_LEAST_SLIP = (("fx", "sigma_x", 0.01), ("fy", "alpha", np.radians(0.5)))


def doubt_units(
    columns: Mapping[str, np.ndarray], headers: Mapping[str, str], plan: Plan
) -> list[str]:
    """Warnings on forces that no tire has at its load, and on slips too small for their forces.

    Args:
        columns: (n,) canonical columns, used rows only.
        headers: the header of each column in the file.
        plan: how each column was read.
    """
    warnings = []
    for force, slip, least in _LEAST_SLIP:
        if not {force, "fz"} <= columns.keys():
            continue
        share, (low, high) = columns[force] / columns["fz"], _SHARES
        largest = _high(share)
        much = f"{largest:.0f} times the load, which no tire has" if largest > high else ""
        if largest < low and slip in columns and _high(columns[slip]) > least:
            much = f"only {largest:.2g} of the load, too little at these slips"
        if much:
            name = "fz" if largest > high else force
            remedy = f"if {headers.get(name)!r} is in kN, pass --unit {name}=kN"
            remedy = remedy if name in headers else f"give --constant {name} in N, not in kN"
            warnings.append(
                f"{headers.get(force, force)!r} reaches {much}: check the units of {force} and"
                f" fz; {remedy}"
            )
        column = plan.columns.get((plan.slip or "") if slip == "sigma_x" else slip)
        near = abs(columns[slip]) < LOCKED if column and slip in columns else np.zeros(0, bool)
        if column is None or not near.any():
            continue
        share, size = share[near], columns[slip][near]
        together = abs(np.mean((share - np.mean(share)) * (size - np.mean(size))))
        steepness = _high(share) / max(_high(size), 1e-300)
        # Slips that the force hardly follows are about zero, and not judged.
        if steepness > _STEEPEST and together > _FOLLOWED * np.std(share) * np.std(size):
            remedy = f"check the units of {column.name} and {force}"
            if column.unit and abs(column.unit.scale) < 1:
                larger = "-" * (column.unit.scale < 0) + CANONICAL[slip][0]
                remedy = f"if it is in {larger}, pass --unit {column.name}={larger}"
            warnings.append(
                f"{column.header!r}, read in {column.unit_text or CANONICAL[slip][0]}, is too small"
                f" for {force}: force over load reaches {steepness:.0f} times the slip, which no"
                f" tire does; {remedy}"
            )
    return warnings


def _high(values: np.ndarray) -> float:
    """The largest size, but for one row in a hundred."""
    return float(np.percentile(abs(values), 99))
