"""Fit a whole Magic Formula: :func:`fit_magic_formula`."""

import importlib.metadata
import os
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from tirefit.data.accept import DataLike, as_data
from tirefit.data.read import require
from tirefit.data.table import TireData
from tirefit.data.tir.tir import TirFile, read_tir
from tirefit.fitting.estimate import data_record
from tirefit.fitting.mf.bins import binned, rig_settings
from tirefit.fitting.mf.guards import check_guards
from tirefit.fitting.mf.left_out import LEAVE_OUT, Band, cross_validated
from tirefit.fitting.mf.parts import (
    HELD,
    MOMENTS,
    NEARLY_PURE,
    NEVER_FITTED,
    PARTS,
    SLIPS_OF,
    VERSIONS,
    coefficients_of,
    own_coefficients,
    parts_named,
)
from tirefit.fitting.mf.priors import (
    LOGARITHMIC,
    Prior,
    borrowed_from,
    normal_form,
    published_priors,
    with_dimensions,
)
from tirefit.fitting.mf.result import Coefficient, MagicFormulaFit
from tirefit.fitting.mf.rows import ForceRows, groups_of, joined, rows_of_part
from tirefit.fitting.mf.solve import Problem, row_values
from tirefit.fitting.mf.stages import Search, search
from tirefit.fitting.problem.config import FitConfig, ParameterConfig, parse_config
from tirefit.models.mf import MAGIC_FORMULAS, MFTire, frictions
from tirefit.models.mf.fields import Nominal, Scaling
from tirefit.params import check_names, check_values, specs, with_values
from tirefit.precision import require_x64
from tirefit.results import InputProblem, UsageError
from tirefit.slip import kappa_from_sigma

_FAR = 7.0
"""Standard deviations (of noise and misfit) beyond which a row is reported as far."""

_REACHED = 0.9
"""Share of mu F_z that some row must reach for the friction to be measured."""


def fit_magic_formula(
    data: DataLike | Sequence[DataLike],
    model: str = "mf61",
    *,
    part: str = "all",
    config: FitConfig | dict[str, Any] | None = None,
    first: Mapping[str, float] | None = None,
    like: TirFile | str | os.PathLike[str] | None = None,
    leave_out: str = "three",
    progress: Callable[[float, str], None] = lambda share, note: None,
) -> MagicFormulaFit:
    """Fit every coefficient of a Magic Formula, with its standard error and origin.

    Each force is fitted to its own rows, pure slip before combined slip. The moments follow; they
    do not move coefficients of the forces. Gaussian priors from published tires keep coefficients
    that the data do not determine at physical values. Then parts of the data are left out in turn
    and predicted from the others; the errors of these predictions set the bands.

    Args:
        data: the result of ``tirefit.read``, or a file that it reads; a list of these
            counts as runs of one data set and need not hold the same columns.
        model: ``mf52``, ``mf61`` or ``mf62``.
        part: ``fx``, ``fy`` or ``mz`` in pure slip; ``all`` or ``combined`` for these,
            combined slip, ``mx`` and ``my``, as far as the data hold them; ``mx`` or
            ``my`` for that moment and the forces.
        config: content of ``fit.toml``: noise of the forces; under ``parameters`` the
            nominal state (FNOMIN, UNLOADED_RADIUS, NOMPRES), and value, ``free`` and
            prior of coefficients.
        first: coefficients of a tire that may be similar, as an additional start.
        like: a ``.tir`` whose coefficients are prior means, if not in config.
        leave_out: ``three`` leaves out the bins of three loads in turn, ``load`` those
            of each load, ``none`` nothing.
        progress: called with the share done and the name of the next step.

    Returns:
        The fit; its ``save`` writes a ``.tir``.

    Raises:
        UsageError: unknown model, part or coefficient, a setting that a Magic Formula
            does not have, or 32-bit floats in use.
        DataError: no force with its slip, or too few rows of one.

    Example:
        >>> swept = simulate("rig", lateral=True, load=(3e3, 5e3), points=60)
        >>> found = fit_magic_formula(swept.columns, "mf52", part="fy", leave_out="none")
        >>> found.coefficients["PCY1"].origin
        'fitted'
    """
    require_x64("a fit")
    check_names("Magic Formula", [model], VERSIONS)
    check_names("leave_out", [leave_out], LEAVE_OUT)
    parts = parts_named(part)
    if isinstance(config, dict):
        config = parse_config(config)
    config = config or FitConfig()
    tables: Sequence[DataLike] = data if isinstance(data, list | tuple) else [data]  # type: ignore
    whole = joined([as_data(table) for table in tables])
    _check_settings(model, config)
    require(whole, ("fz",), f"the model {model}")
    rows, notes = rows_of_part(whole, part, config)
    other = like if like is None or isinstance(like, TirFile) else read_tir(Path(like))
    constants = whole.source.constants
    if other is not None:
        config, taken = with_dimensions(other, rows, config, constants)
        notes += taken
    also = other.numbers if other else ()
    tire, assumed = nominal_of(model, rows, config, constants, also)
    borrowed, borrowing = borrowed_from(other, tire, rows, config) if other else ({}, [])
    notes += [*assumed, *borrowing]
    of_slips = [f"{slip}_std" for slip in ("sigma_x", "alpha") if f"{slip}_std" in whole]
    keys = ("sigma_x", "alpha", "sigma_x_speed", "alpha_speed")
    of_slips += [f"noise.{key}" for key in keys if getattr(config.noise, key)]
    if of_slips:
        reason = "not used, a Magic Formula fit takes the slips as exact"
        notes.append(f"{', '.join(of_slips)}: {reason}")
    problem, priors = problem_from(tire, config, borrowed)
    settings_of = {force: rig_settings(of_force) for force, of_force in rows.items()}
    settings = {force: of_force for force, (of_force, _) in settings_of.items()}
    rows = {force: replace(of, setting=settings_of[force][1]) for force, of in rows.items()}
    centre = np.zeros(len(problem.names))
    start = problem.started(centre, normal_form(first)) if first else None
    # As many stages as kinds of rows, and about as many parts left out.
    steps, done = 2 * sum(len(set(of.pure)) for of in rows.values()), count()

    def say(note: str) -> None:
        now = next(done)
        progress(now / max(steps, now + 1), note)

    work = search(problem, groups_of(rows, "combined" in parts), start, say)
    left_out, bands = cross_validated(work, rows, settings, leave_out, say)
    coefficients, covariance = _coefficients(work, bands, priors, borrowed.keys())
    result = _result(model, whole, work, rows, bands, notes)
    return MagicFormulaFit(
        **result, coefficients=coefficients, covariance=covariance, left_out=left_out
    )


def _check_settings(model: str, config: FitConfig) -> None:
    """Raises one UsageError for all settings that a Magic Formula does not have."""
    coefficients, faults = coefficients_of(VERSIONS[model]), []
    given = {*specs(Nominal()), *specs(Scaling()), *NEVER_FITTED}
    for name, asked in config.parameters.items():
        if name not in coefficients and (name not in given or asked.value is None):
            remedy = f"its coefficients are {', '.join(coefficients)}"
            faults.append((f"parameters.{name}: {model} does not fit it", remedy))
        wrong = [key for key in ("lower", "upper", "tied", "per_run") if getattr(asked, key)]
        if asked.value is not None and asked.free and asked.prior is None:
            wrong.append("value with free")
        if wrong:
            reason = f"parameters.{name}: {', '.join(wrong)} in a Magic Formula"
            faults.append((reason, "give value to hold it there, or a prior of mean and std"))
    if brush := {"force", "solver", "starts", "posterior"} & config.model_fields_set:
        reason = f"{', '.join(sorted(brush))} in a Magic Formula"
        faults.append((reason, "leave it out: a Magic Formula is fitted in fixed stages"))
    if config.noise.loss not in ("squares", FitConfig().noise.loss):
        faults.append((f"noise.loss = {config.noise.loss!r} in a Magic Formula", "leave it out"))
    UsageError.raise_for([InputProblem(*fault, config.source) for fault in faults])


def nominal_of(
    model: str,
    rows: Mapping[str, ForceRows],
    config: FitConfig,
    constants: Mapping[str, float] | None = None,
    also: Iterable[str] = (),
) -> tuple[MFTire, list[str]]:
    """The tire with its nominal state and the given values, and notes on assumptions.

    It has M_x or M_y if the data do, or ``config`` or ``also`` name a coefficient.

    Args:
        constants: ``Source.constants`` of the data file, which replace assumptions; the
            configuration replaces both.
        also: further names of coefficients.
    """
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
    load = float(np.median(first.column("fz")))
    rounded = {"FNOMIN": load, "NOMPRES": pressure, "LONGVL": speed, "UNLOADED_RADIUS": 0.3}
    assumed = {name: float(f"{value:.3g}") for name, value in rounded.items()}
    stated = {k: v for k, v in (constants or {}).items() if k in assumed}
    assumed |= stated
    assumed["INFLPRES"] = given.get("NOMPRES", assumed["NOMPRES"])
    reason = "the median pressure" if len(pressures) else "the data have no pressure"
    origins = {"FNOMIN": "the median load", "NOMPRES": reason}
    if {"mz", *MOMENTS} & rows.keys():
        origins["UNLOADED_RADIUS"] = "no radius is given; only the moments depend on it"
    origins |= dict.fromkeys(stated, "stated by the data file")
    notes = [
        f"{name} = {assumed[name]:g}: {why} (parameters.{name}.value gives another)"
        for name, why in origins.items()
        if name not in given
    ]
    return with_values(empty, assumed | given), notes


def problem_from(
    tire: MFTire, config: FitConfig, borrowed: Mapping[str, Prior] | None = None
) -> tuple[Problem, dict[str, Prior]]:
    """The problem without rows, and the priors: those of ``config``, else those
    ``borrowed``, else the published ones."""
    known = specs(tire)
    names = tuple(name for name in coefficients_of(tire.version) if name in known)
    usual = {**published_priors(), **(borrowed or {})}
    priors, free = {}, []
    for name in names:
        asked = config.parameters.get(name) or ParameterConfig(free=False if name in HELD else None)
        prior = usual[name]
        if asked.prior is not None:
            mean, std = asked.prior.mean, asked.prior.std
            is_log = name in LOGARITHMIC and mean > 0
            prior = Prior(mean, std / mean if is_log else std, is_log)
        elif asked.value is not None:
            prior = prior._replace(centre=asked.value, log=False)
        priors[name] = prior
        free.append(asked.free is not False and (asked.value is None or asked.prior is not None))
    centre = np.array([prior.centre for prior in priors.values()])
    spread = np.array([prior.spread for prior in priors.values()])
    log = np.array([prior.log for prior in priors.values()])
    tire = with_values(tire, dict(zip(names, centre.tolist(), strict=True)))
    return Problem(tire, names, centre, spread, log, np.array(free), ()), priors


def _coefficients(
    work: Search, bands: Mapping[str, Band], priors: Mapping[str, Prior], borrowed: Collection[str]
) -> tuple[dict[str, Coefficient], np.ndarray]:
    """The coefficients, and their covariance (p, p) with the factors of the bands.

    Args:
        borrowed: coefficients whose prior is that of another tire.
    """
    problem, of_part = work.problem, coefficients_of(work.problem.tire.version)
    scale, values = problem.scale(work.u), problem.values(work.u)
    for force, band in bands.items():
        of_rows = own_coefficients(problem.tire.version, force)
        scale = scale * np.where(np.isin(problem.names, of_rows), band.wider, 1.0)
    covariance = work.covariance * np.outer(scale, scale)
    coefficients = {}
    for i, name in enumerate(problem.names):
        if not problem.free[i]:
            origin = "given"
        elif name not in work.moved - work.held:
            origin = "held"
        else:  # by the posterior variance over that of the prior
            origin = "prior" if work.covariance[i, i] > 0.5 else "fitted"
        if origin != "fitted" and name in borrowed:
            origin = "borrowed"
        std, prior = float(np.sqrt(covariance[i, i])), priors[name]
        known = of_part[name], prior.centre, prior.std
        coefficients[name] = Coefficient(values[name], std, origin, *known)
    return coefficients, covariance


def _result(
    model: str,
    data: TireData,
    work: Search,
    rows: Mapping[str, ForceRows],
    bands: Mapping[str, Band],
    notes: Sequence[str],
) -> dict[str, Any]:
    """The fields of the result, without those of the coefficients."""
    problem, forces = work.problem, tuple(work.groups)
    tire = with_values(problem.tire, problem.values(work.u))
    every = [rows[force] for force in forces]
    kinds = {force: [group.pure for group in groups] for force, groups in work.groups.items()}
    used = {force: rows[force].part(rows[force].chosen(kinds[force])) for force in forces}
    missed = {
        force: row_values(problem, work.u, force, some.inputs) - some.observed
        for force, some in used.items()
    }
    ranges = _ranges(every)
    # A force whose own slip was not swept has no curve to guard.
    curves = [force for force in forces if force in ("fx", "fy")]
    slips = {force: rows[force].column(SLIPS_OF[force][0]) for force in curves}
    guarded = tuple(force for force, slip in slips.items() if np.ptp(slip) > 2 * NEARLY_PURE)
    typical = {
        k: float(np.median(np.concatenate([r.column(k) for r in every]))) for k in ("fz", "v")
    }
    return dict(
        model=model,
        parts=tuple(part for part in PARTS if part in {s.part for s in work.stages}),
        forces=forces,
        tire=tire,
        noise={force: bands[force].law for force in forces},
        noise_estimated={force: rows[force].estimated for force in forces},
        wider={force: bands[force].wider for force in forces},
        inflation={force: work.rows_per_one(force) for force in forces},
        fitted={force: (_size(off), len(off)) for force, off in missed.items()},
        stages=tuple(
            stage._replace(rmse_at_end=work.rmse(group))
            for stage in work.stages
            for group in work.groups[stage.force]
            if group.pure == stage.pure
        ),
        guards=check_guards(tire, ranges, guarded) if guarded else (),
        ranges=ranges,
        reference=typical | {of.force: _size(of.observed) for of in every},
        data=data_record(data, data.n, ()),
        notes=(*notes, *_far(work, used, missed), *_not_reached(work, tire)),
        version=importlib.metadata.version("tirefit"),
        binned={force: binned(rows[force]) for force in forces},
    )


def _size(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def _far(
    work: Search, used: Mapping[str, ForceRows], missed: Mapping[str, np.ndarray]
) -> list[str]:
    """Notes on the number of rows of each force that are far from the formula."""
    messages = []
    for force, off in missed.items():
        rows, groups = used[force], work.groups[force]
        predicted = off + rows.observed
        variance = [group.row_variance(rows.column("fz"), predicted) for group in groups]
        outlying = int(np.count_nonzero(off**2 > _FAR**2 * np.max(variance, axis=0)))
        if outlying:
            messages.append(
                f"residuals beyond {_FAR:g} standard deviations in {outlying} of"
                f" {len(off)} rows of {force}, which were fitted like the others:"
                " mask rows that are wrong"
            )
    return messages


def _not_reached(work: Search, tire: MFTire) -> list[str]:
    """Notes on friction coefficients that no row reaches."""
    messages = []
    for force, shape, peak in (("fx", "PCX1", "PDX1"), ("fy", "PCY1", "PDY1")):
        pure = [group.cells.inputs for group in work.groups.get(force, ()) if group.pure]
        if not pure or peak not in work.moved:
            continue
        given = row_values(work.problem, work.u, force, pure[0]) / np.asarray(pure[0].fz)
        share = float(np.max(np.abs(given / frictions(tire, pure[0])[force])))
        if share < _REACHED:
            value = work.problem.values(work.u)[peak]
            messages.append(
                f"{peak} = {value:.3g} is not a measured friction: {force} reaches only"
                f" {share:.0%} of it within the slips of the data, so {peak} and"
                f" {shape} trade off; measure larger slips, or give one of them"
            )
    return messages


def _ranges(rows: Sequence[ForceRows]) -> dict[str, tuple[float, float]]:
    """(Least, largest) value of each input, in ISO-W axes."""
    ranges = {}
    for name in ("sigma_x", "alpha", "gamma", "fz", "pressure"):
        column = np.concatenate([getattr(row.inputs, name) for row in rows])
        if name == "sigma_x":
            name, column = "kappa", -np.asarray(kappa_from_sigma(column))
        ranges[name] = (float(np.min(column)), float(np.max(column)))
    if ranges["pressure"][1] == 0:
        del ranges["pressure"]
    return ranges
