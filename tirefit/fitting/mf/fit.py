"""Fit a whole Magic Formula: :func:`fit_magic_formula`."""

import importlib.metadata
import os
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tirefit.data.accept import DataLike, as_data
from tirefit.data.read import require
from tirefit.data.table import TireData
from tirefit.data.tir import TirFile, read_tir
from tirefit.fitting.config import FitConfig, ParameterConfig, parse_config
from tirefit.fitting.estimate import data_record
from tirefit.fitting.mf.bins import binned, settings_of
from tirefit.fitting.mf.cells import groups_of
from tirefit.fitting.mf.guards import check_guards
from tirefit.fitting.mf.left_out import LEAVE_OUT, Band, LeftOut, cross_validated
from tirefit.fitting.mf.parts import (
    HELD,
    MOMENTS,
    NEARLY_PURE,
    NEVER_FITTED,
    PARTS,
    VERSIONS,
    coefficients_of,
    own_coefficients,
    parts_named,
)
from tirefit.fitting.mf.priors import (
    Borrowed,
    Prior,
    borrowed_from,
    normal_form,
    prior_given,
    published_priors,
    with_dimensions,
)
from tirefit.fitting.mf.result import Coefficient, MagicFormulaFit
from tirefit.fitting.mf.rows import ForceRows, joined, rows_of_part
from tirefit.fitting.mf.solve import Problem, row_values
from tirefit.fitting.mf.stages import Search, search
from tirefit.fitting.mf.temperature import UNUSED, at_reference
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
    config: FitConfig | dict | None = None,
    first: Mapping[str, float] | None = None,
    like: TirFile | str | os.PathLike | None = None,
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
            prior of coefficients; ``friction_temperature`` for a friction that changes
            with temperature (the coefficients then hold at its median).
        first: coefficients of a tire that may be similar, as an additional start.
        like: a ``.tir`` whose coefficients are prior means, if not in config.
        leave_out: ``three`` leaves out the bins of three loads in turn, ``load`` those
            of each load, ``bin`` each bin, ``none`` nothing.
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
    other = like if like is None or isinstance(like, TirFile) else read_tir(like)
    constants = whole.source.constants
    if other is not None:
        config, taken = with_dimensions(other, rows, config, constants)
        notes += taken
    also = other.numbers if other else ()
    tire, assumed = nominal_of(model, rows, config, constants, also)
    borrowed = borrowed_from(other, tire, rows, config) if other else Borrowed({}, ())
    notes += [*assumed, *borrowed.notes, *_unused_slip_noise(whole, config)]
    problem, priors = problem_from(tire, config, borrowed.priors)
    settings = {force: settings_of(of_force) for force, of_force in rows.items()}
    codes = {force: code for force, (_, code) in settings.items()}
    start = _start(problem, first) if first else None
    kinds = sum(len(set(of.pure)) for of in rows.values())
    say = _Steps(progress, kinds)

    def fitted_to(rows: Mapping[str, ForceRows]) -> Search:
        groups = groups_of(rows, codes, "combined" in parts)
        return search(problem, rows, groups, start, say)

    warmth = None
    if config.friction_temperature:
        require(whole, ("temperature",), "[model] friction_temperature")
        work, rows, warmth = at_reference(whole, rows, fitted_to)
        notes.append(warmth.text())
    else:
        work = fitted_to(rows)
        if "temperature" in whole:
            notes.append(UNUSED)
    left_out, bands = cross_validated(work, rows, settings, leave_out, say)
    fitted = _Fitted(work, rows, left_out, bands, borrowed.priors.keys())
    result = _result(model, whole, fitted, priors, notes)
    return replace(result, warmth=warmth)


class _Fitted(NamedTuple):
    """The search and its rows, the cross-validation and its bands, and the coefficients
    whose prior is that of another tire."""

    work: Search
    rows: Mapping[str, ForceRows]
    left_out: tuple[LeftOut, ...]
    bands: Mapping[str, Band]
    borrowed: Collection[str]


class _Steps:
    """Progress in steps: ``stages`` of them, and about as many parts left out."""

    def __init__(self, progress: Callable[[float, str], None], stages: int):
        self._progress, self._done, self._all = progress, 0, 2 * stages

    def __call__(self, note: str) -> None:
        self._progress(self._done / max(self._all, self._done + 1), note)
        self._done += 1


def _check_settings(model: str, config: FitConfig) -> None:
    """Raises one UsageError for all settings that a Magic Formula does not have."""
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
    brush = {"force", "solver", "starts", "posterior"} & config.model_fields_set
    if brush:
        reason = f"{', '.join(sorted(brush))} in a Magic Formula"
        remedy = "leave it out: a Magic Formula is fitted in fixed stages"
        problems.append(InputProblem(reason, remedy, config.source))
    if config.noise.loss not in ("squares", FitConfig().noise.loss):
        reason = f"noise.loss = {config.noise.loss!r} in a Magic Formula"
        problems.append(InputProblem(reason, "leave it out", config.source))
    UsageError.raise_for(problems)


def nominal_of(
    model: str,
    rows: Mapping[str, ForceRows],
    config: FitConfig,
    constants: Mapping[str, float] | None = None,
    also: Iterable[str] = (),
):
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
    assumed = {
        "FNOMIN": _rounded(float(np.median(first.column("fz")))),
        "NOMPRES": _rounded(pressure),
        "LONGVL": _rounded(speed),
        "UNLOADED_RADIUS": 0.3,
    }
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


def _start(problem: Problem, first: Mapping[str, float]) -> np.ndarray:
    """u (p,) of the given coefficients where they are free, else of the centres."""
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
    """The problem without rows, and the priors: those of ``config``, else those
    ``borrowed``, else the published ones."""
    known = specs(tire)
    names = tuple(name for name in coefficients_of(tire.version) if name in known)
    all_priors = {**published_priors(), **(borrowed or {})}
    priors = {name: all_priors[name] for name in names}
    usual = {name: ParameterConfig(free=False) for name in HELD}
    asked = {n: (usual | config.parameters).get(n, ParameterConfig()) for n in names}
    for name, one in asked.items():
        if one.prior is not None:
            priors[name] = prior_given(name, one.prior.mean, one.prior.std)
        elif one.value is not None:
            priors[name] = priors[name]._replace(centre=one.value, log=False)
    held = [
        one.free is False or (one.value is not None and one.prior is None) for one in asked.values()
    ]
    centre = np.array([priors[name].centre for name in names])
    spread = np.array([priors[name].spread for name in names])
    tire = with_values(tire, dict(zip(names, centre.tolist(), strict=True)))
    log = np.array([priors[name].log for name in names])
    return Problem(tire, names, centre, spread, log, ~np.array(held), ()), priors


def _unused_slip_noise(data: TireData, config: FitConfig) -> list[str]:
    """A note on stated noise of the slips, which this fit does not use."""
    stated = [f"{slip}_std" for slip in ("sigma_x", "alpha") if f"{slip}_std" in data]
    names = ("sigma_x", "alpha", "sigma_x_speed", "alpha_speed")
    stated += [f"noise.{name}" for name in names if getattr(config.noise, name)]
    reason = "not used, a Magic Formula fit takes the slips as exact"
    return [f"{', '.join(stated)}: {reason}"] if stated else []


def _result(model, data: TireData, fitted: _Fitted, priors, notes) -> MagicFormulaFit:
    work, rows, bands = fitted.work, fitted.rows, fitted.bands
    problem, forces = work.problem, tuple(work.groups)
    values, of_part = problem.values(work.u), coefficients_of(problem.tire.version)
    scale = problem.scale(work.u) * _wider(problem, bands)
    covariance = work.covariance * np.outer(scale, scale)
    shares = np.diagonal(work.covariance)
    coefficients = {
        name: Coefficient(
            value=values[name],
            std=float(np.sqrt(covariance[i, i])),
            origin=_origin(
                bool(problem.free[i]),
                shares[i],
                name in work.moved - work.held,
                name in fitted.borrowed,
            ),
            part=of_part[name],
            prior_mean=priors[name].centre,
            prior_std=priors[name].std,
        )
        for i, name in enumerate(problem.names)
    }
    residuals = {force: _residuals(work, rows[force]) for force in forces}
    tire = with_values(problem.tire, values)
    ranges = _ranges([rows[force] for force in forces])
    # A force whose own slip was not swept has no curve to guard.
    guarded = tuple(
        force
        for force in forces
        if force in ("fx", "fy") and rows[force].slip_range > 2 * NEARLY_PURE
    )
    return MagicFormulaFit(
        model=model,
        parts=tuple(part for part in PARTS if part in {s.part for s in work.stages}),
        forces=forces,
        coefficients=coefficients,
        covariance=covariance,
        tire=tire,
        noise={force: bands[force].law for force in forces},
        noise_estimated={force: rows[force].estimated for force in forces},
        wider={force: bands[force].wider for force in forces},
        inflation={force: work.rows_per_one(force) for force in forces},
        fitted={
            force: (float(np.sqrt(np.mean(missed**2))), len(missed))
            for force, missed in residuals.items()
        },
        stages=tuple(work.stages_at_end()),
        left_out=fitted.left_out,
        guards=check_guards(tire, ranges, guarded) if guarded else (),
        ranges=ranges,
        reference=_reference([rows[force] for force in forces]),
        data=data_record(data, data.n, ()),
        notes=(*notes, *_far(work, rows, residuals), *_not_reached(work, tire)),
        version=importlib.metadata.version("tirefit"),
        binned={force: binned(rows[force]) for force in forces},
    )


def _wider(problem: Problem, bands: Mapping[str, Band]) -> np.ndarray:
    """Factor (p,) of the standard error of each coefficient: that of its force."""
    factors = np.full(len(problem.names), 1.0)
    for force, band in bands.items():
        own = own_coefficients(problem.tire.version, force)
        factors[np.isin(problem.names, own)] = band.wider
    return factors


def _residuals(work: Search, rows: ForceRows) -> np.ndarray:
    """Predicted - measured force (n,) [N, N m] of the fitted rows."""
    fitted = rows.chosen([group.pure for group in work.groups[rows.force]])
    some = rows.part(fitted)
    return row_values(work.problem, work.u, rows.force, some.inputs) - some.observed


def _reference(rows: Sequence[ForceRows]) -> dict[str, float]:
    """Median load and speed, and the root mean square of each force."""
    loads = np.concatenate([of_force.column("fz") for of_force in rows])
    speeds = np.concatenate([of_force.column("v") for of_force in rows])
    sizes = {r.force: float(np.sqrt(np.mean(r.observed**2))) for r in rows}
    return {"fz": float(np.median(loads)), "v": float(np.median(speeds))} | sizes


def _far(work: Search, rows: Mapping[str, ForceRows], residuals) -> list[str]:
    """Notes on the number of rows of each force that are far from the formula."""
    messages = []
    for force, missed in residuals.items():
        groups = work.groups[force]
        some = rows[force].part(rows[force].chosen([g.pure for g in groups]))
        fz, predicted = some.column("fz"), missed + some.observed
        variance = np.max([g.row_variance(fz, predicted) for g in groups], axis=0)
        far = int(np.count_nonzero(missed**2 > _FAR**2 * variance))
        if far:
            messages.append(
                f"residuals beyond {_FAR:g} standard deviations in {far} of"
                f" {len(missed)} rows of {force}, which were fitted like the others:"
                " mask rows that are wrong"
            )
    return messages


def _not_reached(work: Search, tire: MFTire) -> list[str]:
    """Notes on friction coefficients that no row reaches."""
    messages = []
    for force, shape, peak in (("fx", "PCX1", "PDX1"), ("fy", "PCY1", "PDY1")):
        pure = [g.cells for g in work.groups.get(force, ()) if g.pure]
        if not pure or peak not in work.moved:
            continue
        cells = pure[0]
        fz = np.asarray(cells.inputs.fz)
        friction = np.abs(frictions(tire, cells.inputs)[force])
        given = np.abs(row_values(work.problem, work.u, force, cells.inputs))
        share = float(np.max(given / fz / friction))
        if share < _REACHED:
            value = work.problem.values(work.u)[peak]
            messages.append(
                f"{peak} = {value:.3g} is not a measured friction: {force} reaches only"
                f" {share:.0%} of it within the slips of the data, so {peak} and"
                f" {shape} trade off; measure larger slips, or give one of them"
            )
    return messages


def _origin(free: bool, share: float, moved: bool, borrowed: bool) -> str:
    """A key of :data:`ORIGINS`; ``share`` is the posterior over the prior variance."""
    if borrowed and not (free and moved and share <= 0.5):
        return "borrowed"
    if not free:
        return "given"
    if not moved:
        return "held"
    return "prior" if share > 0.5 else "fitted"


def _ranges(rows: Sequence[ForceRows]) -> dict[str, tuple[float, float]]:
    """(Least, largest) value of each input, in ISO-W axes."""
    ranges = {}
    for name in ("sigma_x", "alpha", "gamma", "fz", "pressure"):
        column = np.concatenate([getattr(one.inputs, name) for one in rows])
        if name == "sigma_x":
            name, column = "kappa", -np.asarray(kappa_from_sigma(column))
        ranges[name] = (float(np.min(column)), float(np.max(column)))
    if ranges["pressure"][1] == 0:
        del ranges["pressure"]
    return ranges
