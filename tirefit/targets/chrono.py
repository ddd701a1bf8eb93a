"""A tire for Project Chrono: the JSON of its ``Pac02Tire``, and a ``.tir`` file.

By its ``Pac02Tire.cpp`` and ``ChPac02Tire.cpp`` (release 8), Chrono uses the equations of
Magic Formula 5.2 without some coefficients.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tirefit.data.tir_file import TirFile
from tirefit.files import json_text
from tirefit.fitting.tir import USUAL_SHARES, USUAL_SLIP, own_tire
from tirefit.models import TireInputs, forces
from tirefit.models.mf import WEIGHTS, MFTire, frictions
from tirefit.results import InputProblem, UsageError
from tirefit.targets.code import Draft
from tirefit.targets.tir import head_of, held_as_tir, new_file, tir_source, wheel_problems
from tirefit.targets.tire import Tire

_VERSION = "mf52"

_UNREAD = "PDX3 REX1 REX2 REY1 REY2 RHY2 QBZ10".split()
"""Coefficients of MF 5.2 that Chrono does not read."""

_LIMIT = np.pi / 2 - 0.01
"""Limit of B times the slip in Chrono, in pure slip."""

_SMALL, _SEEN = 1e-4, 1e-3
"""Step of the slip for the slope at zero; smallest share of the load that is mentioned."""

_WHEEL = {
    "mass": "MASS",
    "ixx": "IXX",
    "iyy": "IYY",
    "vertical_stiffness": "VERTICAL_STIFFNESS",
    "vertical_damping": "VERTICAL_DAMPING",
    "width": "WIDTH",
}
"""Quantity that Chrono needs in addition to the forces -> its key in a ``.tir``."""

FRICTION = 0.8
"""Friction coefficient of the road of the tests; Chrono scales the force by that of the
terrain over this one."""


def held_by_chrono(tire: Tire, model: str | None, wheel: Mapping[str, float]) -> Tire:
    """The tire of Chrono for ``tire``, in version 5.2.

    Args:
        model: None or ``mf52``.
        wheel: SI values by :data:`_WHEEL` that the file of the tire does not state, ``radius`` for
            a model without one, and ``friction`` of the road, 0.8 if not given.

    Raises:
        UsageError: another version, a value of the wheel that is missing, or a tire
            that no ``.tir`` holds.
    """
    problems = wheel_problems(wheel, (*_WHEEL, "friction", "radius"))
    if model not in (None, _VERSION):
        reason = f"--model {model} with --to chrono, which reads only {_VERSION}"
        problems.append(InputProblem(reason, "leave it out"))
    whole = {"friction": FRICTION, **_stated(tire.tir), **wheel}
    if missing := [name for name in _WHEEL if name not in whole]:
        asked = " ".join(f"--wheel {name}=..." for name in missing)
        reason = f"Chrono needs {', '.join(missing)} of the wheel, in SI units"
        problems.append(InputProblem(reason, f"give {asked}"))
    UsageError.raise_for(problems)
    of_tir = {k: v for k, v in wheel.items() if k not in {*_WHEEL, "friction"}}
    held = held_as_tir(tire, _VERSION, of_tir)
    assert held.tir is not None and isinstance(held.model, MFTire)
    tir = new_file(held)
    unread = [k for k in _UNREAD if tir.numbers.get(k)]
    combined = all(tir.numbers.get(k) for keys in WEIGHTS.values() for k in keys)
    added: dict[str, float | str] = {
        "PROPERTY_FILE_FORMAT": "PAC2002",
        "USE_MODE": 4.0,
        "TYRESIDE": held.tir.side,
        "FE_METHOD": "YES" if held.model.ellipse or not combined else "NO",
    }
    added |= {key: whole[name] for name, key in _WHEEL.items()}
    tir = tir.with_values(added)
    notes = [
        "Chrono looks for the .tir in its folder of vehicle data: put both files there,"
        " or call chrono::vehicle::SetDataPath with their folder",
        f"its forces are those of the file on a road of friction {whole['friction']:g}",
    ]
    if unread:
        notes.append(f"Chrono 8 does not read {', '.join(unread)}: zero there")
    if not (combined or held.model.ellipse):
        notes.append("without coefficients of combined slip Chrono uses its ellipse")
    if tir.numbers.get("LKY", 1.0) != tir.numbers.get("LMUY", 1.0):
        notes.append("Chrono scales the cornering stiffness by LMUY, not by LKY")
    own = held.model
    if unread:
        own = own_tire(tir.with_values(dict.fromkeys(unread, 0.0)))
    notes += _limited(own, held.load)
    return replace(held, model=own, tir=tir, notes=held.notes + tuple(notes))


def _stated(tir: TirFile | None) -> dict[str, float]:
    """Data of the wheel that a file states, in SI units."""
    if tir is None:
        return {}
    length, force, mass = (tir.unit(key) for key in ("LENGTH", "FORCE", "MASS"))
    inertia, stiffness = mass * length**2, force / length
    # WIDTH is in SI; other data of the wheel are in the units of the file.
    sizes = mass, inertia, inertia, stiffness, stiffness * tir.unit("TIME"), 1.0
    return {
        name: tir.numbers[key] * size
        for (name, key), size in zip(_WHEEL.items(), sizes, strict=True)
        if tir.numbers.get(key, 0.0) > 0
    }


def _limited(model: MFTire, load: float) -> list[str]:
    """A note on the error by the limit of B times the slip, in pure slip of usual size."""
    loads = np.array(USUAL_SHARES) * load
    alone = TireInputs(*np.zeros((len(TireInputs._fields), len(loads))))
    peaks = frictions(model, alone._replace(fz=loads))
    x, y, scale = model.longitudinal, model.lateral, model.scaling
    shapes = {"fx": x.PCX1 * scale.LCX, "fy": y.PCY1 * scale.LCY}
    slips = np.linspace(-USUAL_SLIP, USUAL_SLIP, 121)[:, None]
    missed = [(0.0, "", 0.0)]
    for name, slip in (("fx", "sigma_x"), ("fy", "alpha")):
        if name in model.lacks:
            continue

        def share(at, name=name, slip=slip):
            """Force over load (n, loads) at slips that broadcast to it."""
            at, fz = np.broadcast_arrays(at, loads)
            given = TireInputs(fz=fz.ravel())._replace(**{slip: at.ravel()})
            found = np.asarray(getattr(forces(model, given), name))
            return found.reshape(at.shape) / fz

        less, more = share([[-_SMALL], [_SMALL]])
        most = _LIMIT * float(shapes[name]) * peaks[name] * 2 * _SMALL / np.abs(more - less)
        most = np.abs(most)
        lost = np.max(np.abs(share(slips) - share(np.clip(slips, -most, most))), 0)
        missed.append((float(lost.max()), name, float(most[lost.argmax()])))
    size, name, most = max(missed)
    if size < _SEEN:
        return []
    return [
        f"Chrono limits the slip: its {name} stays the same beyond {most:.3g}, where"
        f" that of the file differs by up to {size:.1%} of F_z (to {USUAL_SLIP:g})"
    ]


def chrono_source(draft: Draft) -> dict[str, str]:
    """The JSON and the ``.tir``, by their endings."""
    tir = draft.tire.tir
    assert tir is not None
    given = {name: tir.numbers[key] for name, key in _WHEEL.items()}
    content = {
        "Name": draft.above[0],
        "Type": "Tire",
        "Template": "Pac02Tire",
        "Mass": given["mass"],
        "Inertia": [given[k] for k in ("ixx", "iyy", "ixx")],
        "Coefficient of Friction": draft.wheel.get("friction", FRICTION),
        "TIR Specification File": f"{draft.name}.tir",
        "Visualization": {"Width": given["width"]},
        "Notes": head_of(draft)[1:],
    }
    return {".json": json_text(content), ".tir": tir_source(draft)}
