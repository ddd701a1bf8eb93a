"""Identify the columns of a file: declared by the user, or inferred and reported."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from tirefit.data.declared import DECLARED_BY, Options
from tirefit.data.table import CANONICAL, FORCES, SIMULATED, WHEELS, Layout
from tirefit.data.units import (
    MEANING_OF_SLIP,
    Unit,
    base_column,
    dimension_of,
    known_unit,
    resolve_unit,
)
from tirefit.results import DataError, InputProblem, did_you_mean
from tirefit.slip import SLIP_DEFINITIONS

_NAMES = {
    "time": "time t elapsed elapsedtime et",
    "sigma_x": "sigmax sigma σ σx physicalslip",
    "kappa": "kappa κ lambda λ sr slip slipx longslip longitudinalslip practicalslip",
    "s": "s",
    "slip_ratio": "slipratio",
    "alpha": "alpha α sa slipangle",
    "omega": "omega ω wheelangularvelocity wheelangularspeed angularvelocity",
    "fx": "fx forcex longforce longitudinalforce",
    "fy": "fy forcey latforce lateralforce sideforce",
    "fz": "fz forcez load wheelload verticalload normalload verticalforce normalforce",
    "mz": "mz momentz aligningmoment aligningtorque selfaligningmoment selfaligningtorque",
    "mx": "mx momentx overturningmoment overturningcouple overturningtorque",
    "my": "my momenty rollingresistance rollingresistancemoment"
    " rollingresistancetorque rollingmoment",
    "v": "v vx speed velocity forwardspeed forwardvelocity",
    "torque": "torque braketorque brakingtorque",
    "gamma": "gamma γ ia camber camberangle inclination inclinationangle",
    "pressure": "pressure p inflationpressure tirepressure tyrepressure",
    "brake_pressure": "brakepressure",
    "temperature": "temperature temp tstc tiretemperature tyretemperature",
    "alpha_rate": "alpharate sliprate slipanglerate",
    "steering_rate": "steeringrate roadwheelanglerate",
    "a_x": "ax accelx accelerationx longacc inlineacc longitudinalacceleration",
    "a_y": "ay accely accelerationy latacc lateralacc lateralacceleration",
    "yaw_rate": "yawrate yawvelocity",
    "yaw_acceleration": "yawacceleration yawaccel",
    "heading": "heading yaw yawangle",
    "x": "x xposition positionx",
    "y": "y yposition positiony",
    "steering": "steering steer roadwheelangle",
    "roll_rate": "rollrate",
    "offset": "offset crosstrack lateraloffset",
    "road_heading": "roadheading",
    **{f"{kind}_{w}": f"{kind}{w}" for kind in ("omega", "torque") for w in WHEELS},
    "run": "run runid runno runnumber",
}
_ALIASES = {alias: name for name, names in _NAMES.items() for alias in names.split()}

IsKnown = Callable[[str], bool]
"""Whether a name is that of a known column."""

_STD_WORDS = {"std", "sd", "stdev", "stddev"}
_SIM_WORDS = {"sim", "simulated"}
_BRACKETED = re.compile(r"^(.*?)\s*[\[({<]([^\])}>]*)[\])}>]\s*$")
_NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*")
_SEPARATORS = r"[\s_/,:.\-]+"

_LONGEST = 200  # characters of the longest header; a longer text is a line that was not split


class Guess(NamedTuple):
    """The meaning of a header: the name of the column and, if stated, its unit."""

    name: str
    unit: str | None


@dataclass(frozen=True)
class Column:
    """One column to read."""

    name: str  # canonical, or a slip definition
    header: str
    index: int
    unit_text: str = ""
    unit: Unit | None = None  # None for ``run`` and if the stated one was refused
    beside: bool = False  # whether the unit is stated elsewhere than in the header
    note: str = ""  # sentence on how it is read


@dataclass
class Plan:
    """The columns to read, by name (the slip column under its definition)."""

    file: str = ""
    columns: dict[str, Column] = field(default_factory=dict)
    assumptions: list[str] = field(default_factory=list)
    problems: list[InputProblem] = field(default_factory=list)
    units_to_write: dict[str, str] = field(default_factory=dict)
    """Declared units of forces that the file lacks because they will be predicted."""

    def problem(self, reason: str, remedy: str, column: str | None = None) -> None:
        """Add a problem."""
        self.problems.append(InputProblem(reason, remedy, self.file, column=column))

    @property
    def slip(self) -> str | None:
        """Definition of the slip column, or None without one."""
        return next((name for name in self.columns if name in SLIP_DEFINITIONS), None)


def guess(header: str) -> Guess | None:
    """Name and unit that a header states, or None. ``Fx_std_N`` is fx_std in N, and
    ``Fx_sim`` the fx of a simulator."""
    if len(header) > _LONGEST:
        return None
    bracketed = _BRACKETED.match(header)
    text, unit = bracketed.groups() if bracketed else (header, None)
    words = [word for word in re.split(_SEPARATORS, text.strip()) if word]
    folded = {word.casefold() for word in words}
    is_std, is_sim = bool(folded & _STD_WORDS), bool(folded & _SIM_WORDS)
    words = [w for w in words if w.casefold() not in _STD_WORDS | _SIM_WORDS]
    for count in range(len(words), 0, -1):
        name = _ALIASES.get("".join(words[:count]).casefold())
        suffix = "/".join(words[count:])
        if name is None or (suffix and (unit is not None or not _fits(suffix, name))):
            continue
        stated = unit if unit is not None else suffix or None
        if name == "run" and (is_std or stated is not None):
            return None
        # "mx" may be a magnetic field, "rolling resistance" a force.
        if name in ("mx", "my") and stated is not None and not _fits(stated, name):
            return None
        if is_sim:
            name = f"{name}_sim"
            return None if is_std or name not in SIMULATED else Guess(name, stated)
        return Guess(f"{name}_std" if is_std else name, stated)
    return None


def stated_unit(header: str) -> str | None:
    """The unit that a header states, as ``[km/h]`` of ``v [km/h]``; None without."""
    guessed, bracketed = guess(header), _BRACKETED.match(header)
    return guessed.unit if guessed else bracketed and bracketed.group(2)


def is_number(text: str) -> bool:
    """Whether a cell is a plain decimal number (not nan, inf or 1_000)."""
    return _NUMBER.fullmatch(text) is not None


def _fits(suffix: str, name: str) -> bool:
    """Whether the end of a header is a unit of that column (``1`` is a number)."""
    unit = None if suffix == "1" or name == "run" else known_unit(suffix)
    return unit is not None and unit.dimension == dimension_of(name)


def _group(name: str) -> str:
    """The names of the same quantity: all slip definitions are one group."""
    if base_column(name) not in SLIP_DEFINITIONS:
        return name
    return "slip_std" if name.endswith("_std") else "slip"


def plan_columns(
    headers: Sequence[str],
    units_row: Sequence[str] | None,
    options: Options,
    file: str,
    layout: Layout,
) -> Plan:
    """Decide which columns to read, with which name and unit.

    Args:
        headers: header of each column of the file, in its order.
        units_row: the unit of each column from a row under the header, if it exists.
        options: the declarations of the user.
        file: named in the problems.
        layout: columns that the kind of file defines; headers decide on the others.

    Returns:
        The plan, with all problems, and with a sentence for every inference.
    """
    plan = Plan(file)
    declared = _declared(headers, options, plan)
    inferred = _inferred(headers, declared, plan, layout.names)
    groups = {_group(name) for name in declared | inferred}
    for name in list(inferred):
        if name.endswith("_std") and _group(name).removesuffix("_std") not in groups:
            header, owner = headers[inferred.pop(name)], base_column(name)
            plan.assumptions.append(f"column {header!r} not used: there is no {owner}")
    chosen = declared | inferred
    names = {_group(name): name for name in chosen}
    slip, std = names.get("slip"), names.get("slip_std")
    if slip and std and std != f"{slip}_std":  # a std is not convertible
        reason = f"read as {std}, but the slip column is {slip}"
        remedy = f"declare both by one definition, as with --column {slip}_std=HEADER"
        plan.problem(reason, remedy, headers[chosen[std]])
    stated = {
        index: (text.strip().strip("[](){}"), f" ({layout.units_from})")
        for index, text in enumerate(units_row or ())
        if text.strip()
    }
    for name, index in chosen.items():
        named = options.slip if options.slip and _group(name) == "slip" else name
        unit_text, how = _unit_of(name, headers, stated, options, chosen)
        beside = stated.get(index) == (unit_text, how)
        unit = f" in {unit_text}{how}" if named != "run" else ""
        if named in SLIP_DEFINITIONS and headers[index].casefold() != named:
            unit = f" = {MEANING_OF_SLIP[named]}{unit}"
        ending = ", as declared" if name in declared or named != name else ""
        note = f"column {headers[index]!r} read as {named}{unit}{ending}"
        column = Column(named, headers[index], index, unit_text, beside=beside, note=note)
        plan.columns[named] = _with_unit(column, plan)
    _check_all_used(options, plan)
    ignored = [h for i, h in enumerate(headers) if h and i not in chosen.values()]
    listed = ", ".join(map(repr, ignored))
    plan.assumptions += [f"columns not read: {listed}"] if ignored else []
    return plan


def _declared(headers: Sequence[str], options: Options, plan: Plan) -> dict[str, int]:
    """Declared name -> index of its column, with problems of those that do not exist, of one
    header declared as two columns, and of two slip columns."""
    place_of: dict[str, int] = {}
    folded = [header.casefold() for header in headers]
    for name, header in options.columns.items():
        wanted = header.strip()
        places = [i for i, h in enumerate(headers) if h == wanted]
        places = places or [i for i, h in enumerate(folded) if h == wanted.casefold()]
        if len(places) == 1:
            place_of[name] = places[0]
        elif places:
            reason = f"the header occurs {len(places)} times ({_places(places)})"
            plan.problem(reason, "rename one of them in the file", header)
        elif _is_predicted(name, options):
            plan.assumptions.append(f"column {header!r} ({name}) is not there")
        else:
            how = f"declared as {name} by {DECLARED_BY['columns']}"
            there = f"columns found: {', '.join(map(repr, headers))}"
            remedy = did_you_mean(wanted, headers) + there
            plan.problem(f"the file has no such column ({how})", remedy, header)
    for number, (name, place) in enumerate(place_of.items()):
        for other in list(place_of)[:number]:
            if place_of[other] == place or _group(other) == _group(name):
                reason = f"declared as {name}, but {other} is declared as well"
                remedy = f"give only one of --column {name}= and --column {other}="
                plan.problem(reason, remedy, headers[place])
                break
    return place_of


def _inferred(
    headers: Sequence[str], declared: Mapping[str, int], plan: Plan, names: Mapping[str, str]
) -> dict[str, int]:
    """Inferred name -> index of its column, by the names of the layout, else by the header."""
    taken = {_group(name) for name in declared}
    by_group: dict[str, list[tuple[str, int]]] = {}
    for index, header in enumerate(headers):
        name = names.get(header)
        guessed = guess(header) if name is None else (Guess(name, None) if name else None)
        guessed = None if index in declared.values() else guessed
        if guessed and _group(guessed.name) not in taken:
            by_group.setdefault(_group(guessed.name), []).append((guessed.name, index))
    if "heading" not in {*by_group, *taken}:
        # x and y are positions only if there is a heading as well.
        by_group = {n: at for n, at in by_group.items() if n not in ("x", "y")}
    for matches in by_group.values():
        if len(matches) < 2:
            continue
        listed = " and ".join(repr(headers[index]) for _, index in matches)
        places = _places([index for _, index in matches])
        name, index = matches[0]
        meant = " and ".join(dict.fromkeys(match for match, _ in matches))
        reason = f"duplicate column: {listed} all mean {meant} ({places})"
        remedy = f'choose one: columns.{name} = "{headers[index]}" or --column {name}='
        if len({headers[index] for _, index in matches}) == 1:
            remedy = "rename or remove one of them in the file"
        plan.problem(reason, remedy, headers[index])
    # The first of duplicates is kept, so that its cells are checked as well.
    return dict(matches[0] for matches in by_group.values())


def _places(indices: Sequence[int]) -> str:
    """Numbers of columns, from 1, to distinguish columns with the same header."""
    return f"columns {' and '.join(str(index + 1) for index in indices)}"


def _unit_of(
    name: str,
    headers: Sequence[str],
    stated: Mapping[int, tuple[str, str]],
    options: Options,
    chosen: Mapping[str, int],
) -> tuple[str, str]:
    """Unit text of a column and, if it was not stated, how it was found. Any name of a slip
    column stands for the slip column."""
    if name == "run":
        return "", ""
    index = chosen[name]
    in_header = stated_unit(headers[index])
    if same := [key for key in options.units if _group(key) == _group(name)]:
        declared = options.units[name if name in same else same[0]]
        other = in_header not in (None, declared)
        return declared, f" (declared; the header says {in_header!r})" if other else ""
    if in_header is not None:
        return in_header, ""
    if index in stated:
        return stated[index]
    if name.endswith("_std") or name in SIMULATED:
        group = _group(name).removesuffix("_std").removesuffix("_sim")
        owner = next((n for n in chosen if _group(n) == group), None)
        if owner is not None:
            text = _unit_of(owner, headers, stated, options, chosen)[0]
            text = text if name in SIMULATED else text.removeprefix("-") or "-"
            return text, f" (the unit of {owner})"
    canonical = CANONICAL.get(base_column(name), ("-", ""))[0]
    return canonical, "" if headers[index] == name else " (no unit stated)"


def _is_predicted(name: str, options: Options) -> bool:
    """Whether a column may be missing, as it is a force that will be predicted."""
    return not options.forces and base_column(name) in FORCES


def _with_unit(column: Column, plan: Plan) -> Column:
    if column.name == "run":
        return column
    try:
        return replace(column, unit=resolve_unit(column.unit_text, column.name))
    except DataError as error:
        plan.problems += [replace(p, file=plan.file, column=column.header) for p in error.problems]
        return column


def _check_all_used(options: Options, plan: Plan) -> None:
    """Problems of units and definitions declared for columns that are not read."""
    groups = {_group(name) for name in plan.columns}
    for group in ("slip", "slip_std"):
        units = {n: unit for n, unit in options.units.items() if _group(n) == group}
        if len(set(units.values())) > 1:
            listed = ", ".join(f"{name}={unit}" for name, unit in units.items())
            reason = f"two units of the slip column ({DECLARED_BY['units']}): {listed}"
            plan.problem(reason, "declare one of them")
    declared = [("units", name) for name in options.units]
    declared += [("slip", options.slip)] if options.slip else []
    for option, name in declared:
        if _group(name) in groups:
            continue
        if option == "units" and _is_predicted(name, options):
            column = _with_unit(Column(name, name, -1, options.units[name]), plan)
            plan.units_to_write |= {name: column.unit_text} if column.unit else {}
        else:
            reason = f"declared by {DECLARED_BY[option]} for {name}, which the file does not have"
            plan.problem(reason, f"remove it, or name the column with --column {name}=HEADER", name)
