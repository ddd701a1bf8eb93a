"""Export a tire as a tire property file (``.tir``), and as a tire of Project Chrono.

Chrono reads a ``.tir`` and the JSON of its ``Pac02Tire``. By its ``Pac02Tire.cpp`` and
``ChPac02Tire.cpp`` (release 8), it uses the equations of Magic Formula 5.2 without some
coefficients.
"""

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import replace
from textwrap import wrap

import equinox as eqx
import jax
import numpy as np

from tirefit.data.tir.tir import new_tir, parse_tir, reduced_tir
from tirefit.data.tir.tir_file import TirFile
from tirefit.data.tir.tir_keys import LIMITS
from tirefit.files import json_text
from tirefit.fitting.tir import TIR_SIGNS, own_tire, remarks
from tirefit.models import AbstractTire
from tirefit.models.mf import MAGIC_FORMULAS, WEIGHTS, MFTire
from tirefit.params import parameter_values, specs
from tirefit.results import InputProblem, UsageError, unknown_names
from tirefit.targets.code import Draft
from tirefit.targets.tire import Tire, turned_range

_WIDEST = 180  # largest length of a comment line; some programs read lines of 200 characters
_PARTS = {"fx": "longitudinal", "fy": "lateral", "mz": "aligning"}
"""Force -> the part of a Magic Formula that gives it."""


def held_as_tir(tire: Tire, model: str | None, wheel: Mapping[str, float]) -> Tire:
    """The tire of a ``.tir`` file for ``tire``.

    A Magic Formula is written unchanged. For other models, the reduced form keeps c_p a^2
    and mu.

    Args:
        model: ``mf52``, ``mf61`` or ``mf62``: the version of a reduced form.
        wheel: ``radius`` of the free tire [m], for a model without one.

    Raises:
        UsageError: unknown version or key of the wheel, a missing radius, a Magic Formula of
            another version, or another model without c_p a^2 and mu.
    """
    problems = _wheel_problems(wheel, ("radius",))
    UsageError.raise_for(problems + unknown_names("--model", [model], MAGIC_FORMULAS))
    bare = tire.model if tire.bare is None else tire.bare
    notes = [re.sub("^in the forces:", "not in this file:", note) for note in tire.notes]
    if isinstance(bare, MFTire):
        kept = tire.tir if tire.tir and not tire.tir.is_infofile else None
        tir = kept or _new_file(replace(tire, model=bare))
    else:
        tir = _reduced(bare, tire, wheel, model)
        own = replace(tire, model=bare).parameters()
        kept_values = [line for line in own if line.split()[0] in ("cpa2", "mu")]
        notes = [note for note in notes if not note.startswith("mz ")]
        notes.append(
            "a Magic Formula cannot have the curve of a brush: only the slope 2 c_p a^2"
            f" and the largest force mu F_z are kept, at F_z = {tire.load:.4g} N, with"
            f" {'; '.join(kept_values)}"
        )
        notes.append("mz of the tire is not included")
        tire = replace(tire, asked=("fx", "fy"))
    if model and MAGIC_FORMULAS[model].version != tir.version:
        reason = f"--model {model}: the tire is a Magic Formula {tir.version}"
        remedy = "fit the other version to the forces that `tirefit predict` gives at rows of yours"
        raise UsageError(reason, remedy)
    held = own_tire(tir)
    if isinstance(bare, MFTire):
        # They may differ only by the rounding of a file.
        pair = (jax.tree.map(lambda x: np.asarray(x, float), each) for each in (held, bare))
        held = bare if eqx.tree_equal(*pair, rtol=1e-12) else held
    notes += [note for note in remarks(tir, held) if note not in notes]
    return replace(tire, model=held, bare=None, tir=tir, notes=tuple(notes))


def _wheel_problems(wheel: Mapping[str, float], keys: Collection[str]) -> list[InputProblem]:
    """Problems of the values of a wheel, which must have these keys."""
    return unknown_names("--wheel", wheel, keys) + [
        InputProblem(f"--wheel {name}={value:g} is not positive", "give it in SI units")
        for name, value in wheel.items()
        if name in keys and not 0 < value < math.inf
    ]


def _reduced(
    bare: AbstractTire, tire: Tire, wheel: Mapping[str, float], model: str | None
) -> TirFile:
    values = parameter_values(bare)
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


def _new_file(tire: Tire) -> TirFile:
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


def _head_of(draft: Draft) -> list[str]:
    """The head without the parameters, which the file lists separately."""
    listed = {f"  {line}" for line in draft.tire.parameters()} | {draft.tire.listed}
    return [line for line in draft.above if line not in listed]


def tir_source(draft: Draft) -> str:
    """The text of the file, the head as comments above it."""
    assert draft.tire.tir is not None
    lines = []  # as comments, wrapped to the length that programs read
    for line in _head_of(draft):
        lines += wrap(line, _WIDEST, subsequent_indent="  ", break_on_hyphens=False)
    text = "".join(f"$ {line}\n" for line in lines) + draft.tire.tir.text
    parse_tir(text)
    return text


_UNREAD = "PDX3 REX1 REX2 REY1 REY2 RHY2 QBZ10".split()
"""Coefficients of MF 5.2 that Chrono does not read."""
_WHEEL = {k: k.upper() for k in "mass ixx iyy vertical_stiffness vertical_damping width".split()}
"""Quantity that Chrono needs in addition to the forces -> its key in a ``.tir``, in SI."""
FRICTION = 0.8
"""Friction coefficient of the road of the tests; Chrono scales the force by that of the
terrain over this one."""


def held_by_chrono(tire: Tire, model: str | None, wheel: Mapping[str, float]) -> Tire:
    """The tire of Chrono for ``tire``, in version 5.2.

    Args:
        model: None or ``mf52``.
        wheel: SI values by :data:`_WHEEL`, ``radius`` for a model without one, and ``friction``
            of the road, 0.8 if not given.

    Raises:
        UsageError: another version, a value of the wheel that is missing, or a tire
            that no ``.tir`` holds.
    """
    problems = _wheel_problems(wheel, (*_WHEEL, "friction", "radius"))
    if model not in (None, "mf52"):
        reason = f"--model {model} with --to chrono, which reads only mf52"
        problems.append(InputProblem(reason, "leave it out"))
    whole = {"friction": FRICTION, **wheel}
    if missing := [name for name in _WHEEL if name not in whole]:
        asked = " ".join(f"--wheel {name}=..." for name in missing)
        reason = f"Chrono needs {', '.join(missing)} of the wheel, in SI units"
        problems.append(InputProblem(reason, f"give {asked}"))
    UsageError.raise_for(problems)
    of_tir = {k: v for k, v in wheel.items() if k not in {*_WHEEL, "friction"}}
    held = held_as_tir(tire, "mf52", of_tir)
    assert held.tir is not None and isinstance(held.model, MFTire)
    tir = _new_file(held)
    unread = [k for k in _UNREAD if tir.numbers.get(k)]
    combined = all(tir.numbers.get(k) for keys in WEIGHTS.values() for k in keys)
    by_ellipse = held.model.ellipse or not combined
    added: dict[str, float | str] = {"PROPERTY_FILE_FORMAT": "PAC2002", "USE_MODE": 4.0}
    added |= {"TYRESIDE": held.tir.side, "FE_METHOD": "YES" if by_ellipse else "NO"}
    tir = tir.with_values(added | {key: whole[name] for name, key in _WHEEL.items()})
    notes = [
        "Chrono looks for the .tir in its folder of vehicle data: put both files there,"
        " or call chrono::vehicle::SetDataPath with their folder",
        f"its forces are those of the file on a road of friction {whole['friction']:g}",
        "Chrono 8 limits B times the slip to 1.56 in pure slip: beyond it the force stays the same",
    ]
    if unread:
        notes.append(f"Chrono 8 does not read {', '.join(unread)}: zero there")
    if not (combined or held.model.ellipse):
        notes.append("without coefficients of combined slip Chrono uses its ellipse")
    if tir.numbers.get("LKY", 1.0) != tir.numbers.get("LMUY", 1.0):
        notes.append("Chrono scales the cornering stiffness by LMUY, not by LKY")
    read = own_tire(tir.with_values(dict.fromkeys(unread, 0.0))) if unread else held.model
    return replace(held, model=read, tir=tir, notes=held.notes + tuple(notes))


def chrono_source(draft: Draft) -> dict[str, str]:
    """The JSON and the ``.tir``, by their endings."""
    tir = draft.tire.tir
    assert tir is not None
    given = {name: tir.numbers[key] for name, key in _WHEEL.items()}
    content = {
        "Name": draft.above[0], "Type": "Tire", "Template": "Pac02Tire", "Mass": given["mass"],
        "Inertia": [given[k] for k in ("ixx", "iyy", "ixx")],
        "Coefficient of Friction": draft.wheel.get("friction", FRICTION),
        "TIR Specification File": f"{draft.name}.tir",
        "Visualization": {"Width": given["width"]}, "Notes": _head_of(draft)[1:],
    }  # fmt: skip
    return {".json": json_text(content), ".tir": tir_source(draft)}
