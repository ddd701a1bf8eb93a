"""Fit a whole Magic Formula: :func:`fit_magic_formula`."""

import importlib.metadata
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from tirefit.data.accept import DataLike, as_data
from tirefit.data.read import require
from tirefit.data.tir.tir import TirFile, read_tir
from tirefit.fitting.estimate import data_record
from tirefit.fitting.mf.bins import binned, rig_settings
from tirefit.fitting.mf.guards import check_guards
from tirefit.fitting.mf.left_out import LEAVE_OUT, Band, cross_validated, rms
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
)
from tirefit.fitting.mf.priors import LOGARITHMIC, Prior, borrowed_from, published_priors
from tirefit.fitting.mf.result import Coefficient, MagicFormulaFit
from tirefit.fitting.mf.rows import ForceRows, groups_of, joined, rows_of_part
from tirefit.fitting.mf.solve import Problem, row_values
from tirefit.fitting.mf.stages import Search, search
from tirefit.fitting.problem.config import FitConfig, ParameterConfig, parse_config
from tirefit.fitting.problem.likelihood import CHANNEL_SLIP
from tirefit.models.mf import MAGIC_FORMULAS, MFTire
from tirefit.models.mf.fields import Nominal, Scaling
from tirefit.params import check_names, check_values, specs, with_values
from tirefit.precision import require_x64
from tirefit.results import InputProblem, UsageError
from tirefit.slip import kappa_from_sigma

_FAR = 7.0  # standard deviations of a measurement beyond which a row is reported as far


def fit_magic_formula(
    data: DataLike | Sequence[DataLike],
    model: str = "mf61",
    *,
    part: str = "all",
    config: FitConfig | dict[str, Any] | None = None,
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
        part: ``fx``, ``fy`` or ``mz`` in pure slip; ``all`` for these, combined slip,
            ``mx`` and ``my``, as far as the data hold them.
        config: content of ``fit.toml``: noise of the forces; under ``parameters`` the
            nominal state (FNOMIN, UNLOADED_RADIUS, NOMPRES), and value, ``free`` and
            prior of coefficients.
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
    check_names("part", [part], (*CHANNEL_SLIP, "all"))
    if isinstance(config, dict):
        config = parse_config(config)
    config = config or FitConfig()
    tables: Sequence[DataLike] = data if isinstance(data, list | tuple) else [data]  # type: ignore
    names = [f"data {k}" for k in range(1, len(tables) + 1)] if len(tables) > 1 else ["data"]
    whole = joined([as_data(*each) for each in zip(tables, names, strict=True)])
    _check_settings(model, config)
    require(whole, ("fz",), f"the model {model}")
    rows, notes = rows_of_part(whole, part, config)
    other = like if like is None or isinstance(like, TirFile) else read_tir(Path(like))
    constants = whole.source.constants
    tire, assumed = nominal_of(model, rows, config, constants, other)
    borrowed, borrowing = borrowed_from(other, tire, rows, config) if other else ({}, [])
    problem, priors = problem_from(tire, config, borrowed)
    settings = {}
    for force, of_force in rows.items():
        settings[force], code = rig_settings(of_force)
        rows[force] = replace(of_force, setting=code)
    groups, done = groups_of(rows), count()
    steps = 2 * sum(map(len, groups.values()))  # about as many parts are left out

    def say(note: str) -> None:
        now = next(done)
        progress(now / max(steps, now + 1), note)

    work = search(problem, groups, say)
    left_out, bands = cross_validated(work, rows, settings, leave_out, say)
    coefficients, covariance = _coefficients(work, bands, priors, borrowed.keys())
    return MagicFormulaFit(
        model=model,
        coefficients=coefficients,
        covariance=covariance,
        noise={force: band.law for force, band in bands.items()},
        wider={force: band.wider for force, band in bands.items()},
        left_out=left_out,
        data=data_record(whole, whole.n, ()),
        version=importlib.metadata.version("tirefit"),
        **_of_search(work, rows, bands, [*notes, *assumed, *borrowing]),
    )


def _check_settings(model: str, config: FitConfig) -> None:
    """Raises one UsageError for all settings that a Magic Formula does not have."""
    coefficients, faults = coefficients_of(VERSIONS[model]), []
    settable = {*specs(Nominal()), *specs(Scaling()), *NEVER_FITTED}
    for name, asked in config.parameters.items():
        if name not in coefficients and (name not in settable or asked.value is None):
            remedy = f"its coefficients are {', '.join(coefficients)}"
            faults.append((f"parameters.{name}: {model} does not fit it", remedy))
        wrong = [key for key in ("lower", "upper", "tied", "per_run") if getattr(asked, key)]
        if asked.value is not None and asked.free and asked.prior is None:
            wrong.append("value with free")
        if wrong:
            reason = f"parameters.{name}: {', '.join(wrong)} in a Magic Formula"
            faults.append((reason, "give value to hold it there, or a prior of mean and std"))
    names = "force", "solver", "starts", "posterior"
    unused = [str(k) for k in names if k in config.model_fields_set]
    unused += ["noise.loss"] * (config.noise.loss not in ("squares", FitConfig().noise.loss))
    if unused:
        reason = f"{', '.join(unused)} in a Magic Formula"
        faults.append((reason, "leave it out: a Magic Formula is fitted in fixed stages"))
    UsageError.raise_for([InputProblem(*fault, config.source) for fault in faults])


def nominal_of(
    model: str,
    rows: Mapping[str, ForceRows],
    config: FitConfig,
    constants: Mapping[str, float] | None = None,
    like: TirFile | None = None,
) -> tuple[MFTire, list[str]]:
    """The tire with its nominal state and the given values, and notes on assumptions.

    It has M_x or M_y if the data do, or ``config`` or ``like`` have a coefficient.

    Args:
        constants: ``Source.constants`` of the data file, which replace assumptions; the
            configuration replaces both.
        like: a similar tire. Its free radius replaces the assumed one, its nominal pressure
            if the test has none, and its QSX12 to QSX14 the zeros if M_x is not measured.
    """
    empty, there = MAGIC_FORMULAS[model], {} if like is None else like.numbers
    asked = {name[:3] for name in (*config.parameters, *there)}
    if "mx" not in rows and "QSX" not in asked:
        empty = replace(empty, overturning=None)
    if "my" not in rows and "QSY" not in asked:
        empty = replace(empty, rolling=None)
    given = {k: v.value for k, v in config.parameters.items() if v.value is not None}
    check_values(MAGIC_FORMULAS[model], model, given)
    assumed = {"FNOMIN": np.nan, "NOMPRES": 2.2e5, "LONGVL": 16.7, "UNLOADED_RADIUS": 0.3}
    for name, key in (("FNOMIN", "fz"), ("NOMPRES", "pressure"), ("LONGVL", "v")):
        measured = next(iter(rows.values())).column(key)
        if np.any(measured > 0):
            assumed[name] = float(f"{np.median(measured[measured > 0]):.3g}")
    is_known = bool(np.any(next(iter(rows.values())).column("pressure") > 0))
    reason = "the median pressure" if is_known else "the data have no pressure"
    origins = {"FNOMIN": "the median load", "NOMPRES": reason}
    if {"mz", *MOMENTS} & rows.keys():
        origins["UNLOADED_RADIUS"] = "no radius is given; only the moments depend on it"
    if like is not None:
        wanted = {"UNLOADED_RADIUS", *(() if "mx" in rows else NEVER_FITTED)}
        wanted |= set() if is_known else {"NOMPRES"}
        taken = {k: there[k] for k in wanted & specs(empty).keys() if there.get(k)}
        assumed |= taken
        origins |= dict.fromkeys(taken, f"that of {Path(like.path).name}")
    stated = {k: v for k, v in (constants or {}).items() if k in assumed}
    assumed |= stated
    origins |= dict.fromkeys(stated, "stated by the data file")
    assumed["INFLPRES"] = given.get("NOMPRES", assumed["NOMPRES"])
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
    centre, spread, log = map(np.array, zip(*priors.values(), strict=True))
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


def _of_search(
    work: Search, rows: Mapping[str, ForceRows], bands: Mapping[str, Band], notes: Sequence[str]
) -> dict[str, Any]:
    """The fields of the result that follow from rows and residuals."""
    problem = work.problem
    tire = with_values(problem.tire, problem.values(work.u))
    names = ("sigma_x", "alpha", "gamma", "fz", "pressure", "v")
    columns = {k: np.concatenate([of.column(k) for of in rows.values()]) for k in names}
    typical = {k: float(np.median(columns[k])) for k in ("fz", "v")}
    columns["kappa"] = -np.asarray(kappa_from_sigma(columns["sigma_x"]))
    inputs = ("kappa", "alpha", "gamma", "fz", *(["pressure"] if columns["pressure"].any() else []))
    ranges = {k: (float(np.min(columns[k])), float(np.max(columns[k]))) for k in inputs}
    missed, far = {}, []
    for force, of in rows.items():
        predicted = row_values(problem, work.u, force, of.inputs)
        missed[force] = predicted - of.observed
        variance = bands[force].law.variance(of.column("fz"), predicted)
        if outlying := int(np.count_nonzero(missed[force] ** 2 > _FAR**2 * variance)):
            far.append(
                f"residuals beyond {_FAR:g} standard deviations in {outlying} of {len(predicted)}"
                f" rows of {force}, which were fitted like the others: mask rows that are wrong"
            )
    # A force whose own slip was not swept has no curve to guard.
    guarded = [
        force
        for force in ("fx", "fy")
        if force in rows and np.ptp(rows[force].column(SLIPS_OF[force][0])) > 2 * NEARLY_PURE
    ]
    fitted_parts = {group.part for groups in work.groups.values() for group in groups}
    return dict(
        parts=tuple(part for part in PARTS if part in fitted_parts),
        forces=tuple(work.groups),
        tire=tire,
        inflation={force: work.rows_per_one(force) for force in rows},
        fitted={force: (rms(off), len(off)) for force, off in missed.items()},
        stages=work.stages,
        guards=check_guards(tire, ranges, guarded) if guarded else (),
        ranges=ranges,
        reference=typical | {force: rms(of.observed) for force, of in rows.items()},
        notes=(*notes, *far),
        binned={force: binned(of) for force, of in rows.items()},
    )
