"""Export a tire as a tire property file (``.tir``)."""

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from textwrap import wrap

from tirefit.data.tir import new_tir, parse_tir, reduced_tir
from tirefit.data.tir_file import TirFile
from tirefit.data.tir_keys import LIMITS
from tirefit.fitting.tir import TIR_SIGNS, USUAL_SHARES, USUAL_SLIP, own_tire, remarks
from tirefit.models import AbstractTire
from tirefit.models.mf import MAGIC_FORMULAS, MFTire
from tirefit.params import parameter_values, specs
from tirefit.results import InputProblem, UsageError, did_you_mean
from tirefit.targets.code import PARAMETERS, Draft
from tirefit.targets.tire import Tire, turned_range

_WIDEST = 180
"""Largest length of a comment line; some programs read lines of 200 characters."""

_PARTS = {"fx": "longitudinal", "fy": "lateral", "mz": "aligning"}
"""Force -> the part of a Magic Formula that gives it."""


def held_as_tir(tire: Tire, model: str | None, wheel: Mapping[str, float]) -> Tire:
    """The tire of a ``.tir`` file for ``tire``.

    A Magic Formula is written unchanged, or refitted to another version. For other
    models, the reduced form keeps c_p a^2 and mu.

    Args:
        model: ``mf52``, ``mf61`` or ``mf62``; None for the version of the tire.
        wheel: ``radius`` of the free tire [m], for a model without one.

    Raises:
        UsageError: unknown version or key of the wheel, a missing radius, or a model
            that is no Magic Formula and has no c_p a^2 and mu.
    """
    _check(model, wheel, ("radius",))
    own = tire.model if tire.bare is None else tire.bare
    notes = [re.sub("^in the forces:", "not in this file:", one) for one in tire.notes]
    if isinstance(own, MFTire):
        kept = tire.tir if tire.tir and not tire.tir.is_infofile else None
        tir = kept or new_file(replace(tire, model=own))
    else:
        tir = _reduced(own, tire, wheel, model)
        notes.append(
            "a Magic Formula cannot have the curve of a brush: only the slope 2 c_p a^2"
            f" and the largest force mu F_z are kept, at F_z = {tire.load:.4g} N"
        )
    if model and MAGIC_FORMULAS[model].version != tir.version:
        from tirefit.fitting.mf.convert import converted  # slow to import

        loads = [share * tir.numbers["FNOMIN"] for share in USUAL_SHARES]
        fit = converted(tir, model, USUAL_SLIP, loads)
        notes.append(f"refitted from Magic Formula {tir.version} to {fit.tire.version}")
        spread = {k: one.std for k, one in fit.coefficients.items() if one.std}
        tir = new_file(replace(tire, model=fit.tire, spread=spread))
    held = own_tire(tir)
    if isinstance(own, MFTire) and _alike(held, own):
        held = own
    notes += [note for note in remarks(tir, held) if note not in notes]
    return replace(tire, model=held, bare=None, tir=tir, notes=tuple(notes))


def _check(model: str | None, wheel: Mapping[str, float], keys) -> None:
    problems = wheel_problems(wheel, keys)
    if model is not None and model not in MAGIC_FORMULAS:
        known = ", ".join(MAGIC_FORMULAS)
        remedy = f"{did_you_mean(model, MAGIC_FORMULAS)}valid: {known}"
        problems.append(InputProblem(f"--model: {model!r} is not known", remedy))
    UsageError.raise_for(problems)


def wheel_problems(wheel: Mapping[str, float], keys) -> list[InputProblem]:
    """Problems of the values of a wheel, which must have these keys."""
    problems = []
    for name, value in wheel.items():
        if name not in keys:
            remedy = f"{did_you_mean(name, keys)}valid: {', '.join(keys)}"
            problems.append(InputProblem(f"--wheel: {name!r} is not known", remedy))
        elif not 0 < value < math.inf:
            reason = f"--wheel {name}={value:g} is not positive"
            problems.append(InputProblem(reason, "give it in SI units"))
    return problems


def _reduced(
    own: AbstractTire, tire: Tire, wheel: Mapping[str, float], model: str | None
) -> TirFile:
    values = parameter_values(own)
    if not {"cpa2", "mu"} <= values.keys():
        reason = f"a .tir file describes a whole Magic Formula, or c_p a^2 and mu; not {tire.name}"
        remedy = "fit mf52, mf61 or mf62 to the data, or a brush"
        raise UsageError(InputProblem(reason, remedy))
    if "radius" not in wheel:
        reason = f"a .tir needs the radius of the free tire, which a {tire.name} lacks"
        raise UsageError(InputProblem(reason, "give it in m: --wheel radius=0.3"))
    given = {k: float(values[k]) for k in ("cpa2", "mu")}
    tir = reduced_tir(**given, fz=tire.load, radius=wheel["radius"])
    version = MAGIC_FORMULAS[model].version if model else tir.version
    if version == "5.2":
        # The stiffness cannot be constant over the load: make it stationary at FNOMIN.
        return new_tir(version, tir.numbers | {"PKY2": 1.0}, {}, {})
    return tir if version == tir.version else tir.with_values({"FITTYP": 62.0})


def new_file(tire: Tire) -> TirFile:
    """A file with the coefficients of the tire and their standard errors."""
    model, known = tire.model, specs(tire.model)
    assert isinstance(model, MFTire)
    lost = {k for force in model.lacks for k in specs(getattr(model, _PARTS[force]))}
    values = {k: v for k, v in parameter_values(model).items() if k not in lost}
    # A tire that was converted has errors of its former parameters as well.
    errors = {k: std for k, std in tire.spread.items() if k in known}
    notes = {k: f"{known[k].meaning} +- {std:.3g}" for k, std in errors.items()}
    ranges = turned_range(tire.measured, TIR_SIGNS)
    ranges = {k: ends for k, ends in ranges.items() if k in LIMITS}
    tir = new_tir(model.version, values, ranges, notes)
    return tir.with_values({"FE_METHOD": "YES"}) if model.ellipse else tir


def _alike(one: MFTire, other: MFTire) -> bool:
    """Whether two tires differ only by the rounding of a file."""
    same = ("version", "similarity", "ellipse", "lacks", "starred", "digression")
    if any(getattr(one, name) != getattr(other, name) for name in same):
        return False
    values, others = parameter_values(one), parameter_values(other)
    near = (math.isclose(values[k], others[k], rel_tol=1e-12) for k in values)
    return values.keys() == others.keys() and all(near)


def comments(lines) -> str:
    """Lines as comments of a ``.tir`` file, wrapped to the length that programs read."""
    short: list[str] = []
    for line in lines:
        short += wrap(line, _WIDEST, subsequent_indent="  ", break_on_hyphens=False)
    return "".join(f"$ {line}\n" for line in short)


def head_of(draft: Draft) -> list[str]:
    """The head without the parameters, which the file lists separately."""
    listed = {f"  {line}" for line in draft.tire.parameters()} | {PARAMETERS}
    return [line for line in draft.above if line not in listed]


def tir_source(draft: Draft) -> str:
    """The text of the file, the head as comments above it."""
    assert draft.tire.tir is not None
    text = comments(head_of(draft)) + draft.tire.tir.text
    parse_tir(text)
    return text
