"""Data as the diagnosis sees them: slips, covariates, and what could be seen at all."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tirefit.data.levels import levels
from tirefit.data.table import TireData
from tirefit.diagnosis.effects.state import Covariates
from tirefit.diagnosis.negligible import FLAT, ROUNDING
from tirefit.diagnosis.rows.demands import check_data, check_force_noise
from tirefit.diagnosis.rows.motion import (
    Derived,
    derived_from,
    motion_of,
    seen_in_motion,
    wheel_radius,
)
from tirefit.diagnosis.rows.rates import AHEAD, Sweeps, segments, slip_rate
from tirefit.diagnosis.rows.run_codes import shown_runs
from tirefit.diagnosis.rows.sizes import Sizes, half_force_slip, largest, sizes_of
from tirefit.diagnosis.rows.slip_check import SlipCheck, check_slip
from tirefit.diagnosis.rows.slip_nodes import slip_law, swing_of
from tirefit.diagnosis.rows.work import work_of_sliding
from tirefit.fitting.problem import check_slip_noise
from tirefit.fitting.slip_noise import SlipDistribution, speed_of, std_with_speed
from tirefit.models import TireInputs
from tirefit.results import DataError, InputProblem

MODES = {"x": ("fx",), "y": ("fy", "mz"), "xy": ("fx", "fy", "mz")}
"""Slips that drive the forces -> forces that may be diagnosed."""

_ONE_SLIP = 10.0
"""Ratio of the spreads of two slips from which one drives and the other disturbs."""

_SPEEDS, LOADS, _PRESSURES = 0.2, 0.03, 0.02
"""Range of the speeds over their mean, standard deviation of log F_z, and range of the
pressures over their mean, that count as several."""

_SCATTER = "scatter about smooth sweeps"
_SHOWN = "scatter where the force is steep"
NOT_STATED = "none assumed"

_MOVE = ("fz", "v", "yaw", "lean", "ahead", "swing", "steering", "across")
"""Covariates that may know the true slip better than the slip as measured does."""

_OF_BASE = ("force", "usage", "change", "traction") + tuple(
    name for name in Covariates._fields if name.startswith("run_")
)
"""Covariates that the base fit gives."""

_DRIVES = 1e-6
"""Standard deviation of a slip from which it drives: less is one value."""

_WARMER = 20.0
"""Unit of the temperature [K]: a tire that warms up rises by one or two of them."""

_LIKE_LOADS, _LIKE_SPEEDS = 0.05, 0.1
"""Steps of log F_z and log v within which rows are neighbours: what a rig holds a load
and a driver a speed to."""

_STANDS = 0.03
"""Share of the usual speed below which a tire counts as standing: a slip of so little
way is no slip of a rolling tire."""

_BESIDE = 0.02
"""Spread of the force across over that of the force, from which it may disturb it."""

_BOTH_SIGNS = 0.1
"""Share of the rows that each sign of slip must have."""

_WARMS, _LEANS = 0.4, 1e-4
"""Standard deviations of temperature [K] and camber [rad] that count as varying."""

_OTHER_MOVES, _OTHER_STANDS = 1e-4, 1e-3
"""Standard deviation and size of the other slip that count as there."""

_FAR = 10.0
"""Slip beyond which a patch slides whatever the tire."""


@dataclass(frozen=True)
class Prepared:
    """The used rows of one file, n of them.

    ``slip`` (n,) is the primary slip [-]: sigma_x, or tan(alpha) for lateral data;
    ``slip_std`` its noise; ``second`` (n,) is tan(alpha) where both drive. ``observed``
    holds (n,) by channel. ``covariates`` lacks only what the base fit gives. ``has``
    names what the data hold of the needs of the effects. ``before`` are the inputs in
    the past of each row (n, k), ``kept`` (n,) which of the used rows of the data these
    are. ``slip_check`` is the slip column against that of the wheel speed, ``sizes``
    what large means in this file, ``derived`` how the force follows from the motion of
    a vehicle, None where it was measured.
    """

    data: TireData
    mode: str
    channels: tuple[str, ...]
    inputs: TireInputs
    slip: np.ndarray
    slip_std: np.ndarray
    second: np.ndarray
    observed: Mapping[str, np.ndarray]
    covariates: Covariates
    before: TireInputs
    has: frozenset[str]
    time: np.ndarray | None
    run: np.ndarray
    definition: float
    slip_source: str
    random_order: bool
    kept: np.ndarray
    slip_check: SlipCheck | None
    sizes: Sizes
    derived: Derived | None

    @property
    def n(self) -> int:
        return len(self.slip)

    @cached_property
    def slip_law(self) -> SlipDistribution | None:
        """Distribution of the latent slips; None where the slips have no noise."""
        return slip_law(self.slip, self.slip_std)

    @property
    def slip_scatter(self) -> float:
        """Noise of the slip as the forces show it; zero where it is known otherwise."""
        return float(self.slip_std[0]) if self.slip_source == _SHOWN else 0.0

    @property
    def path(self) -> np.ndarray | None:
        """Slips (n,) as their neighbours in time show them; None where they do not."""
        return None if self.past is None else self.past[:, AHEAD]

    @property
    def past(self) -> np.ndarray | None:
        """The same before, at and after each row (n, k)."""
        return np.asarray(self.covariates.past) if "sweeps" in self.has else None

    @property
    def swing(self) -> np.ndarray | None:
        """Slips (n,) as sines in time; None where they do not sweep."""
        if "sweeps" not in self.has:
            return None
        return swing_of(self.slip, self.time, segments(self.time, self.run))

    @property
    def moving(self) -> list[np.ndarray]:
        """What was measured beside the slip and moves with it, or may: load, speed and
        the motion of a vehicle (n,), of these what is not set to a few levels."""
        each = [np.asarray(getattr(self.covariates, name)) for name in _MOVE]
        return [values for values in each if not levels(values).few()]

    def column(self, name: str) -> np.ndarray:
        """A column of the data, (n,)."""
        return self.data.usable(name)[self.kept]


def _varies(values, share: float = 0.0) -> bool:
    return bool(np.ptp(values) > max(share * np.mean(np.abs(values)), FLAT))


def _mode(data: TireData) -> str:
    def drives(slip, force):
        return slip in data and force in data and np.std(data.usable(slip)) > _DRIVES

    along, across = drives("sigma_x", "fx"), drives("alpha", "fy")
    if along and across:
        # One slip that hardly moves is a disturbance of the other, not a second sweep.
        # A locked wheel and a slip angle of 90 degrees slip without limit.
        x = np.clip(data.usable("sigma_x"), -_FAR, _FAR)
        y = np.clip(np.tan(data.usable("alpha")), -_FAR, _FAR)
        ratio = np.std(x) / np.std(y)
        return "x" if ratio > _ONE_SLIP else "y" if ratio < 1 / _ONE_SLIP else "xy"
    if not along and not across:
        raise DataError(
            InputProblem(
                "no force with a slip that varies: a diagnosis needs fx with sigma_x"
                " (or kappa, s), or fy with alpha",
                "see `tirefit inspect`",
                data.source.path or data.name,
            )
        )
    return "x" if along else "y"


def _column(data: TireData, name: str) -> np.ndarray:
    return data.usable(name) if name in data else np.zeros(data.n)


def _centered(values, width: float) -> np.ndarray:
    return (values - np.mean(values)) / width


def _over_range(values) -> np.ndarray:
    """About their mean, over their range; zero where nothing varies."""
    span = np.ptp(values)
    varies = span > FLAT * np.max(np.abs(values))
    return _centered(values, span) if varies else np.zeros(len(values))


def _channels(data: TireData, mode: str, given) -> tuple[str, ...]:
    """Measured forces of the slip that varies that a model gives."""
    channels = tuple(c for c in MODES[mode] if c in data and c in given)
    if not channels:
        reason = f"{' or '.join(MODES[mode])}, whose slip varies, is not simulated"
        remedy = f"the model gives {', '.join(given) or 'no force'}: choose another"
        file = data.source.path or data.name
        raise DataError(InputProblem(reason, remedy, file))
    return channels


def prepare(data: TireData, rig, model, slip_scatter: float = 0.0) -> Prepared:
    """Slips, channels and covariates of the used rows.

    Args:
        slip_scatter: noise of the slip, for where nothing else tells it.

    Raises:
        DataError: no force with a slip that varies, no load, too few rows, a force that
            is far beyond all loads, or more noise stated than values vary by.
    """
    check_data(data)
    mode = _mode(data)
    sigma, tan_alpha = _column(data, "sigma_x"), np.tan(_column(data, "alpha"))
    slip = tan_alpha if mode == "y" else sigma
    second = tan_alpha if mode == "xy" else np.zeros(data.n)
    channels = _channels(data, mode, model)
    time = data.usable("time") if "time" in data else None
    run = data.run[data.used]
    sweeps = _sweeps(data, slip, mode, rig, time, run)
    std, source = _slip_std(data, mode, rig, sweeps.noise, slip_scatter)
    if source != _SCATTER:
        check_slip_noise(data, "alpha" if mode == "y" else "sigma_x", std)
    check_force_noise(data, channels, rig)
    other = sigma if mode == "y" else tan_alpha * (1 + sigma)
    other = np.zeros(data.n) if mode == "xy" else other
    radius = rig.radius_for(data)
    covariates = _covariates(data, mode, sweeps, np.hypot(slip, second), radius)
    covariates = covariates._replace(side=np.sign(slip), other=other)
    fz, derived = data.usable("fz"), derived_from(data, channels[0])
    if derived is not None and derived.steered:
        turned = data.usable("fy") * np.tan(data.usable("steering"))
        covariates = covariates._replace(pivot=covariates.across - turned)
    has = _holdings(data, mode, covariates, sweeps.present, radius)
    has |= {name for name, here in seen_in_motion(data, derived).items() if here}
    inputs = TireInputs(
        np.zeros(data.n), np.zeros(data.n), fz, covariates.v, _column(data, "gamma"),
        _column(data, "pressure"), _column(data, "time"),
    )  # fmt: skip
    return Prepared(
        data, mode, channels, inputs, slip, std, second,
        {c: data.usable(c) for c in channels}, covariates,
        TireInputs(*(sweeps.past.of(part) for part in inputs)),
        has, time, run,
        -1.0 if data.source.slip_definition in ("kappa", "s") else 1.0, source,
        rig.run_order == "random", np.arange(data.n),
        check_slip(data, rig.rolling_radius),
        sizes_of(covariates, slip, float(np.mean(fz)), radius)._replace(
            wheel=radius or wheel_radius(data, derived)
        ),
        derived,
    )  # fmt: skip


def _force_of(data: TireData, mode: str) -> np.ndarray:
    """The force that the slip drives, its size where both slips do: (n,)."""
    if mode == "xy":
        return np.hypot(_column(data, "fx"), _column(data, "fy"))
    return _column(data, f"f{mode}")


def _covariates(data: TireData, mode: str, sweeps: Sweeps, size, radius) -> Covariates:
    """What the columns give of the covariates; ``size`` (n,) is that of the slip."""
    fz, v, zero = data.usable("fz"), _column(data, "v"), np.zeros(data.n)
    time = _column(data, "time")
    force, omega = _force_of(data, mode), _column(data, "omega")
    run = data.run[data.used]
    spin = slip_rate(omega, time, run).rate if "omega" in data else zero
    interval = np.full(data.n, sweeps.past.interval)
    usual = float(np.median(np.abs(v)))
    pace = np.maximum(np.abs(v), _STANDS * usual if usual else 1.0)
    way = sweeps.rate / pace
    sliding = v * (size if mode == "y" else size / (1 + _column(data, "sigma_x")))
    sliding = np.abs(sliding)
    across = {"x": "fy", "y": "fx"}.get(mode, "")
    work = work_of_sliding(np.abs(force) * sliding, data, time, run)
    steering = _column(data, "steering")
    steering_rate = _column(data, "steering_rate") if "steering_rate" in data else None
    return Covariates(
        fz=fz / np.exp(np.mean(np.log(fz))),
        v=v,
        time=_over_range(time),
        temperature=_centered(_column(data, "temperature"), _WARMER),
        inflation=_over_range(_column(data, "pressure")),
        gamma=_column(data, "gamma"),
        rate=sweeps.rate,
        lag=way * np.std(size) / max(np.sqrt(np.mean(way**2)), ROUNDING),
        turning=sweeps.turning,
        side=zero,
        other=zero,
        spin=spin / radius if radius else zero,
        load=np.full(data.n, np.mean(fz)),
        past=sweeps.past.path,
        pull=np.zeros_like(sweeps.past.path),
        twist=np.zeros_like(sweeps.past.path),
        burden=sweeps.past.of(fz) / fz[:, None],
        interval=interval,
        step=interval * pace,
        pace=pace,
        sliding=sliding,
        brisk=np.full(data.n, max(largest(sliding), ROUNDING)),
        cruise=np.full(data.n, np.exp(np.mean(np.log(pace)))),
        rise=np.full(data.n, half_force_slip(size, force / fz)),
        peak=np.full(data.n, largest(force / fz)),
        work=np.stack([_over_range(part) for part in work.T], axis=1),
        across=_column(data, across),
        yaw=_column(data, "yaw_rate") / pace,
        ahead=_over_range(_column(data, "a_x")),
        **motion_of(data),
        pivot=zero,
        steered=sweeps.past.of(steering, steering_rate, time),
        **dict.fromkeys(_OF_BASE, zero),
    )


def on_scale_of(prepared: Prepared, fitted: Prepared) -> Prepared:
    """The same rows with the typical values of those that were fitted: an amplitude
    found there means the same here."""
    here, there = prepared.covariates, fitted.covariates
    typical = ("load", "brisk", "cruise", "rise", "peak")
    constants = {name: np.full(prepared.n, getattr(there, name)[0]) for name in typical}
    first = np.asarray(fitted.inputs.fz)[0]
    load = np.asarray(prepared.inputs.fz) * (there.fz[0] / first)
    return replace(prepared, covariates=here._replace(fz=load, **constants))


def thinned(prepared: Prepared, most: int) -> Prepared:
    """At most so many rows, evenly spread; what they know of their past stays."""
    if prepared.n <= most:
        return prepared
    rows = np.linspace(0, prepared.n - 1, most).astype(int)

    def some(parts):
        return type(parts)(*(part[rows] for part in parts))

    plain = ("slip", "slip_std", "second", "run", "kept")
    return replace(
        prepared, inputs=some(prepared.inputs), covariates=some(prepared.covariates),
        before=some(prepared.before),
        observed={c: x[rows] for c, x in prepared.observed.items()},
        time=None if prepared.time is None else prepared.time[rows],
        **{name: getattr(prepared, name)[rows] for name in plain},
    )  # fmt: skip


def _sweeps(data: TireData, slip, mode: str, rig, time, run) -> Sweeps:
    """How the slip moves, by the noise that is stated for it."""
    stated, _ = _slip_std(data, mode, rig, 0.0, 0.0)
    rate = None
    if mode == "y" and "alpha_rate" in data:
        rate = data.usable("alpha_rate") * (1 + slip**2)
    return slip_rate(slip, time, run, float(np.median(stated)), rate)


def _slip_std(data: TireData, mode: str, rig, scatter: float, shown: float):
    """(noise of the slip (n,), where it comes from): stated, else the ``scatter`` about
    smooth sweeps, else what the forces have ``shown``."""
    name = "alpha" if mode == "y" else "sigma_x"
    if f"{name}_std" in data:
        return np.nan_to_num(data.usable(f"{name}_std")), f"column {name}_std"
    given, of_speed = rig.slip_noise(name), rig.slip_noise_speed(name)
    if of_speed is not None:
        return std_with_speed(given or 0.0, of_speed, speed_of(data)), "given"
    if given is not None:
        return np.full(data.n, given), "given"
    if scatter:
        return np.full(data.n, scatter), _SCATTER
    if shown:
        return np.full(data.n, shown), _SHOWN
    return np.zeros(data.n), NOT_STATED


def _holdings(data: TireData, mode: str, rows, sweeps: bool, radius) -> frozenset:
    """Names of the needs of effects that this data meets."""
    positive = np.mean(rows.side > 0)
    met = {
        "v": "v" in data and float(np.median(np.abs(rows.v))) > 0,
        "speeds": "v" in data and _varies(rows.v, _SPEEDS),
        "loads": float(np.std(np.log(rows.fz))) > LOADS,
        "time": "time" in data and _varies(rows.time),
        "temperature": "temperature" in data and _varies(rows.temperature * _WARMER)
        and float(np.std(rows.temperature)) > _WARMS / _WARMER,
        "pressure": "pressure" in data
        and _varies(_column(data, "pressure"), _PRESSURES),
        "gamma": "gamma" in data and float(np.std(rows.gamma)) > _LEANS,
        "signs": _BOTH_SIGNS < positive < 1 - _BOTH_SIGNS,
        "sweeps": sweeps,
        "omega": "omega" in data,
        "rolling_radius": radius is not None,
        "other slip": float(np.std(rows.other)) > _OTHER_MOVES
        or float(np.max(np.abs(rows.other))) > _OTHER_STANDS,
        "mz": mode != "x" and "mz" in data,
        "other force": np.std(rows.across) > _BESIDE * np.std(_force_of(data, mode)),
        "yaw_rate": "yaw_rate" in data and np.std(rows.yaw) > 0,
        "a_x": "a_x" in data and np.any(rows.ahead != 0),
        "work": np.any(rows.work) and np.any(rows.time),
        "runs": len(shown_runs(data.run[data.used], data.runs)) > 1,
    }  # fmt: skip
    return frozenset(name for name, here in met.items() if here)


def neighbours(prepared: Prepared) -> list[np.ndarray]:
    """Rows of like load, speed and direction in the order of their slip: index arrays.

    What varies between neighbours there is noise, whatever the force does.
    """
    rows = prepared.covariates
    settings = np.stack([
        prepared.run, np.round(np.log(rows.fz) / _LIKE_LOADS),
        np.round(np.log(rows.pace) / _LIKE_SPEEDS), np.sign(rows.turning),
    ], axis=1)  # fmt: skip
    _, cell = np.unique(settings, axis=0, return_inverse=True)
    cell = np.ravel(cell)
    order = np.lexsort((prepared.slip, cell))
    return np.split(order, np.flatnonzero(np.diff(cell[order])) + 1)
