"""The tire to export: its function, its origin and the measured ranges."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp

from tirefit.arrays import Numbers
from tirefit.data.tir.tir import TirFile
from tirefit.data.tir.tir_keys import LIMITS
from tirefit.fitting.source import GivenTire, given_tire
from tirefit.fitting.tir import TIR_SIGNS, remarks
from tirefit.models import AbstractTire, CombinedMagicFormula, MagicFormula, TireInputs, modelled
from tirefit.models.lugre import AbstractLuGre
from tirefit.models.mf import MFTire
from tirefit.models.relaxation import Relaxed
from tirefit.params import check_names, parameter_values, specs, with_values
from tirefit.precision import require_x64
from tirefit.results import UsageError
from tirefit.slip import CONVENTIONS, LOCKED, kappa_from_sigma
from tirefit.targets.program import Program, traced

# Modules that read fits and diagnoses take longer to import than a .tir file to export.
if TYPE_CHECKING:
    from tirefit.diagnosis.summary.result import Diagnosis
    from tirefit.fitting.mf.result import MagicFormulaFit
    from tirefit.fitting.result import FitResult
    from tirefit.fitting.store import StoredFit

    Fit = FitResult | MagicFormulaFit | StoredFit

INPUTS = ("kappa", "alpha", "fz", "v", "gamma", "pressure")
"""Arguments of an exported tire, in order: practical slip [-], slip angle [rad], load
[N]; then speed [m/s], camber [rad], pressure [Pa], if they change a force."""
ALWAYS = 3
"""The number of the first of them that every exported tire has."""
USUAL_SLIP = 0.3  # largest kappa and slip angle [rad] of a comparison, if none was measured
USUAL_SHARES = (0.5, 0.75, 1.0, 1.25, 1.5)  # its loads over the nominal load
_USUAL_LOAD = 4000.0  # default load [N], of a tire of a passenger car
_SPEED = 10.0  # speed [m/s] at which tires are compared if it was measured, or nothing was

QUANTITIES = {
    "kappa": ("", "practical slip: sliding speed over forward speed of the wheel centre"),
    "alpha": ("rad", "slip angle"),
    "fz": ("N", "load"),
    "v": ("m/s", "forward speed of the wheel centre"),
    "gamma": ("rad", "camber"),
    "pressure": ("Pa", "inflation pressure (0: nominal)"),
    "fx": ("N", "longitudinal force"),
    "fy": ("N", "lateral force"),
    "mz": ("N m", "aligning moment"),
    "mx": ("N m", "overturning moment"),
    "my": ("N m", "rolling resistance moment"),
}
"""Input or output of an exported tire -> its unit, empty if it has none, and meaning."""


@dataclass(frozen=True)
class Tire:
    """A tire to export."""

    model: AbstractTire  # steady-state tire with its values
    name: str  # of the model
    origin: str  # sentences on where it comes from
    load: float  # a usual load [N], at which the tire is checked
    spread: Mapping[str, float] = field(default_factory=dict)
    """Standard errors of the fitted parameters."""
    measured: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """(smallest, largest) value of the known ones of :data:`INPUTS`, in canonical signs."""
    notes: tuple[str, ...] = ()  # sentences on what was assumed
    bare: AbstractTire | None = None
    """The model without the effects of a diagnosis; None if it has none."""
    tir: TirFile | None = None  # the file that states the model, for targets that write one
    relaxation: float | None = None
    """Relaxation length [m], which is not in the forces; None without."""
    asked: tuple[str, ...] = ()  # forces and moments to export; empty for all
    fitted: tuple[str, ...] = ()
    """Forces that were fitted to the measured range; empty without a fit."""
    ends: Mapping[str, Sequence[float]] = field(default_factory=dict)
    """Of the 95 % intervals of the fitted parameters."""

    @property
    def speed(self) -> float:
        """The speed [m/s] at which forces are compared: a measured one."""
        low, high = self.measured.get("v", (_SPEED, _SPEED))
        return float(min(max(_SPEED, low), high))

    @property
    def modelled(self) -> tuple[str, ...]:
        """The forces and moments of the tire."""
        return modelled(self.model)

    def parameters(self) -> list[str]:
        """Name, value, standard error, unit and interval of every parameter, one per line."""
        known, lines = specs(self.model), []
        for name, value in parameter_values(self.model).items():
            error = f" +- {self.spread[name]:.2g}" if name in self.spread else ""
            unit = f" {known[name].unit}".removesuffix(" -")
            ends = self.ends.get(name) if error else None
            between = "" if ends is None else ", 95 %: {:.4g} to {:.4g}".format(*ends)
            lines.append(f"{name} = {value:.8g}{error}{unit}{between}")
        return lines

    @property
    def listed(self) -> str:
        """The words above :meth:`parameters`."""
        return "parameters (+- standard error):" if self.spread else "parameters:"

    def ranges(self, convention: str) -> str:
        """The measured range of each input as text, in the signs of a convention."""
        text = range_text(turned_range(self.measured, convention))
        return f"{text}; beyond it the model extrapolates" if text else "not known"

    @cached_property
    def outputs(self) -> tuple[str, ...]:
        """Names of the forces and moments.

        Raises:
            UsageError: a requested force that the model does not give.
        """
        return check_names("force", self.asked, self.modelled) if self.asked else self.modelled

    def function(self, convention: str) -> Callable[..., Any]:
        """The :attr:`outputs` as a JAX function of the scalars :data:`INPUTS`.

        Args:
            convention: a key of ``slip.CONVENTIONS``; kappa, alpha, camber, load and
                the forces have its signs.
        """
        require_x64("an export")
        signs, outputs = CONVENTIONS[convention], self.outputs

        def forces(*given: Numbers) -> tuple[Numbers, ...]:
            kappa, alpha, fz, v, gamma, pressure = given
            kappa = signs.slip * kappa
            # A locked wheel has no finite sigma_x.
            turned = kappa / jnp.maximum(1 - kappa, 1 / (1 + LOCKED))
            at = TireInputs(turned, signs.alpha * alpha, signs.fz * fz, v)
            inputs = at._replace(gamma=signs.gamma * gamma, pressure=pressure)
            of_model = self.model(inputs)._asdict()
            return tuple(getattr(signs, name) * of_model[name] for name in outputs)

        return forces

    def program(self, convention: str, jacobian: bool = False) -> Program:
        """The forces as a program of the inputs that change a force.

        Args:
            jacobian: add the derivatives by kappa, alpha and fz, named ``fx_kappa``.
        """
        by = range(ALWAYS) if jacobian else ()
        program = traced(self.function(convention), INPUTS, self.outputs, by)
        used = {args[0] for op, args in program.operations if op == "input"}
        keep = [k for k in range(len(INPUTS)) if k < ALWAYS or k in used]
        operations = [
            o._replace(args=(keep.index(o.args[0]),)) if o.op == "input" else o
            for o in program.operations
        ]
        inputs = tuple(INPUTS[k] for k in keep)
        return program._replace(inputs=inputs, operations=operations)


def turned_range(
    measured: Mapping[str, tuple[float, float]], convention: str
) -> dict[str, tuple[float, float]]:
    """Convert ranges of inputs between canonical signs and those of a convention."""
    sign = {name: sign_of(convention, name) for name in measured}
    return {n: (a, b) if sign[n] > 0 else (-b, -a) for n, (a, b) in measured.items()}


def sign_of(convention: str, name: str) -> int:
    """The sign of an input or output, as of :data:`QUANTITIES`, in a convention; 1 where all
    conventions agree."""
    return getattr(CONVENTIONS[convention], "slip" if name == "kappa" else name, 1)


def range_text(ranges: Mapping[str, tuple[float, float]]) -> str:
    """Ranges of inputs with their units, as text; a range of one value as that value."""
    texts = []
    for name, ends in ranges.items():
        low, high = (end + 0.0 for end in ends)  # no -0
        wide = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
        texts.append(f"{name} {wide} {QUANTITIES[name][0]}".rstrip())
    return ", ".join(texts)


def tire_of(
    source: "Fit | AbstractTire | str | os.PathLike[str]",
    values: Mapping[str, float] | None = None,
    diagnosis: "Diagnosis | str | os.PathLike[str] | None" = None,
) -> Tire:
    """The tire of a fit, a ``fit.json``, a ``.tir`` file, or a model, in steady state
    and with both slips combined.

    Args:
        values: parameter values of a model or a ``.tir`` file.
        diagnosis: names the effects that change the tire; its parameters, estimated
            together with them, replace those of the tire.

    Raises:
        UsageError: an unknown model or parameter; values together with a fit; a fit with
            values by run; or a diagnosis of another model.
        DataError: a file that cannot be read.
    """
    path = os.fspath(source) if isinstance(source, str | os.PathLike) else ""
    given = given_tire(source, values)
    if given.tir is not None:
        tir, model = given.tir, given.tire
        assert isinstance(model, MFTire)  # in the signs of the file
        numbers = tir.numbers
        stated = {
            name: (numbers[least], numbers[most])
            for name, (least, most) in LIMITS.items()
            if least in numbers and most in numbers
        }
        tire = Tire(
            model,
            given.name,
            f"Magic Formula {tir.version} of {path}, TYRESIDE {tir.side}",
            model.nominal.FNOMIN,
            measured=turned_range(stated, TIR_SIGNS),
            notes=tuple(remarks(tir, model)),
            tir=tir.with_values(values) if values else tir,
        )
    elif given.content:
        tire = _of_fit(given, path)
    else:
        load = given.tire.nominal.FNOMIN if isinstance(given.tire, MFTire) else _USUAL_LOAD
        tire = Tire(given.tire, given.name, f"model {given.name}, no data", float(load))
    return _exportable(tire) if diagnosis is None else _with_effects(tire, diagnosis)


def _of_fit(given: GivenTire, path: str) -> Tire:
    """The tire of a fit, from its file if ``path`` is not empty."""
    content = given.content
    data, model = content["data"], given.name
    origin = f"fit of {model} to {data['file']}, {data['used']} rows"
    origin += f", sha256 {str(data['sha256'])[:12]}" if data["sha256"] else ""
    origin += f", seed {content['seed']}" if "seed" in content else ""
    origin += f", {path}" if path else ""
    fitted = content.get("parameters") or content["coefficients"]
    spread = {
        name: estimate["std"]
        for name, estimate in fitted.items()
        if estimate.get("std") and not estimate.get("fixed")
    }
    ranges = {k: (low, high) for k, (low, high) in data.get("range", {}).items()}
    if "sigma_x" in ranges:
        ranges["kappa"] = tuple(map(kappa_from_sigma, ranges.pop("sigma_x")))
    absent = [f for f in modelled(given.tire) if f not in content["forces"]]
    notes = tuple(f"{f} was not fitted: it follows from the model" for f in absent)
    load = content["reference"]["fz"]
    ends = {k: ci for k in spread if None not in (ci := fitted[k].get("ci95", [None]))}
    forces = tuple(content["forces"])
    return Tire(given.tire, model, origin, load, spread, ranges, notes, fitted=forces, ends=ends)


def _with_effects(tire: Tire, diagnosis: "Diagnosis | str | os.PathLike[str]") -> Tire:
    """The tire with the effects that a diagnosis names and a tire can have."""
    from tirefit.diagnosis.extended import extend, read_document

    document = read_document(diagnosis)
    require_x64("an export")
    try:
        report = extend(
            tire.model,
            tire.name,
            document,
            lambda model: _exportable(replace(tire, model=model)).model,
        )
    except UsageError as error:
        file = os.fspath(diagnosis) if isinstance(diagnosis, str | os.PathLike) else ""
        raise UsageError([replace(problem, file=file) for problem in error.problems]) from None
    estimated = document.extended_parameters
    notes = _exportable(tire).notes + report.sentences
    if tire.spread:
        changed = ", ".join(estimated)
        notes += (f"{changed}: estimates beside the effects, without standard error",)
    return replace(
        tire,
        model=report.tire,
        bare=report.bare if report.names else None,
        spread={k: std for k, std in tire.spread.items() if k not in estimated},
        notes=notes,
        tir=tire.tir and tire.tir.with_values(estimated),
    )


def _exportable(tire: Tire) -> Tire:
    """The tire in steady state, with both slips combined."""
    notes, model, length = list(tire.notes), tire.model, None
    if isinstance(model, Relaxed):
        length = float(model.relaxation_length)
        notes.append(
            f"steady state: the relaxation length {length:.4g} m is not in the forces:"
            " lag the slips by it before the call"
        )
        model = model.tire
    if isinstance(model, AbstractLuGre):
        notes.append(
            "steady state: the bristles of LuGre follow the slip at once, so the forces do not lag"
            " behind it as those of the dynamic LuGre tire do"
        )
    if isinstance(model, MagicFormula):
        curve = parameter_values(model)
        both = {f"{k}{axis}": v for k, v in curve.items() for axis in "xy"}
        model = with_values(CombinedMagicFormula(), both)
        notes.append(
            "the formula is for pure slip: both slips are combined by the method of"
            " Gaefvert and Svendenius (2005), with the same curve for both axes"
        )
    return replace(tire, model=model, notes=tuple(notes), relaxation=length)
