"""Parameter files of simulators that have a tire formula of their own."""

import os
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import NamedTuple

from tirefit.data.vehicle import Vehicle
from tirefit.results import InputProblem, UsageError
from tirefit.targets.car import Axle, axles_of, vehicle_of
from tirefit.targets.formulas import (
    COMMONROAD,
    GAZEBO,
    PACEJKA,
    SLIPX,
    Formula,
)
from tirefit.targets.loss import MOST
from tirefit.targets.refit import SPEED, Ranges, Refit, percent, ranges_of, refit
from tirefit.targets.shape import Shape, shape_of
from tirefit.targets.tire import Tire, turned_range

SIGNS = "iso-w"
"""Signs in which ranges and checks are stated; a file's own are in its head."""


_NEW_LINE = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]")
"""Characters that may end a line."""


def one_line(lines: Iterable[str]) -> list[str]:
    """Lines of a comment: a line of a file's name or text does not end one."""
    return [_NEW_LINE.sub(" ", line) for line in lines]


class Sheet(NamedTuple):
    """What a parameter file is written from.

    Attributes:
        above: lines that stand first.
        axles: one, or front and rear.
        fits: of each.
        vehicle: the car, if known.
        path: the file.
    """

    above: list[str]
    axles: tuple[Axle, ...]
    fits: tuple[Refit, ...]
    vehicle: Vehicle | None
    path: Path


class ParameterFile(NamedTuple):
    """A target with a tire formula of its own.

    Attributes:
        ending: of the file.
        what: what the file is, and what it needs.
        holds: the models that it holds, and how exactly.
        formula: the formula.
        write: the text of the file.
        tires: 2 where front and rear have parameters of their own.
        needs: keys of ``vehicle.toml`` that the car needs beside mass, yaw inertia and
            the axles.
        check: raises UsageError for what the file cannot hold.
    """

    ending: str
    what: str
    holds: str
    formula: Formula
    write: Callable[[Sheet], str]
    tires: int = 1
    needs: tuple[str, ...] = ()
    check: Callable[[Sheet], None] = lambda sheet: None


class Written(NamedTuple):
    """A file's text, how the tire behaves, and what it does not hold."""

    text: str
    shape: Shape
    notes: tuple[str, ...]


def parameter_text(
    target: str,
    tires: Mapping[str, Tire],
    path: Path,
    first: str,
    vehicle: str | os.PathLike | None = None,
    over: Ranges | None = None,
    force: bool = False,
) -> Written:
    """The text of a parameter file.

    Args:
        target: a key of :data:`PARAMETER_FILES`.
        tires: ``front`` and ``rear``, one of them, or ``""`` for all wheels.
        path: the file, for what its name says.
        first: the first line.
        vehicle: ``vehicle.toml``; its car is written where the target has one.
        over: kappa, alpha and fz of the refit, in the signs of :data:`SIGNS`.
        force: write a file that misses by more than :data:`~tirefit.targets.loss.MOST`.

    Raises:
        UsageError: what the target cannot hold, or a larger miss; data of the vehicle
            that are missing.
    """
    kind = PARAMETER_FILES[target]
    car = None if vehicle is None else vehicle_of(Path(vehicle), target, kind.needs)
    narrowed = turned_range(over or {}, SIGNS)
    axles = tuple(
        _within(axle, narrowed) for axle in axles_of(target, kind.tires, tires, car)
    )
    fits = tuple(
        refit(one.tire, kind.formula, ranges_of(one.tire, narrowed, one.static))
        for one in axles
    )
    shapes = [
        shape_of(one.tire, fit.program(SIGNS), SIGNS)
        for one, fit in zip(axles, fits, strict=True)
    ]
    notes, sentences = [], []
    for axle, fit, behaviour in zip(axles, fits, shapes, strict=True):
        told = [fit.sentence(SIGNS), *fit.other_loads(), *axle.notes]
        told += _lost(axle.tire, kind.formula)
        notes += [axle.named(line) for line in told]
        sentences += [axle.named(line) for line in behaviour.sentences]
    notes += [note for tire in tires.values() for note in tire.notes]
    notes += kind.formula.loss
    signs = f"SI units; signs of the file: {kind.formula.signs.description}"
    about = [line for name, tire in tires.items() for line in _about(name, tire)]
    checks = f"checks of the written formula, in the signs of {SIGNS}:"
    above = one_line([first, *notes, signs, *about, checks, *sentences])
    sheet = Sheet(above, axles, fits, car, path)
    kind.check(sheet)
    worst = max(fit.largest for fit in fits)
    if worst > MOST:
        if not force:
            raise _refused(target, worst, fits)
        notes.append(
            f"warning: {target} misses this tire by up to {percent(worst)} % of F_z"
        )
    shape = Shape(tuple(sentences), all(one.sound for one in shapes))
    return Written(kind.write(sheet), shape, tuple(notes))


def _within(axle: Axle, over: Ranges) -> Axle:
    """The axle with a nominal load within the loads that were asked for."""
    low, high = over.get("fz", (axle.tire.load, axle.tire.load))
    if axle.static or low <= axle.tire.load <= high:
        return axle
    return axle._replace(tire=replace(axle.tire, load=(low + high) / 2))


def _about(name: str, tire: Tire) -> list[str]:
    return [
        f"{name or 'tire'}: {tire.origin}",
        f"measured range ({SIGNS}): {tire.ranges(SIGNS)}",
        "parameters of the tire (+- standard error):",
        *(f"  {line}" for line in tire.parameters()),
    ]


_TAKEN_AT = {
    "v": f"{SPEED:g} m/s", "gamma": "no camber", "pressure": "nominal pressure",
}  # fmt: skip


def _lost(tire: Tire, formula: Formula) -> list[str]:
    """Forces and inputs of the tire that have no place in the formula."""
    beyond = [name for name in tire.modelled if name not in formula.outputs]
    needs = [name for name in tire.model.needs if name != "time"]
    absent = [name for name in formula.outputs if name not in tire.modelled]
    lost = [f"{', '.join(beyond)} of the tire has no place"] if beyond else []
    lost += [f"{name} has no place: forces at {_TAKEN_AT[name]}" for name in needs]
    lost += [f"the tire has no {name}: that of the other axis" for name in absent]
    return lost


def _refused(target: str, worst: float, fits: tuple[Refit, ...]) -> UsageError:
    reason = (
        f"{target} misses this tire by up to {percent(worst)} % of F_z, above"
        f" {percent(MOST)} %: {' / '.join(fit.sentence(SIGNS) for fit in fits)}"
    )
    remedy = (
        "narrow the range, as with --over fz=LOW:HIGH or --over alpha=LOW:HIGH, or"
        " write it with --force"
    )
    return UsageError(InputProblem(reason, remedy))


# --- texts --------------------------------------------------------------------------


def _number(value: float) -> str:
    """A number that YAML 1.1 reads as one: 1e-05 would be a word."""
    text = f"{float(value):.12g}" if abs(value) > 1e-12 else "0.0"
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


def _yaml(above: list[str], content: Mapping, indent: str = "") -> str:
    lines = [f"# {line}" for line in above]
    for key, value in content.items():
        if isinstance(value, Mapping):
            lines += [f"{indent}{key}:", _yaml([], value, indent + "  ").rstrip("\n")]
        elif isinstance(value, str):
            quoted = value.replace("\\", "\\\\").replace('"', '\\"')
            lines.append(f'{indent}{key}: "{quoted}"')
        elif isinstance(value, list | tuple):
            lines.append(f"{indent}{key}: [{', '.join(map(_number, value))}]")
        else:
            lines.append(f"{indent}{key}: {_number(value)}")
    return "\n".join(lines) + "\n"


def _car(sheet: Sheet, names: Mapping[str, str]) -> dict[str, float]:
    """Numbers of the vehicle under the target's names; none without a vehicle."""
    if sheet.vehicle is None:
        return {}
    found = {key: getattr(sheet.vehicle, ours) for key, ours in names.items()}
    return {key: value for key, value in found.items() if value is not None}


def _commonroad(sheet: Sheet) -> str:
    names = {
        "m": "mass", "a": "l_f", "b": "l_r", "I_z": "yaw_inertia", "h_s": "h_cg",
        "h_cg": "h_cg", "R_w": "wheel_radius",
    }  # fmt: skip
    return _yaml(sheet.above, {"tire": sheet.fits[0].values, **_car(sheet, names)})


def _gymkhana(sheet: Sheet) -> str:
    tire = {f"tire_{name}": value for name, value in sheet.fits[0].values.items()}
    names = {
        "m": "mass", "lf": "l_f", "lr": "l_r", "I_z": "yaw_inertia", "h_s": "h_cg",
        "R_w": "wheel_radius",
    }  # fmt: skip
    return _yaml(sheet.above, tire | _car(sheet, names))


def _gymkhana_stp(sheet: Sheet) -> str:
    tire = {
        f"{name}_{axle}": fit.values[name]
        for axle, fit in zip("fr", sheet.fits, strict=True)
        for name in "BCDE"
    }
    names = {"m": "mass", "lf": "l_f", "lr": "l_r", "I_z": "yaw_inertia", "h_s": "h_cg"}
    return _yaml(sheet.above, {"mu": 1.0, **tire, **_car(sheet, names)})


def _forzaeth(sheet: Sheet) -> str:
    tire = {
        f"C_P{axle}": [fit.values[name] for name in "BCDE"]
        for axle, fit in zip("fr", sheet.fits, strict=True)
    }
    names = {
        "m": "mass", "I_z": "yaw_inertia", "l_f": "l_f", "l_r": "l_r",
        "l_wb": "wheelbase", "h_cg": "h_cg",
    }  # fmt: skip
    head = {"tire_model": "pacejka", "mu": 1.0}
    return _yaml(sheet.above, {**tire, **_car(sheet, names), **head})


def _slipx(sheet: Sheet) -> str:
    (axle,), values = sheet.axles, sheet.fits[0].values
    length = axle.tire.relaxation
    compound, _, surface = sheet.path.stem.partition("_")
    version = {"schema_version": "0.2.0"}
    provenance = {
        # Its "identified" is for fits by its own tool, with an error of each parameter.
        "label": "provisional",
        "source": axle.tire.origin[:500],
        "method": f"{sheet.above[0]}: {sheet.fits[0].sentence(SIGNS)}"[:2000],
        "date": date.today().isoformat(),
    }
    content = {
        **version, "compound": compound, "surface": surface,
        "nominal_load": values["nominal_load"] / axle.wheels,
        "linear": {
            name: values[name] / axle.wheels for name in ("c_alpha", "c_kappa")
        },
        "friction": {name: values[name] for name in ("mu_y0", "mu_x0", "k_mu")},
        "mf_lite": {name: values[name] for name in "CE"},
        **({"relaxation": {"sigma": length}} if length else {}),
        "provenance": version | provenance,
    }  # fmt: skip
    return _yaml(sheet.above, content)


_SLIPX_MOST = {
    "nominal_load": 200.0,
    "c_alpha": 2000.0,
    "c_kappa": 5000.0,
    "mu_x0": 3.0,
}
"""Largest values of the schema of slipx 0.2.0, per tire."""


def _slipx_check(sheet: Sheet) -> None:
    compound, _, surface = sheet.path.stem.partition("_")
    problems = []
    if compound not in ("sponge", "rubber") or not surface:
        reason = "SlipX reads compound and surface from the name of the file"
        remedy = "name it sponge_SURFACE.yaml or rubber_SURFACE.yaml"
        problems.append(InputProblem(reason, remedy, str(sheet.path)))
    values = sheet.fits[0].values
    for name, most in _SLIPX_MOST.items():
        value = values[name] / (1 if name == "mu_x0" else sheet.axles[0].wheels)
        if value > most:
            reason = f"{name} is {value:.4g}, and SlipX allows up to {most:g}"
            remedy = "SlipX is for cars of 1:10: export to another target, see --list"
            problems.append(InputProblem(reason, remedy))
    if problems:
        raise UsageError(problems)


_GAZEBO = """\
<model name="car">
  <link name="WHEEL">
    <collision name="collision">
      <surface><friction><ode>
        <mu>{mu}</mu>
        <mu2>{mu2}</mu2>
        <fdir1>0 0 1</fdir1>
      </ode></friction></surface>
    </collision>
  </link>
  <plugin filename="gz-sim-wheel-slip-system" name="gz::sim::systems::WheelSlip">
    <wheel link_name="WHEEL">
      <slip_compliance_lateral>{slip_compliance_lateral}</slip_compliance_lateral>
      <slip_compliance_longitudinal>{slip_compliance_longitudinal}\
</slip_compliance_longitudinal>
      <wheel_normal_force>{wheel_normal_force}</wheel_normal_force>
      <wheel_radius>{radius}</wheel_radius>
    </wheel>
  </plugin>
</model>
"""


def _gazebo(sheet: Sheet) -> str:
    (axle,), values = sheet.axles, dict(sheet.fits[0].values)
    values["wheel_normal_force"] /= axle.wheels
    radius = "RADIUS in m"
    if sheet.vehicle is not None and sheet.vehicle.wheel_radius is not None:
        radius = _number(sheet.vehicle.wheel_radius)
    # No comment of XML may hold two hyphens.
    above = "\n".join(sheet.above).replace("--", "- -")
    numbers = {name: _number(value) for name, value in values.items()}
    return f"<!--\n{above}\n-->\n" + _GAZEBO.format(radius=radius, **numbers)


_REFITTED = "a Magic Formula of pure slip exactly; other models refitted"

PARAMETER_FILES: dict[str, ParameterFile] = {
    "commonroad": ParameterFile(
        ".yaml", "parameters_tire.yaml of CommonRoad's STD and MB models",
        f"{_REFITTED}, one tire for all wheels", COMMONROAD, _commonroad,
        needs=("h_cg", "wheel_radius"),
    ),
    "gymkhana": ParameterFile(
        ".yaml", "parameters of Gym-Khana's STD and MB models, tire_p_cx1 and others",
        f"{_REFITTED}, one tire for all wheels", COMMONROAD, _gymkhana,
        needs=("h_cg", "wheel_radius"),
    ),
    "gymkhana-stp": ParameterFile(
        ".yaml", "parameters of Gym-Khana's STP model, B_f to E_r",
        f"F_y of {_REFITTED}, front and rear",
        PACEJKA, _gymkhana_stp, tires=2, needs=("h_cg",),
    ),
    "forzaeth": ParameterFile(
        ".yaml", "ForzaETH's NAME_pacejka: C_Pf, C_Pr = [B, C, D, E] and the car",
        f"F_y of {_REFITTED}, front and rear",
        PACEJKA, _forzaeth, tires=2, needs=("h_cg",),
    ),
    "slipx": ParameterFile(
        ".yaml", "tyre file of SlipX, named COMPOUND_SURFACE.yaml",
        "F_y of pure slip refitted; slope and peak of F_x", SLIPX, _slipx,
        check=_slipx_check,
    ),
    "gazebo": ParameterFile(
        ".sdf", "slip compliances of Gazebo's WheelSlip system and friction of ODE",
        "slope at zero slip and peak of both forces", GAZEBO, _gazebo,
        needs=("wheel_radius",),
    ),
}  # fmt: skip
"""Target -> its parameter file."""
