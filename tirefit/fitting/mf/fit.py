"""Fit a whole Magic Formula: :func:`fit_magic_formula`."""

import importlib.metadata
import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tirefit.data.accept import as_data
from tirefit.data.read import require
from tirefit.data.table import TireData
from tirefit.data.tir import TirFile, read_tir
from tirefit.fitting.config import FitConfig, ParameterConfig, parse_config
from tirefit.fitting.estimate import data_record
from tirefit.fitting.mf.guards import check_guards
from tirefit.fitting.mf.like import Borrowed, borrowed_from, with_dimensions
from tirefit.fitting.mf.parts import (
    HELD,
    MOMENTS,
    NEVER_FITTED,
    PARTS,
    VERSIONS,
    coefficients_of,
)
from tirefit.fitting.mf.priors import Prior, normal_form, prior_given, published_priors
from tirefit.fitting.mf.result import Coefficient, MagicFormulaFit
from tirefit.fitting.mf.rows import ForceRows, NoiseLaw, joined, rows_of_forces
from tirefit.fitting.mf.solve import Problem
from tirefit.fitting.mf.stages import FAR, Search, search
from tirefit.models.mf import MAGIC_FORMULAS, MFTire
from tirefit.models.mf.fields import Nominal, Scaling
from tirefit.params import check_names, check_values, specs, with_values
from tirefit.precision import require_x64
from tirefit.results import DataError, InputProblem, UsageError
from tirefit.slip import kappa_from_sigma

__all__ = ["fit_magic_formula", "nominal_of", "parts_named", "problem_from"]


def parts_named(part: str) -> tuple[str, ...]:
    """The stages of ``--part``: that one, with ``combined`` and ``all`` all of them; of
    M_x or M_y those of the forces too, of which it is made.

    Raises:
        UsageError: no such part.
    """
    (name,) = check_names("part", [part], (*PARTS, "all"))
    if name in MOMENTS:
        return ("fx", "fy", "combined", name)
    return tuple(PARTS) if name in ("combined", "all") else (name,)


def fit_magic_formula(
    data: Any,
    model: str = "mf61",
    *,
    part: str = "all",
    config: FitConfig | dict | None = None,
    first: Mapping[str, float] | None = None,
    like: TirFile | str | os.PathLike | None = None,
) -> MagicFormulaFit:
    """Every coefficient of a Magic Formula, with its standard error and origin.

    Each part is fitted to its own rows, then all together; Gaussian priors from
    published tires keep what the data do not tell at physical values.

    Args:
        data: what ``tirefit.read`` gave, or what it reads; a list of such counts as
            runs of one data set, which need not hold the same columns.
        model: ``mf52``, ``mf61`` or ``mf62``.
        part: ``fx``, ``fy`` or ``mz`` in pure slip; ``all``, or ``combined``, is these,
            combined slip, ``mx`` and ``my``, as far as the data hold them; ``mx`` or
            ``my``: that moment and the forces.
        config: content of ``fit.toml``: noise of the forces; under ``parameters`` the
            nominal state (FNOMIN, UNLOADED_RADIUS, NOMPRES), and value, ``free`` and
            prior of coefficients.
        first: coefficients of a tire that may be near, to start from too.
        like: a ``.tir`` file, whose coefficients are the priors' means where ``config``
            says nothing of them.

    Raises:
        UsageError: unknown model, part or coefficient, or a setting that is not of a
            Magic Formula; or 32-bit floats in use.
        DataError: no force with its slip, or too few rows of one.
    """
    require_x64("a fit")
    check_names("Magic Formula", [model], VERSIONS)
    parts = parts_named(part)
    if isinstance(config, dict):
        config = parse_config(config)
    config = config or FitConfig()
    tables = data if isinstance(data, list | tuple) else [data]
    whole = joined([as_data(table) for table in tables])
    _check_settings(model, config)
    require(whole, ("fz",), f"the model {model}")
    forces = [f for name in parts for f in PARTS[name].forces]
    rows = rows_of_forces(whole, list(dict.fromkeys(forces)), config)
    other = like if like is None or isinstance(like, TirFile) else read_tir(like)
    taken: list[str] = []
    if other is not None:
        config, taken = with_dimensions(other, rows, config)
    tire, notes = nominal_of(model, rows, config, other.numbers if other else ())
    borrowed = borrowed_from(other, tire, rows, config) if other else Borrowed({}, ())
    notes += [*taken, *borrowed.notes]
    lacking = "mx is not fitted: the data have no fy, of which the model makes it"
    if part in MOMENTS and part not in rows:
        reason = lacking if part in whole else f"the data have no {part}"
        remedy = f"leave out --part {part}, or see `tirefit inspect`"
        raise DataError(InputProblem(reason, remedy, whole.source.path or whole.name))
    notes += [lacking] if "mx" in {*parts} & {*whole.columns} - {*rows} else []
    notes += _slip_noise_left_out(whole, config)
    problem, priors = problem_from(tire, config, borrowed.priors)
    work = search(problem, rows, parts, _start(problem, first) if first else None)
    return _result(model, whole, work, priors, notes, borrowed.priors.keys())


def _check_settings(model: str, config: FitConfig) -> None:
    """Raises UsageError for settings that a Magic Formula does not have; all."""
    problems = []
    own = coefficients_of(VERSIONS[model])
    given = {*specs(Nominal()), *specs(Scaling()), *NEVER_FITTED}
    for name, asked in config.parameters.items():
        if name not in own and (name not in given or asked.value is None):
            reason = f"parameters.{name}: {model} does not fit it"
            remedy = f"its coefficients are {', '.join(own)}"
            problems.append(InputProblem(reason, remedy, config.source))
        wrong = [key for key in ("lower", "upper", "tied") if getattr(asked, key)]
        wrong += ["per_run"] if asked.per_run else []
        if asked.value is not None and asked.free and asked.prior is None:
            wrong.append("value with free")
        if wrong:
            reason = f"parameters.{name}: {', '.join(wrong)} in a Magic Formula"
            remedy = "give value to hold it there, or a prior of mean and std"
            problems.append(InputProblem(reason, remedy, config.source))
    if config.noise.loss not in ("squares", FitConfig().noise.loss):
        reason = f"noise.loss = {config.noise.loss!r} in a Magic Formula"
        problems.append(InputProblem(reason, "leave it out", config.source))
    if problems:
        raise UsageError(problems)


def nominal_of(
    model: str,
    rows: dict[str, ForceRows],
    config: FitConfig,
    also: Iterable[str] = (),
):
    """The tire with its nominal state and all that is given; what was assumed. It has
    an M_x or M_y that is measured, set or among the names ``also``."""
    empty = MAGIC_FORMULAS[model]
    asked = {name[:3] for name in (*config.parameters, *also)}
    if "mx" not in rows and "QSX" not in asked:
        empty = replace(empty, overturning=None)
    if "my" not in rows and "QSY" not in asked:
        empty = replace(empty, rolling=None)
    given = {k: v.value for k, v in config.parameters.items() if v.value is not None}
    check_values(MAGIC_FORMULAS[model], model, given)
    first = next(iter(rows.values()))
    pressures = first.column("pressure")
    pressures, speeds = pressures[pressures > 0], first.column("v")
    pressure = float(np.median(pressures)) if len(pressures) else 2.2e5
    speed = float(np.median(speeds)) if np.any(speeds > 0) else 16.7
    assumed = {
        "FNOMIN": _rounded(float(np.median(first.column("fz")))),
        "NOMPRES": _rounded(pressure),
        "INFLPRES": given.get("NOMPRES", _rounded(pressure)),
        "LONGVL": _rounded(speed),
        "UNLOADED_RADIUS": 0.3,
    }
    origins = {
        "FNOMIN": "the median load", "NOMPRES": "the median pressure",
        "UNLOADED_RADIUS": "no radius was given; the moments alone refer to it",
    }  # fmt: skip
    if not len(pressures):
        origins["NOMPRES"] = "the data have no pressure"
    notes = [
        f"{name} = {assumed[name]:g}: {why} (parameters.{name}.value gives another)"
        for name, why in origins.items()
        if name not in given
        and (name != "UNLOADED_RADIUS" or {"mz", *MOMENTS} & rows.keys())
    ]
    return with_values(empty, assumed | given), notes


def _start(problem: Problem, first: Mapping[str, float]) -> np.ndarray:
    """u (p,) of the coefficients given, where they can be, else of the centres."""
    u = np.zeros(len(problem.names))
    for name, value in normal_form(first).items():
        if name in problem.names:
            i = problem.names.index(name)
            if problem.free[i] and (value > 0 or not problem.log[i]):
                u[i] = problem.unit(name, value)
    return u


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


def problem_from(
    tire: MFTire, config: FitConfig, borrowed: Mapping[str, Prior] | None = None
) -> tuple[Problem, dict[str, Prior]]:
    """The coefficients in units of their priors, and the priors: those that are set,
    else those ``borrowed``, else the published ones."""
    known = specs(tire)
    names = tuple(name for name in coefficients_of(tire.version) if name in known)
    known_priors = {**published_priors(), **(borrowed or {})}
    priors = {name: known_priors[name] for name in names}
    usual = {name: ParameterConfig(free=False) for name in HELD}
    asked = {n: (usual | config.parameters).get(n, ParameterConfig()) for n in names}
    for name, one in asked.items():
        if one.prior is not None:
            priors[name] = prior_given(name, one.prior.mean, one.prior.std)
        elif one.value is not None:
            priors[name] = priors[name]._replace(centre=one.value, log=False)
    held = [one.value is not None and one.prior is None for one in asked.values()]
    held = [h or asked[n].free is False for h, n in zip(held, names, strict=True)]
    centre = np.array([priors[name].centre for name in names])
    spread = np.array([priors[name].spread for name in names])
    tire = with_values(tire, dict(zip(names, centre.tolist(), strict=True)))
    log = np.array([priors[name].log for name in names])
    return Problem(tire, names, centre, spread, log, ~np.array(held), ()), priors


def _slip_noise_left_out(data: TireData, config: FitConfig) -> list[str]:
    """What is known of the noise of slips, which has no part in this fit."""
    stated = [f"{slip}_std" for slip in ("sigma_x", "alpha") if f"{slip}_std" in data]
    names = ("sigma_x", "alpha", "sigma_x_speed", "alpha_speed")
    stated += [f"noise.{name}" for name in names if getattr(config.noise, name)]
    return [f"{', '.join(stated)}: slips are taken as exact here"] if stated else []


def _result(
    model, data: TireData, work: Search, priors, notes, borrowed: Collection[str]
) -> MagicFormulaFit:
    problem = work.problem
    values, of_part = problem.values(work.u), coefficients_of(problem.tire.version)
    scale = problem.scale(work.u)
    covariance = work.covariance * np.outer(scale, scale)
    shares = np.diagonal(work.covariance)
    coefficients = {
        name: Coefficient(
            values[name], float(np.sqrt(covariance[i, i])),
            _origin(
                bool(problem.free[i]), shares[i], name in work.moved - work.held,
                name in borrowed,
            ),
            of_part[name], priors[name].centre, priors[name].std,
        )
        for i, name in enumerate(problem.names)
    }  # fmt: skip
    forces = tuple(work.fitted)
    notes = [*notes, *(_far_text(force, work.far[force]) for force in work.far)]
    loads = np.concatenate([work.rows[force].inputs.fz for force in forces])
    speeds = np.concatenate([work.rows[force].inputs.v for force in forces])
    tire = with_values(problem.tire, values)
    ranges = _ranges([work.rows[force] for force in forces])
    guarded = tuple(force for force in forces if force in ("fx", "fy"))
    return MagicFormulaFit(
        model=model,
        parts=tuple(stage.name for stage in work.stages if stage.name in PARTS),
        forces=forces,
        coefficients=coefficients,
        covariance=covariance,
        tire=tire,
        noise={force: _law(work, force) for force in forces},
        noise_estimated={force: work.rows[force].estimated for force in forces},
        inflation=dict(work.inflation),
        fitted=dict(work.fitted),
        stages=tuple(work.stages),
        guards=check_guards(tire, ranges, guarded) if guarded else (),
        ranges=ranges,
        reference={"fz": float(np.median(loads)), "v": float(np.median(speeds))},
        data=data_record(data, data.n, ()),
        notes=tuple(notes),
        version=importlib.metadata.version("tirefit"),
    )


def _far_text(force: str, count: int) -> str:
    return (
        f"{count} rows of {force} lie beyond {FAR:g} standard deviations; none is set"
        " aside: look at them, and mask what is wrong"
    )


def _origin(free: bool, share: float, moved: bool, borrowed: bool) -> str:
    """``share`` of the prior's variance is left."""
    if borrowed and not (free and moved and share <= 0.5):
        return "borrowed"
    if not free:
        return "given"
    if not moved:
        return "held"
    return "prior" if share > 0.5 else "fitted"


def _law(work: Search, force: str) -> NoiseLaw:
    rows = work.rows[force]
    if rows.estimated:
        return work.laws[force]
    share = rows.std / rows.inputs.fz
    if np.ptp(share) < 1e-9 * np.max(share) and np.ptp(rows.std) > 0:
        return NoiseLaw(0.0, float(np.median(share)))
    return NoiseLaw(float(np.median(rows.std)), 0.0)


def _ranges(rows: Sequence[ForceRows]) -> dict[str, tuple[float, float]]:
    """Least and largest value of each input, in ISO-W axes."""
    ranges = {}
    for name in ("sigma_x", "alpha", "gamma", "fz", "pressure"):
        column = np.concatenate([getattr(one.inputs, name) for one in rows])
        if name == "sigma_x":
            name, column = "kappa", -np.asarray(kappa_from_sigma(column))
        ranges[name] = (float(np.min(column)), float(np.max(column)))
    if ranges["pressure"][1] == 0:
        del ranges["pressure"]
    return ranges
