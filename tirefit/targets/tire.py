"""The tire that is exported: its function, where it comes from, what was measured."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import jax.numpy as jnp

from tirefit.data.tir import read_tir
from tirefit.data.tir_keys import LIMITS
from tirefit.fitting.mf.result import MagicFormulaFit
from tirefit.fitting.problem import find_model
from tirefit.fitting.result import FitResult
from tirefit.fitting.store import StoredFit, load_fit
from tirefit.fitting.tir import own_tire, remarks
from tirefit.models import (
    AbstractTire,
    CombinedMagicFormula,
    MagicFormula,
    TireInputs,
    modelled,
)
from tirefit.models.relaxation import Relaxed
from tirefit.params import check_values, parameter_values, specs, with_values
from tirefit.precision import require_x64
from tirefit.slip import CONVENTIONS, LOCKED
from tirefit.targets.program import Program, traced, with_derivatives

INPUTS = ("kappa", "alpha", "fz", "v", "gamma", "pressure")
"""Arguments of an exported tire, in order: practical slip [-], slip angle [rad], load
[N]; then, where they change a force, speed [m/s], camber [rad], pressure [Pa]."""

ALWAYS = 3
"""The first of them that every exported tire has."""

UNITS = {
    "kappa": "-", "alpha": "rad", "fz": "N", "v": "m/s", "gamma": "rad",
    "pressure": "Pa", "fx": "N", "fy": "N", "mz": "N m", "mx": "N m", "my": "N m",
}  # fmt: skip


@dataclass(frozen=True)
class Tire:
    """A tire to export.

    Attributes:
        model: steady-state tire with its values.
        name: of the model.
        origin: sentences on where it comes from.
        spread: standard errors by parameter; of those that were fitted.
        measured: (least, largest) value by input, canonical; of those that are known.
        forces: forces that were fitted; all that are modelled if there was no fit.
        notes: sentences on what was assumed.
    """

    model: AbstractTire
    name: str
    origin: tuple[str, ...]
    spread: Mapping[str, float]
    measured: Mapping[str, tuple[float, float]]
    forces: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @property
    def load(self) -> float:
        """A load in the middle of what was measured [N]."""
        low, high = self.measured.get("fz", (4000.0, 4000.0))
        return (low + high) / 2

    def parameters(self) -> list[str]:
        """Name, value, standard error and unit of every parameter, a line each."""
        known, lines = specs(self.model), []
        for name, value in parameter_values(self.model).items():
            error = f" +- {self.spread[name]:.2g}" if name in self.spread else ""
            lines.append(f"{name} = {value:.8g}{error} {known[name].unit}")
        return lines

    def ranges(self) -> str:
        """What was measured, in words."""
        told = [
            f"{name} {low:.4g} to {high:.4g} {UNITS[name]}"
            for name, (low, high) in self.measured.items()
        ]
        return ", ".join(told) or "not known"

    def program(self, convention: str, jacobian: bool = False) -> Program:
        """The forces as a program in a sign convention.

        Args:
            convention: a key of ``slip.CONVENTIONS``; kappa, alpha, camber, load and
                the forces have its signs.
            jacobian: with the derivatives by kappa, alpha and fz, named ``fx_kappa``.
        """
        require_x64("an export")
        signs, outputs = CONVENTIONS[convention], modelled(self.model)

        def forces(kappa, alpha, fz, v, gamma, pressure):
            kappa = signs.slip * kappa
            # A locked wheel has no finite sigma_x.
            turned = kappa / jnp.maximum(1 - kappa, 1 / (1 + LOCKED))
            given = TireInputs(
                turned, signs.alpha * alpha, signs.fz * fz, v, signs.gamma * gamma,
                pressure,
            )  # fmt: skip
            found = self.model(given)._asdict()
            return tuple(getattr(signs, name) * found[name] for name in outputs)

        names = list(outputs)
        function = forces
        if jacobian:
            by = range(ALWAYS)
            function = with_derivatives(forces, len(INPUTS), by)
            names += [f"{out}_{INPUTS[k]}" for k in by for out in outputs]
        program = traced(function, INPUTS, names)
        used = {args[0] for op, args in program.operations if op == "input"}
        keep = [k for k in range(len(INPUTS)) if k < ALWAYS or k in used]
        operations = [
            o._replace(args=(keep.index(o.args[0]),)) if o.op == "input" else o
            for o in program.operations
        ]
        inputs = tuple(INPUTS[k] for k in keep)
        return program._replace(inputs=inputs, operations=operations)


def tire_of(
    source: FitResult | MagicFormulaFit | StoredFit | AbstractTire | str | os.PathLike,
    values: Mapping[str, float] | None = None,
) -> Tire:
    """The tire of a fit, a ``fit.json``, a ``.tir`` file, or a model.

    Args:
        values: parameter values of a model or a ``.tir`` file.

    Raises:
        UsageError: an unknown model or parameter; or a fit with values by run.
        DataError: a file that cannot be read.
    """
    text, given = os.fspath(source) if isinstance(source, str | Path) else "", values
    if text.lower().endswith(".tir"):
        return _of_tir(text, given or {})
    if text.endswith(".json") or text and Path(text).is_file():
        source = load_fit(text)
    if isinstance(source, FitResult):
        problem = source.problem
        source = StoredFit(
            source.model, problem.model, problem.layout, source.z, source.covariance,
            {}, source.to_dict(),
        )  # fmt: skip
    if isinstance(source, MagicFormulaFit):
        source = source.stored
    if isinstance(source, StoredFit):
        return _of_fit(source.at_estimate(), source.model, source.content, text)
    if isinstance(source, AbstractTire):
        tire, name = source, type(source).__name__
    else:
        tire, name = find_model(text), text
    check_values(tire, name, given or {})
    tire = with_values(tire, dict(given or {}))
    return _exportable(Tire(tire, name, (f"model {name}, values given",), {}, {}, ()))


def _of_fit(tire: AbstractTire, model: str, content: Mapping, path: str) -> Tire:
    data, fitted = content["data"], content["parameters"]
    origin = (
        f"fit of {model} to {data['file']} (sha256 {str(data['sha256'])[:12]}),"
        f" {data['used']} rows, seed {content['seed']}" + (f", {path}" if path else ""),
    )
    spread = {
        name: one["std"]
        for name, one in fitted.items()
        if not one.get("fixed") and one.get("std") is not None
    }
    ranges = {"fz": (content["reference"]["fz"],) * 2}
    ranges |= {k: tuple(v) for k, v in data.get("range", {}).items() if k in _KNOWN}
    forces = tuple(content["forces"])
    absent = [f for f in ("fx", "fy") if f not in forces]
    notes = tuple(f"{f} was not measured: it is the model's" for f in absent)
    return _exportable(Tire(tire, model, origin, spread, ranges, forces, notes))


def _of_tir(path: str, values: Mapping[str, float]) -> Tire:
    tir = read_tir(path)
    tire = own_tire(tir, values=values)
    ranges = {}
    for name, (least, most) in LIMITS.items():
        if least in tir.numbers and most in tir.numbers:
            ranges[name] = (tir.numbers[least], tir.numbers[most])
    origin = (f"Magic Formula {tir.version} of {path}, TYRESIDE {tir.side}",)
    notes = tuple(remarks(tir, tire))
    return Tire(tire, f"MF {tir.version}", origin, {}, ranges, modelled(tire), notes)


_KNOWN = ("sigma_x", *INPUTS)


def _exportable(tire: Tire) -> Tire:
    """In steady state, and with both slips combined."""
    notes, model = list(tire.notes), tire.model
    if isinstance(model, Relaxed):
        length = float(model.relaxation_length)
        notes.append(
            f"steady state: the relaxation length {length:.4g} m has no place here: lag"
            " the slips by it before the call"
        )
        model = model.tire
    if isinstance(model, MagicFormula):
        own = parameter_values(model)
        both = {f"{k}{axis}": v for k, v in own.items() for axis in "xy"}
        model = with_values(CombinedMagicFormula(), both)
        notes.append(
            "the formula is of pure slip: both slips are combined by the method of"
            " Gaefvert and Svendenius (2005), with the same curve along both axes"
        )
    forces = tire.forces or modelled(model)
    return replace(tire, model=model, notes=tuple(notes), forces=forces)
