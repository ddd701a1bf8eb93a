"""Convert a Magic Formula to another version, by a fit to a noise-free virtual test."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tirefit.data.table import Source, TireData
from tirefit.data.tir.tir import TirFile
from tirefit.data.tir.tir_keys import LIMITS, PRESSURE_TERMS
from tirefit.fitting.mf.fit import fit_magic_formula
from tirefit.fitting.mf.parts import NEVER_FITTED, VERSIONS, coefficients_of
from tirefit.fitting.mf.result import MagicFormulaFit
from tirefit.fitting.problem.config import FitConfig
from tirefit.fitting.tir import own_tire, remarks, tire_of, turned_by
from tirefit.models import TireInputs, forces
from tirefit.models.mf.moments import Overturning, Rolling
from tirefit.models.mf.tire import turned_inputs
from tirefit.params import specs

_CAMBER, _PRESSURE = 0.08, 0.2
"""Largest camber [rad] and relative change of pressure, if the file allows them."""

_OTHER_SLIPS = (-0.4, -0.15, 0.15, 0.4)
"""Slip angles of combined sweeps, relative to the largest."""

_SLIPS = 41


def _range(tir: TirFile, name: str, low: float, high: float) -> tuple[float, float]:
    """The range of an input in ISO-W axes, cut to the range that the file states."""
    least, most = LIMITS[name]
    return max(low, tir.numbers.get(least, low)), min(high, tir.numbers.get(most, high))


def virtual_test(
    tir: TirFile,
    slip_max: float,
    loads: Sequence[float],
    pressure_too: bool,
    signs: str | None = None,
    combination: str | None = None,
    moments: Sequence[str] = (),
) -> TireData:
    """Sweeps in pure and combined slip of the tire of a file, each sweep a run.

    They are at the given loads [N], three cambers and, if ``pressure_too``, three
    pressures. ``moments`` names those of mx and my to measure beside fx, fy and mz.
    """
    tire = own_tire(tir)
    kappa = np.linspace(*_range(tir, "kappa", -min(slip_max, 0.99), slip_max), _SLIPS)
    alpha = np.linspace(*_range(tir, "alpha", -slip_max, slip_max), _SLIPS)
    low, high = _range(tir, "gamma", -_CAMBER, _CAMBER)
    cambers = list(dict.fromkeys((low, 0.0, high)))
    nominal = tire.nominal.NOMPRES
    pressures = [nominal]
    if pressure_too:
        around = _range(tir, "pressure", (1 - _PRESSURE) * nominal, (1 + _PRESSURE) * nominal)
        pressures = [around[0], nominal, around[1]]
    parts: list[tuple[Any, ...]] = []
    for fz in loads:
        for pressure in pressures:
            for gamma in cambers:
                parts.append((kappa, 0.0, fz, gamma, pressure))
                parts.append((0.0, alpha, fz, gamma, pressure))
            for k, share in enumerate(_OTHER_SLIPS):
                gamma = cambers[k % len(cambers)]
                parts.append((kappa, share * alpha[-1], fz, gamma, pressure))
    slip, angle, load, camber, inflation = np.concatenate(
        [np.broadcast_arrays(*part) for part in parts], axis=1
    )
    zero = np.zeros(len(load))
    sigma_x, speed = -slip / (1 + slip), zero + tire.nominal.LONGVL
    inputs = TireInputs(sigma_x, angle, load, speed, camber, inflation, zero)
    inputs = turned_inputs(inputs, turned_by(signs))
    tire_in_signs = tire_of(tir, signs=signs, combination=combination)
    given = forces(tire_in_signs, inputs)._asdict()
    wanted = inputs._asdict() | {name: given[name] for name in ("fx", "fy", "mz", *moments)}
    columns = {k: np.asarray(v) for k, v in wanted.items() if v is not None}
    if "mz" in columns and "fx" not in columns:  # M_z without F_x is known only for free rolling
        columns["mz"] = np.where(slip == 0, columns["mz"], np.nan)
    used, run = np.full(len(load), True), np.repeat(np.arange(len(parts)), _SLIPS)
    names = tuple(f"sweep {i}" for i in range(len(parts)))
    data = TireData(tir.path, columns, used, run, names, Source(path=tir.path))
    noise = "the test has no noise: standard errors come from misfit of the version"
    assumptions = (noise, *remarks(tir, tire_in_signs, data, signs))
    return replace(data, source=replace(data.source, assumptions=assumptions))


def converted(
    tir: TirFile,
    model: str,
    slip_max: float,
    loads: Sequence[float],
    signs: str | None = None,
    combination: str | None = None,
) -> MagicFormulaFit:
    """Fit the Magic Formula ``model`` to a virtual test of the tire of a file.

    MF 5.2 has no pressure terms, so its test is at the nominal pressure. The result
    lacks the forces that the file lacks. M_x and M_y are copied if the version has all
    their coefficients; otherwise M_x is fitted.

    Args:
        tir: the file, read and checked.
        model: ``mf52``, ``mf61`` or ``mf62``.
        slip_max: largest kappa and slip angle [rad].
        loads: F_z [N].
        signs: convention of the file, ISO-W if None; the result is in ISO-W.
        combination: method of combined slip of the tire of the file, see
            :func:`~tirefit.fitting.tir.own_tire`.
    """
    acting = any(tir.numbers.get(name) for name in PRESSURE_TERMS)
    coefficients = {*coefficients_of(VERSIONS[model]), *(NEVER_FITTED if model != "mf52" else ())}
    of_mx = [name for name in specs(Overturning()) if tir.numbers.get(name)]
    # A file in other signs has other coefficients of M_x than the result.
    is_fitted = not coefficients.issuperset(of_mx) or turned_by(signs)
    moments = ("mx",) if of_mx and is_fitted else ()
    pressure_too = acting and model != "mf52"
    data = virtual_test(tir, slip_max, loads, pressure_too, signs, combination, moments)
    copied = {*specs(Rolling()), *(() if moments else specs(Overturning()))} & coefficients
    kept = ("FNOMIN", "UNLOADED_RADIUS", "NOMPRES", "LONGVL")
    tire = own_tire(tir)
    given = {name: {"value": float(getattr(tire.nominal, name))} for name in kept}
    given |= {k: {"value": tir.numbers[k]} for k in copied if k in tir.numbers}
    settings = FitConfig.model_validate({"parameters": given})
    first = None if turned_by(signs) else tir.numbers
    fit = fit_magic_formula(data, model, config=settings, first=first, leave_out="none")
    # Far rows of a noise-free curve are not outliers.
    notes = tuple(note for note in fit.notes if "standard deviations" not in note)
    return replace(fit, notes=notes, tire=replace(fit.tire, lacks=tire.lacks))
