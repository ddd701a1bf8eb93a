"""Build a well-posed fit from data, a model and a configuration."""

import difflib
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Array

from tirefit.arrays import Kept
from tirefit.data.far import problem_at
from tirefit.data.read import require
from tirefit.data.table import TireData
from tirefit.fitting.problem.config import FitConfig, NoiseConfig, ParameterConfig
from tirefit.fitting.problem.layout import Layout, choose_layout
from tirefit.fitting.problem.likelihood import CHANNEL_SLIP, Channel, FitProblem, Rows, Rule
from tirefit.fitting.problem.slip_noise import speed_of, std_with_speed
from tirefit.models import MODELS, AbstractTire, TireInputs, modelled
from tirefit.padding import pad_rows, padded_size
from tirefit.params import parameter_values, specs
from tirefit.results import DataError, InputProblem, UsageError


@dataclass(frozen=True)
class FitTask:
    """A problem, with further data that do not enter the compiled program."""

    name: str
    problem: FitProblem
    guess: Mapping[str, float]  # first value of every free parameter
    time: np.ndarray | None  # (n,) orders the rows
    notes: tuple[str, ...]  # what was assumed
    data: TireData  # its used rows are those of the problem


def find_model(name: str) -> AbstractTire:
    """The registered model of this name.

    Raises:
        UsageError: no such model; names the closest ones.
    """
    if name in MODELS:
        return MODELS[name]
    from tirefit.models.mf import MAGIC_FORMULAS  # which no other model waits for

    if name in MAGIC_FORMULAS:
        reason = f"{name} is a whole Magic Formula, which is fitted in stages"
        remedy = f"`tirefit fit --model {name}`, fit_magic_formula in Python; what it"
        remedy += " writes, fit.json and fit.tir, is a tire"
        raise UsageError(reason, remedy)
    if os.path.isfile(name):
        remedy = "a file of a tire ends in .json (a fit) or .tir; `tirefit models` lists the names"
        raise UsageError(f"{name!r} is a file, not the name of a model", remedy)
    close = difflib.get_close_matches(name, MODELS, 3)
    hint = f"did you mean {', '.join(close)}? " if close else ""
    raise UsageError(f"unknown model {name!r}", f"{hint}`tirefit models` lists them")


def _chosen_forces(data: TireData, config: FitConfig) -> tuple[tuple[str, ...], list[str]]:
    possible = [c for c, slip in CHANNEL_SLIP.items() if c in data and slip in data]
    if config.force is not None:
        needed = [column for name in config.force for column in (name, CHANNEL_SLIP[name])]
        require(data, list(dict.fromkeys(needed)), f"a fit of {', '.join(config.force)}")
        return tuple(dict.fromkeys(config.force)), []
    varied = [c for c in possible if np.ptp(data.usable(CHANNEL_SLIP[c])) > 1e-9]
    if not varied:
        raise DataError(
            "no force with a slip that varies: a fit needs fx with sigma_x (or"
            " kappa, s), or fy with alpha",
            "see `tirefit inspect`",
            data.file,
        )
    chosen = varied[0]
    rest = [name for name in varied if name != chosen]
    note = f"fitted force: {chosen} against {CHANNEL_SLIP[chosen]}"
    if rest:
        note += f"; {', '.join(rest)} not fitted (set `force` in fit.toml to fit it)"
    return (chosen,), [note]


def _column_wins(name: str, noise: NoiseConfig) -> str:
    """The note on noise from a column, and the settings that it overrides."""
    settings = {key: getattr(noise, key) for key in _noise_keys(name, noise)}
    rest = " and ".join(f"noise.{key} = {value:g}" for key, value in settings.items())
    return f"noise of {name}: column {name}_std" + (f"; {rest} not used beside it" if rest else "")


def _noise_keys(name: str, noise: NoiseConfig) -> list[str]:
    """The settings of the noise of a force or a slip that are given."""
    keys = (name, f"{name}_relative", f"{name}_speed")
    return [key for key in keys if getattr(noise, key, None) is not None]


def force_scale(data: TireData, name: str, noise: NoiseConfig) -> tuple[np.ndarray, bool, str]:
    """(scale (n_used,), estimated?, sentence) of one force."""
    if f"{name}_std" in data:
        scale = data.usable(f"{name}_std")
        return scale, False, _column_wins(name, noise)
    absolute = getattr(noise, name, None)
    relative = getattr(noise, f"{name}_relative", None)
    if absolute is not None:
        return np.full(data.n, absolute), False, f"noise of {name}: {absolute:g} given"
    if relative is not None:
        return (relative * data.usable("fz"), False, f"noise of {name}: {relative:g} fz given")
    observed = data.usable(name)
    size = 0.05 * float(np.sqrt(np.mean(observed**2))) or 1.0
    if noise.proportional_to_load:
        fz = data.usable("fz")
        shape = fz / np.mean(fz)
        return size * shape, True, f"noise of {name}: estimated, proportional to load"
    return np.full(data.n, size), True, f"noise of {name}: estimated from the residuals"


def _slip_scale(data: TireData, slip: str, noise: NoiseConfig) -> tuple[np.ndarray | None, str]:
    given, of_speed = getattr(noise, slip), getattr(noise, f"{slip}_speed")
    if f"{slip}_std" in data:
        return data.usable(f"{slip}_std"), _column_wins(slip, noise)
    if of_speed is not None:
        std = std_with_speed(given or 0.0, of_speed, speed_of(data))
        beside = f" and {given:g}" if given is not None else ""
        return std, f"noise of {slip}: {of_speed:g} m/s over v{beside} given"
    if given is not None:
        return np.full(data.n, given), f"noise of {slip}: {given:g} given"
    return None, f"noise of {slip}: none assumed"


def _noise_problems(
    data: TireData, forces: Sequence[str], config: FitConfig
) -> tuple[list[InputProblem], list[InputProblem]]:
    """Noise, in columns or settings, at which squared residuals overflow or vanish."""
    given = {name: force_scale(data, name, config.noise) for name in forces}
    stds = {name: std for name, (std, estimated, _) in given.items() if not estimated}
    for slip in dict.fromkeys(CHANNEL_SLIP[name] for name in forces):
        std, _ = _slip_scale(data, slip, config.noise)
        stds |= {} if std is None else {slip: std}
    of_columns, of_settings = [], []
    for name, std in stds.items():
        largest = float(np.max(np.abs(data.usable(name)))) or 1.0
        if name not in forces:
            # The slip of a locked wheel, and its noise, represent infinity.
            largest, std = min(largest, 1.0), np.minimum(std, 1.0)
        wrong = np.flatnonzero((std < 1e-9 * largest) | (std > 1e9 * largest))
        if not len(wrong):
            continue
        beside = f"is not a noise level beside {name} up to {largest:.4g}"
        column = f"{name}_std"
        if column in data:
            row = int(np.flatnonzero(data.used)[wrong[0]])
            rows = f" ({len(wrong)} such rows)" if len(wrong) > 1 else ""
            reason = f"{data[column][row]:.3g} {beside}{rows}"
            remedy = "correct the column or its unit, or leave it out"
            of_columns.append(problem_at(data, row, column, reason, remedy))
            continue
        key = _noise_keys(name, config.noise)[0]
        reason = f"noise.{key} = {getattr(config.noise, key):g} {beside}"
        remedy = f"give the true noise of {name}, or leave noise.{key} out"
        of_settings.append(InputProblem(reason, remedy, config.source))
    return of_columns, of_settings


def _settled(
    data: TireData, model: AbstractTire, forces: Sequence[str], config: FitConfig
) -> tuple[AbstractTire, Layout, list[str]]:
    """Result of ``choose_layout``; its problems and those of the noise are raised together."""
    of_columns, of_settings = _noise_problems(data, forces, config)
    try:
        chosen = choose_layout(model, config, data.runs, forces)
    except UsageError as error:
        raise UsageError([*error.problems, *of_settings]) from None
    UsageError.raise_for(of_settings)
    DataError.raise_for(of_columns)
    return chosen


def check_slip_noise(data: TireData, slip: str, std: np.ndarray) -> None:
    """Raises DataError if the stated noise (n,) of a slip is as large as the spread of
    the measured slips: no slip is then known."""
    noise, spread = float(np.median(std)), float(np.std(data.usable(slip)))
    if noise > 0.7 * spread:
        column = f"{slip}_std" if f"{slip}_std" in data else None
        raise DataError(
            f"the noise of {slip} ({noise:.3g}) is as large as the spread of the"
            f" measured slips (standard deviation {spread:.3g}): the slip of a row is"
            " unknown",
            f"check the unit of the noise, {column or f'noise.{slip}'}",
            data.file,
            column=column,
        )


def _put(values: np.ndarray, size: int) -> Array:
    """Rows padded, on the device; ``jnp.asarray`` would compile a program for each shape."""
    return jax.device_put(pad_rows(values, size))


def inputs_of(data: TireData) -> TireInputs:
    """Inputs (n_used,) of the used rows, zero for a column that the data lack or a gap in it."""
    columns = (data.columns.get(name, np.zeros(len(data))) for name in TireInputs._fields)
    return TireInputs(*(np.nan_to_num(column[data.used].astype(float)) for column in columns))


def _first_guess(
    model: AbstractTire, data: TireData, forces: Sequence[str], layout: Layout
) -> dict[str, float]:
    """Guess from the slope of the low-slip half and from the largest force."""
    name = "fx" if "fx" in forces else ("fy" if "fy" in forces else None)
    guess = {p.name: float(parameter_values(model)[p.name]) for p in layout.free}
    if name is None:
        return guess
    stiffness, peak, load = slope_and_peak(data, name)
    largest = np.max(np.abs(data.usable(CHANNEL_SLIP[name])))
    stiffness = max(1.2 * stiffness, peak * load / max(largest, 1e-6))
    peak = min(max(1.03 * peak, 0.02), 4.0)
    of_curve = guess_from_curve(stiffness, peak, load)
    return {name: of_curve.get(name, value) for name, value in guess.items()}


def slope_and_peak(data: TireData, force: str) -> tuple[float, float, float]:
    """Slope of a force at small slip [N], its largest value over the load, and the typical
    load [N]."""
    slip, value, load = data.usable(CHANNEL_SLIP[force]), data.usable(force), data.usable("fz")
    size = np.abs(slip)
    low = size <= max(np.quantile(size, 0.3), 0.15 * size.max())
    slope = float(slip[low] @ value[low] / max(slip[low] @ slip[low], 1e-12))
    return slope, float(np.quantile(np.abs(value) / load, 0.97)), float(np.median(load))


def guess_from_curve(stiffness: Kept, peak: Kept, load: Kept) -> dict[str, Kept]:
    """Start values of the parameters, from slope and peak of the curve.

    Args:
        stiffness: slope of the force at small slip [N].
        peak: largest force over load [-].
        load: typical load [N].
    """
    factor = stiffness / (1.5 * peak * load)
    return {
        "cpa2": stiffness / 2,
        "mu": peak,
        "mu_peak": peak,
        "mu_c": 0.6 * peak,
        "mu_s": 1.5 * peak,
        "sigma0": 10 * stiffness / load,  # 2 C / (F_z 2a), the patch 0.2 m long
        **dict.fromkeys(("D", "Dx", "Dy"), peak),
        **dict.fromkeys(("B", "Bx", "By"), factor),
    }


def _check_size(data: TireData, problem: FitProblem) -> None:
    values, unknowns = problem.n * len(problem.channels), problem.unknowns
    if values <= unknowns:
        noise = " and the noise level" if problem.noise_estimated else ""
        reason = f"{values} measured values for {unknowns} unknowns"
        reason += f" ({', '.join(problem.layout.labels)}{noise})"
        raise DataError(reason, "measure more points, or fix parameters in fit.toml", data.file)


def build(data: TireData, name: str, config: FitConfig, least_rows: int = 8) -> FitTask:
    """Choose forces, noise, free parameters and a first guess.

    Args:
        least_rows: rows to pad to, at least, so that small files share one program.

    Raises:
        UsageError: unknown model or parameter, impossible bounds, ties or noise.
        DataError: missing columns or rows, or a noise column that is not positive.
    """
    template = find_model(name)
    forces, notes = _chosen_forces(data, config)
    _check_inputs(data, name, template, forces, config)
    config, messages = _with_reference_load(data, template, config)
    model, layout, narrowed = _settled(data, template, forces, config)
    notes += [*messages, *narrowed]
    size = padded_size(data.n, least_rows)
    observed, scale, channels = {}, {}, []
    slips = dict.fromkeys(CHANNEL_SLIP.values())
    noisy = [s for s in slips if _slip_scale(data, s, config.noise)[0] is not None]
    slip_of = slip_of_forces(data, template, forces, noisy)
    for force in forces:
        values, estimated, note = force_scale(data, force, config.noise)
        observed[force] = _put(data.usable(force), size)
        scale[force] = _put(values, size)
        channels.append(Channel(force, estimated, slip_of[force]))
        notes.append(note)
    slip_std = {}
    for slip in dict.fromkeys(slip_of.values()):
        std, note = _slip_scale(data, slip, config.noise)
        notes.append(note)
        if std is not None:
            check_slip_noise(data, slip, std)
            slip_std[slip] = _put(std, size)
    rows = Rows(
        inputs=jax.tree.map(lambda values: _put(values, size), inputs_of(data)),
        run=_put(data.run[data.used].astype(int), size),
        weight=jax.device_put((np.arange(size) < data.n).astype(float)),
        observed=observed,
        scale=scale,
        slip_std=slip_std,
        nodes={},
    )
    guess = _first_guess(model, data, forces, layout)
    guess |= {k: v.value for k, v in config.parameters.items() if v.value is not None}
    problem = FitProblem(
        model=model,
        rows=rows,
        rules={force: Rule() for force in forces},
        layout=layout,
        channels=tuple(channels),
        is_huber=config.noise.loss == "huber",
    )
    _check_size(data, problem)
    time = data.usable("time") if "time" in data else None
    return FitTask(name, problem, guess, time, tuple(notes), data)


def _check_inputs(
    data: TireData, name: str, model: AbstractTire, forces: Sequence[str], config: FitConfig
) -> None:
    if missing := [force for force in forces if force not in modelled(model)]:
        reason = f"the model {name} has no {' and no '.join(missing)}"
        remedy = f"it has {', '.join(modelled(model))}: fit these (force), or another model"
        raise UsageError(reason, remedy)
    require(data, ("fz", *model.needs), f"the model {name}")
    if model.transient:
        reason = f"{name} follows the slip through time, which must have no noise"
        remedy = "fit the steady model, or remove the noise of the slip"
        for slip in dict.fromkeys(CHANNEL_SLIP[force] for force in forces):
            if keys := _noise_keys(slip, config.noise):
                raise UsageError(f"noise.{keys[0]}: {reason}", remedy, config.source)
            if (column := f"{slip}_std") in data:
                raise UsageError(InputProblem(reason, remedy, data.file, column=column))
        check_time_series(data, name)
    if data.n == 0:
        raise DataError("no usable row", "see `tirefit inspect`", data.file)


def check_time_series(data: TireData, name: str) -> None:
    """Raises DataError unless the used rows of each run are contiguous, with rising time.

    Args:
        data: with a time column.
        name: name of the transient model, for the message.
    """
    rows = np.flatnonzero(data.used)
    run, time = data.run[rows], data["time"][rows]
    same = run[1:] == run[:-1]
    # Each run begins only once, after the end of the previous run.
    again = ~same & ~np.isin(np.arange(1, len(run)), np.unique(run, return_index=True)[1])
    problems = []
    for wrong, reason in (
        (again, "the rows of run {run!r} are not contiguous"),
        (same & ~(np.diff(time) > 0), "time {time:g} s is not after {before:g} s"),
    ):
        if not wrong.any():
            continue
        at = int(np.argmax(wrong)) + 1
        text = reason.format(run=data.runs[run[at]], time=time[at], before=time[at - 1])
        more = f" ({wrong.sum()} such rows)" if wrong.sum() > 1 else ""
        text += f"{more}; {name} follows the slip through time"
        remedy = "sort the rows by run and time, and name the runs in a column run"
        problems.append(problem_at(data, int(rows[at]), "time", text, remedy))
    DataError.raise_for(problems)


def _with_reference_load(
    data: TireData, model: AbstractTire, config: FitConfig
) -> tuple[FitConfig, list[str]]:
    """The configuration with a reference load, by default chosen here, and a note."""
    asked = config.parameters.get("fz0", ParameterConfig())
    if "fz0" not in specs(model) or asked.value is not None:
        return config, []
    load = float(f"{np.median(data.usable('fz')):.6g}")
    given = config.parameters | {"fz0": asked.model_copy(update={"value": load})}
    message = f"reference load fz0: {load:g} N, the median (set parameters.fz0.value)"
    return config.model_copy(update={"parameters": given}), [message]


def slip_of_forces(
    data: TireData, model: AbstractTire, forces: Sequence[str], noisy: Collection[str]
) -> dict[str, str]:
    """Force -> the slip whose noise is integrated out for it.

    In pure slip, and for a model of pure slip, it is the slip of the force. In combined
    slip every force depends on both, so all share the latent values of the noisy one.

    Args:
        data: the rows to be fitted.
        model: the model of the fit.
        forces: the fitted forces.
        noisy: those of sigma_x and alpha whose noise is given.

    Raises:
        DataError: combined slip with noise of both slips.
    """
    of_force = {force: CHANNEL_SLIP[force] for force in forces}
    if not noisy or "sigma_x" not in data or "alpha" not in data:
        return of_force
    # Whether both slips matter together in more than a twentieth of the rows; that of a
    # locked wheel represents infinity.
    slips = np.nan_to_num([data.usable("sigma_x"), np.tan(data.usable("alpha"))])
    sizes = np.minimum(np.abs(slips), 1.0)
    is_combined = sizes.min(axis=0) > 0.05 * np.hypot(*sizes).max(initial=0.0)
    # Whether one slip changes the force of the other.
    both, along, across = (
        model(TireInputs(*each, 4000.0, 10.0)) for each in ((0.1, 0.1), (0.1, 0.0), (0.0, 0.1))
    )
    couples = any(
        a is not None and b is not None and abs(a - b) > 1e-6 * abs(b)
        for a, b in ((both.fx, along.fx), (both.fy, across.fy))
    )
    if not (couples and np.mean(is_combined) > 0.05):
        return of_force
    if len(noisy) > 1:
        raise DataError(
            "noise of both sigma_x and alpha in combined slip: every force depends"
            " on both slips, and only one noisy slip can be integrated out",
            "give the noise of the slip that matters more, and count that of the"
            " other as noise of the forces; or fit rows of pure slip",
            data.file,
        )
    (slip,) = noisy
    return dict.fromkeys(forces, slip)
