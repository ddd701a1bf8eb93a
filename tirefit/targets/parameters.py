"""Parameter files of simulators with their own tire formula, and the car in them."""

import json
import math
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tirefit.data.vehicle.vehicle import Vehicle
from tirefit.door import read_toml
from tirefit.results import InputProblem, UsageError
from tirefit.settings import parse_settings
from tirefit.targets.code import comments
from tirefit.targets.formulas import COMMONROAD, GAZEBO, PACEJKA, SLIPX, Formula
from tirefit.targets.refit import MOST, Ranges, Refit, beyond_measured, percent, ranges_of, refit
from tirefit.targets.shape import Shape, shape_of
from tirefit.targets.tire import Tire, turned_range

_NO_LOG = {"time": "t", "x": "x", "y": "y", "yaw": "yaw"}
"""Columns of a vehicle.toml that describes a car and no log."""
_MEANING = {"h_cg": "height of the centre of gravity [m]", "wheel_radius": "tire radius [m]"}


class Axle(NamedTuple):
    """A tire at its place in the vehicle."""

    name: str  # ``front``, ``rear``, or empty for all wheels
    tire: Tire  # the fitted tire; its load is that of its place in the vehicle
    wheels: int = 1  # wheels whose force and load the fit describes together, 1 or 2
    static: bool = False  # whether the load of the tire is the static one of a vehicle
    notes: tuple[str, ...] = ()  # sentences on what was assumed

    def named(self, lines: Sequence[str]) -> list[str]:
        """Sentences with the name of the axle in front."""
        return [f"{self.name}: {line}" if self.name else line for line in lines]


def vehicle_of(path: str | os.PathLike[str], target: str, needs: Sequence[str]) -> Vehicle:
    """The car of a ``vehicle.toml``; it needs no ``[columns]`` here.

    Raises:
        UsageError: the file is wrong, or lacks keys of ``needs``; it lists all of them.
    """
    content = read_toml(Path(path))
    content.setdefault("columns", _NO_LOG)
    vehicle = parse_settings(Vehicle, content, str(path))
    UsageError.raise_for(
        [
            InputProblem(
                f"missing key {key!r}, which {target} needs", f"add {key} = ..., {_MEANING[key]}",
                str(path),
            )
            for key in needs
            if getattr(vehicle, key) is None
        ]
    )  # fmt: skip
    return vehicle


def axles_of(
    target: str, count: int, tires: Mapping[str, Tire], vehicle: Vehicle | None
) -> tuple[Axle, ...]:
    """The axles for which a target has parameters.

    Args:
        count: tires of the target, 1 or 2.
        tires: by axle; under the empty name for all wheels.

    Raises:
        UsageError: two tires for a target with one; one axle for a target with two.
    """
    if count < len(tires):
        reason = f"{target} has one tire for all wheels in a file"
        remedy = "give one of --front and --rear; export the other to its own file"
        raise UsageError(InputProblem(reason, remedy))
    if count == 2 and "" in tires:
        tires = {"front": tires[""], "rear": tires[""]}
    if len(tires) < count:
        (given,) = tires
        other = "rear" if given == "front" else "front"
        reason = f"{target} has a tire for each axle, and only the {given} one is given"
        remedy = f"give --{other} as well, or one tire without --{given} for both axles"
        raise UsageError(InputProblem(reason, remedy))
    return tuple(_placed(*item, vehicle) for item in tires.items())


def _placed(name: str, tire: Tire, vehicle: Vehicle | None) -> Axle:
    """The tire with the static load at its place."""
    if vehicle is None:
        return Axle(name, tire)
    arms = {"front": vehicle.l_r, "rear": vehicle.l_f}
    share = arms[name] / vehicle.wheelbase if name else 0.5
    static = vehicle.mass * vehicle.gravity * share
    # Fits of logs are at the load of an axle, those of rigs at that of one tire.
    wheels = 2 if "fz" in tire.measured and tire.load**2 > static**2 / 2 else 1
    load = static * wheels / 2
    what = "one tire" if wheels == 1 else "an axle of two tires"
    note = f"assumed to be a fit of {what}, whose static load is {load:.4g} N"
    return Axle(name, replace(tire, load=load), wheels, True, (note,))


SIGNS = "iso-w"
"""Signs of ranges and checks; the signs of a file are in its head."""
_NEW_LINE = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]")  # characters that may end a line


def one_line(lines: Iterable[str]) -> list[str]:
    """The lines of a comment; line ends in names or texts are removed."""
    return [_NEW_LINE.sub(" ", line) for line in lines]


class Sheet(NamedTuple):
    """The content from which a parameter file is written."""

    above: list[str]  # lines that stand first
    axles: tuple[Axle, ...]  # one, or front and rear
    fits: tuple[Refit, ...]  # of each
    vehicle: Vehicle | None  # the car, if known
    path: Path  # the file

    @property
    def values(self) -> dict[str, float]:
        """Parameters of the first axle."""
        return self.fits[0].values

    def car(self, names: str) -> dict[str, float]:
        """Numbers of the vehicle under the names of the target, given as ``m=mass
        lf=l_f``; empty without a vehicle."""
        pairs = dict(pair.split("=") for pair in names.split())
        numbers = {k: getattr(self.vehicle, ours, None) for k, ours in pairs.items()}
        return {key: value for key, value in numbers.items() if value is not None}


class ParameterFile(NamedTuple):
    """A target with its own tire formula."""

    what: str  # description of the file, with the data it needs
    holds: str  # the models that it holds, and how exactly
    formula: Formula  # the formula
    write: Callable[[Sheet], str | Mapping[str, Any]]
    """The text of the file, or the content of a YAML file; UsageError for what it cannot hold."""
    tires: int = 1  # 2 where front and rear have parameters of their own
    needs: tuple[str, ...] = ()
    """Keys of ``vehicle.toml`` that the car needs in addition to mass, yaw inertia and the
    axles."""
    ending: str = ".yaml"  # of the file


def parameter_text(
    target: str, tires: Mapping[str, Tire], path: Path, first: str,
    vehicle: str | os.PathLike[str] | None = None, over: Ranges | None = None, force: bool = False,
) -> tuple[str, Shape, tuple[str, ...]]:  # fmt: skip
    """The text of a parameter file, checks of the tire, and losses of the file.

    Args:
        tires: ``front`` and ``rear``, one of them, or ``""`` for all wheels.
        path: the file, for what its name says; first: its first line.

    Others as in :func:`tirefit.export`.

    Raises:
        UsageError: a tire that the target cannot represent, or a larger error; missing
            data of the vehicle.
    """
    kind = PARAMETER_FILES[target]
    car = None if vehicle is None else vehicle_of(vehicle, target, kind.needs)
    narrowed = turned_range(over or {}, SIGNS)
    fits, axles, notes, sentences, failed = [], [], [], [], []
    curves: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for axle in axles_of(target, kind.tires, tires, car):
        tire, (low, high) = axle.tire, narrowed.get("fz", (0.0, math.inf))
        if not axle.static and not low <= tire.load <= high:
            tire = replace(tire, load=(low + high) / 2)
        ranges = ranges_of(tire, narrowed, axle.static)
        if beyond := beyond_measured(tire, ranges, SIGNS):
            (where,) = axle.named([beyond])
            reason = f"{target} would use this tire far from where it was measured: {where}"
            if not force:
                remedy = "give a tire measured there, or another range (--over), or accept it"
                raise UsageError(InputProblem(reason, f"{remedy} by --force"))
            notes.append(f"warning: {reason}")
        fit = refit(tire, kind.formula, ranges)
        shape = shape_of(tire, kind.formula.program(fit.values, SIGNS), SIGNS)
        answers = [fit.sentence(SIGNS), *axle.notes]
        notes += axle.named(answers + _lost(tire, kind.formula))
        sentences += axle.named(shape.sentences)
        named = axle.named([*shape.curves])
        curves |= dict(zip(named, shape.curves.values(), strict=True))
        failed += axle.named(shape.failed)
        fits.append(fit)
        axles.append(axle._replace(tire=tire))
    if kind.tires > len(tires):
        notes.append("one tire was given: front and rear are alike")
    # Of a force that the file does not have, it does not matter whether it was fitted.
    absent = [f"{name} was" for tire in tires.values() for name in tire.modelled]
    absent = [words for words in absent if words.split()[0] not in kind.formula.outputs]
    notes += [n for tire in tires.values() for n in tire.notes if not n.startswith((*absent,))]
    notes += kind.formula.loss
    above = [first, *dict.fromkeys(notes)]
    above.append(f"SI units; signs of the file: {kind.formula.signs.description}")
    for name, tire in tires.items():
        above += [
            f"{name or 'tire'}: {tire.origin}",
            f"measured range ({SIGNS}): {tire.ranges(SIGNS)}",
            tire.listed.replace("parameters", "parameters of the tire", 1),
            *(f"  {line}" for line in tire.parameters()),
        ]
    above += [f"checks of the written formula, in the signs of {SIGNS}:", *sentences]
    sheet = Sheet(one_line(above), tuple(axles), tuple(fits), car, path)
    if (worst := max(fit.largest for fit in fits)) > MOST:
        missed = f"{target} differs from this tire by up to {percent(worst)} % of F_z"
        if not force:
            where = " / ".join(fit.sentence(SIGNS) for fit in fits)
            remedy = "narrow the range, as with --over fz=LOW:HIGH or --over"
            remedy += " alpha=LOW:HIGH, or write it with --force"
            reason = f"{missed}, above {percent(MOST)} %: {where}"
            raise UsageError(InputProblem(reason, remedy))
        notes.append(f"warning: {missed}")
    text = kind.write(sheet)
    if not isinstance(text, str):
        text = "\n".join([comments(sheet.above), *_yaml(text), ""])
    return text, Shape(tuple(sentences), tuple(failed), curves), tuple(notes)


def _lost(tire: Tire, formula: Formula) -> list[str]:
    """Sentences on forces and inputs of the tire that the formula does not have."""
    at = {"v": f"{tire.speed:.4g} m/s", "gamma": "no camber", "pressure": "nominal pressure"}
    beyond = [name for name in tire.modelled if name not in formula.outputs]
    needs = [name for name in tire.model.needs if name != "time"]
    absent = [name for name in formula.outputs if name not in tire.modelled]
    verb = "is" if len(beyond) == 1 else "are"
    lost = [f"{', '.join(beyond)} of the tire {verb} not included"] if beyond else []
    lost += [f"{name} is not included: forces at {at[name]}" for name in needs]
    return lost + [f"the tire has no {name}: that of the other axis" for name in absent]


def number(value: float) -> str:
    """A number in YAML 1.1, which would read 1e-05 as a text."""
    text = f"{float(value):.12g}" if abs(value) > 1e-12 else "0.0"
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


def _yaml(content: Mapping[str, Any], indent: str = "") -> list[str]:
    lines = []
    for key, value in content.items():
        if isinstance(value, Mapping):
            lines += [f"{indent}{key}:", *_yaml(value, f"{indent}  ")]
        else:
            text = json.dumps(value, ensure_ascii=False) if isinstance(value, str) else ""
            text = f"[{', '.join(map(number, value))}]" if isinstance(value, list) else text
            lines.append(f"{indent}{key}: {text or number(value)}")
    return lines


_CAR = "m=mass lf=l_f lr=l_r I_z=yaw_inertia h_s=h_cg"


_SLIPX_MOST = {"nominal_load": 200.0, "c_alpha": 2000.0, "c_kappa": 5000.0, "mu_x0": 3.0}
"""Largest values allowed by the schema of slipx 0.2.0, per tire."""


def _slipx(sheet: Sheet) -> dict[str, Any]:
    (axle,), values = sheet.axles, sheet.values
    compound, _, surface = sheet.path.stem.partition("_")
    problems = []
    if compound not in ("sponge", "rubber") or not surface:
        reason = "SlipX reads compound and surface from the name of the file"
        remedy = "name it sponge_SURFACE.yaml or rubber_SURFACE.yaml"
        problems.append(InputProblem(reason, remedy, str(sheet.path)))
    for name, most in _SLIPX_MOST.items():
        if (value := values[name] / (1 if name == "mu_x0" else axle.wheels)) > most:
            reason = f"{name} is {value:.4g}, and SlipX allows up to {most:g}"
            remedy = "SlipX is for 1:10 cars: export to another target, see --list"
            problems.append(InputProblem(reason, remedy))
    UsageError.raise_for(problems)
    version, length = {"schema_version": "0.2.0"}, axle.tire.relaxation
    return {
        **version,
        "compound": compound,
        "surface": surface,
        "nominal_load": values["nominal_load"] / axle.wheels,
        "linear": {name: values[name] / axle.wheels for name in ("c_alpha", "c_kappa")},
        "friction": {name: values[name] for name in ("mu_y0", "mu_x0", "k_mu")},
        "mf_lite": {name: values[name] for name in "CE"},
        **({"relaxation": {"sigma": length}} if length else {}),
        "provenance": {
            **version,
            # "identified" is for fits by its own tool, with an error of each parameter.
            "label": "provisional",
            "source": axle.tire.origin[:500],
            "method": f"{sheet.above[0]}: {sheet.fits[0].sentence(SIGNS)}"[:2000],
            "date": date.today().isoformat(),
        },
    }


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
    values = sheet.values | sheet.car("radius=wheel_radius")
    values["wheel_normal_force"] /= sheet.axles[0].wheels
    numbers = {name: number(value) for name, value in values.items()}
    # An XML comment must not contain two hyphens.
    above = "\n".join(sheet.above).replace("--", "- -")
    text = _GAZEBO.format(**{"radius": "RADIUS in m", **numbers})
    return f"<!--\n{above}\n-->\n{text}"


_EXACT = "a Magic Formula of pure slip exactly; other models refitted"
_ONE, _TWO = f"{_EXACT}, one tire for all wheels", f"F_y of {_EXACT}, front and rear"

PARAMETER_FILES: dict[str, ParameterFile] = {
    "commonroad": ParameterFile(
        "parameters_tire.yaml of CommonRoad's STD and MB models", _ONE,
        COMMONROAD,
        lambda sheet: {"tire": sheet.values} | sheet.car(
            "m=mass a=l_f b=l_r I_z=yaw_inertia h_s=h_cg h_cg=h_cg R_w=wheel_radius"
        ),
        needs=("h_cg", "wheel_radius"),
    ),
    "gymkhana": ParameterFile(
        "parameters of Gym-Khana's STD and MB models, tire_p_cx1 and others",
        _ONE, COMMONROAD,
        lambda sheet: {f"tire_{name}": value for name, value in sheet.values.items()}
        | sheet.car(f"{_CAR} R_w=wheel_radius"),
        needs=("h_cg", "wheel_radius"),
    ),
    "gymkhana-stp": ParameterFile(
        "parameters of Gym-Khana's STP model, B_f to E_r", _TWO, PACEJKA,
        lambda sheet: {"mu": 1.0} | {
            f"{name}_{axle}": value
            for axle, fit in zip("fr", sheet.fits, strict=True)
            for name, value in fit.values.items()
        } | sheet.car(_CAR),
        tires=2, needs=("h_cg",),
    ),
    "forzaeth": ParameterFile(
        "ForzaETH's NAME_pacejka: C_Pf, C_Pr = [B, C, D, E] and the car", _TWO,
        PACEJKA,
        lambda sheet: {
            f"C_P{axle}": list(fit.values.values())
            for axle, fit in zip("fr", sheet.fits, strict=True)
        } | sheet.car("m=mass I_z=yaw_inertia l_f=l_f l_r=l_r l_wb=wheelbase h_cg=h_cg")
        | {"tire_model": "pacejka", "mu": 1.0},
        tires=2, needs=("h_cg",),
    ),
    "slipx": ParameterFile(
        "tyre file of SlipX, named COMPOUND_SURFACE.yaml",
        "F_y of pure slip refitted; slope and peak of F_x", SLIPX, _slipx,
    ),
    "gazebo": ParameterFile(
        "slip compliances of Gazebo's WheelSlip system and friction of ODE",
        "slope at zero slip and peak of both forces", GAZEBO, _gazebo,
        needs=("wheel_radius",), ending=".sdf",
    ),
}  # fmt: skip
"""Target -> its parameter file."""
