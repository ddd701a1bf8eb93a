"""The rows of one file as the diagnosis uses them: slips, forces, covariates."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from tirefit.data.rig.levels import levels
from tirefit.data.table import TireData
from tirefit.diagnosis.effects.state import Covariates
from tirefit.diagnosis.rows.covariates import (
    Derived,
    column,
    covariates_of,
    derived_from,
    needs_met,
    sizes_of,
)
from tirefit.diagnosis.rows.rig import Rig, SlipCheck, check_data, check_slip, unfit
from tirefit.diagnosis.rows.slips import slip_law, slip_rate
from tirefit.fitting.problem.build import check_slip_noise
from tirefit.fitting.problem.slip_noise import SlipDistribution, speed_of, std_with_speed
from tirefit.models import TireInputs

MODES = {"x": ("fx",), "y": ("fy", "mz"), "xy": ("fx", "fy", "mz")}
"""Slips that cause the forces -> forces that may be diagnosed."""

SCATTER = "scatter about smooth sweeps"
NOT_STATED = "none assumed"


@dataclass(frozen=True)
class Prepared:
    """The n used rows of one file.

    ``slip`` is the primary slip [-]: sigma_x, or tan(alpha) for lateral data.
    """

    data: TireData
    mode: str
    channels: tuple[str, ...]
    inputs: TireInputs
    slip: np.ndarray
    slip_std: np.ndarray  # noise of the slip
    second: np.ndarray  # tan(alpha) if both slips cause the forces
    observed: Mapping[str, np.ndarray]  # forces by channel
    covariates: Covariates
    before: TireInputs  # inputs in the past of each row (n, k)
    has: frozenset[str]  # needs of effects that the data meet
    time: np.ndarray | None
    run: np.ndarray
    definition: float
    slip_source: str
    random_order: bool
    kept: np.ndarray  # numbers of these rows among the used rows of the data
    slip_check: SlipCheck | None
    sizes: Mapping[str, float]  # units of the expected amplitudes
    derived: Derived | None  # None if the force was measured
    shown: float | None  # noise of the slip estimated from the forces, None without an estimate
    scatter: float  # white scatter of the slip about its path, 0 without a path

    @property
    def n(self) -> int:
        return len(self.slip)

    @cached_property
    def slip_law(self) -> SlipDistribution | None:
        """Distribution of the true slips; None without slip noise."""
        return slip_law(self.slip, self.slip_std)

    @cached_property
    def common(self) -> np.ndarray:
        """Share (n,) of the variance of each true slip that rows of one standing slip
        have in common, see :class:`SlipDistribution`."""
        if self.slip_law is None:
            return np.zeros(self.n)
        return self.slip_law.moments(self.slip, self.slip_std)[2]

    @property
    def past(self) -> np.ndarray | None:
        """Estimated slips before, at and after each row (n, k)."""
        return np.asarray(self.covariates.past) if "sweeps" in self.has else None

    @property
    def moving(self) -> list[np.ndarray]:
        """Load, speed and motion of the vehicle (n,), without those with settings."""
        names = ("fz", "v", "yaw", "lean", "ahead", "swing", "steering", "across")
        each = [np.asarray(getattr(self.covariates, name)) for name in names]
        return [values for values in each if not levels(values).few()]

    def column(self, name: str) -> np.ndarray:
        """A column of the data, (n,)."""
        return self.data.usable(name)[self.kept]


def _mode(data: TireData) -> str:
    """The slips that cause the forces, a key of :data:`MODES`."""
    along, across = (
        slip in data and force in data and np.std(data.usable(slip)) > 1e-6
        for slip, force in (("sigma_x", "fx"), ("alpha", "fy"))
    )
    if along and across:
        slips = data.usable("sigma_x"), np.tan(data.usable("alpha"))
        x, y = (np.std(np.clip(slip, -10, 10)) for slip in slips)  # beyond, all slides
        # A tenth of the other slip is a disturbance.
        return "x" if x > 10 * y else "y" if y > 10 * x else "xy"
    if not along and not across:
        reason = "no force with a slip that varies: a diagnosis needs fx with sigma_x"
        reason += " (or kappa, s), or fy with alpha"
        raise unfit(data, reason, "see `tirefit inspect`")
    return "x" if along else "y"


def prepare(
    data: TireData, rig: Rig, model: tuple[str, ...], shown: float | None = None
) -> Prepared:
    """The used rows, for the forces of a model. ``shown`` is the noise of the slip by the
    forces, used if it is not stated; None for the scatter about sweeps. Raises DataError."""
    check_data(data, (), rig)
    mode = _mode(data)
    slip, zero = slip_of(data, mode), np.zeros(data.n)
    second = np.tan(column(data, "alpha")) if mode == "xy" else zero
    channels = tuple(c for c in MODES[mode] if c in data and c in model)
    if not channels:
        reason = f"{' or '.join(MODES[mode])}, whose slip varies, is not simulated"
        remedy = f"the model gives {', '.join(model) or 'no force'}: choose another"
        raise unfit(data, reason, remedy)
    time, run = order_of(data)
    stated, _ = _slip_std(data, mode, rig, 0.0, None)
    measured = mode == "y" and "alpha_rate" in data
    rate = data.usable("alpha_rate") * (1 + slip**2) if measured else None
    sweeps = slip_rate(slip, time, run, float(np.median(stated)), rate, shown)
    std, source = _slip_std(data, mode, rig, sweeps.noise, shown)
    if source != SCATTER:
        check_slip_noise(data, "alpha" if mode == "y" else "sigma_x", std)
    check_data(data, channels, rig)
    radius = rig.radius_for(data)
    covariates = covariates_of(data, mode, sweeps, slip, second, radius)
    fz, derived = data.usable("fz"), derived_from(data, channels[0])
    if derived is not None and derived.steered:
        turned = data.usable("fy") * np.tan(data.usable("steering"))
        covariates = covariates._replace(pivot=covariates.across - turned)
    pressure, at = column(data, "pressure"), column(data, "time")
    inputs = TireInputs(zero, zero, fz, covariates.v, covariates.gamma, pressure, at)
    return Prepared(
        data, mode, channels, inputs, slip, std, second,
        {c: data.usable(c) for c in channels}, covariates,
        TireInputs(*(sweeps.past.of(part) for part in inputs)),
        needs_met(data, mode, covariates, sweeps.present, radius, derived), time, run,
        -1.0 if data.source.slip_definition in ("kappa", "s") else 1.0, source,
        rig.run_order == "random", np.arange(data.n), check_slip(data, rig.rolling_radius),
        sizes_of(covariates, slip, float(np.mean(fz)), radius), derived, shown, sweeps.noise,
    )  # fmt: skip


def slip_of(data: TireData, mode: str) -> np.ndarray:
    """The primary slip [-] of the used rows, (n,)."""
    if mode == "y":
        return np.tan(column(data, "alpha"))
    return column(data, "sigma_x")


def order_of(data: TireData) -> tuple[np.ndarray | None, np.ndarray]:
    """Time, or None, and run (n,) of the used rows."""
    return data.usable("time") if "time" in data else None, data.run[data.used]


def on_scale_of(prepared: Prepared, fitted: Prepared) -> Prepared:
    """The rows with the typical values of the fitted rows, so that amplitudes agree."""
    here, there = prepared.covariates, fitted.covariates
    typical = ("load", "brisk", "cruise", "rise", "peak")
    constants = {name: np.full(prepared.n, getattr(there, name)[0]) for name in typical}
    first = np.asarray(fitted.inputs.fz)[0]
    load = np.asarray(prepared.inputs.fz) * (there.fz[0] / first)
    return replace(prepared, covariates=here._replace(fz=load, **constants))


def thinned(prepared: Prepared, most: int) -> Prepared:
    """At most ``most`` rows, evenly spread, each with its past."""
    if prepared.n <= most:
        return prepared
    rows = np.linspace(0, prepared.n - 1, most).astype(int)

    def some(parts: Any) -> Any:
        return type(parts)(*(part[rows] for part in parts))

    plain = ("slip", "slip_std", "second", "run", "kept")
    return replace(
        prepared,
        inputs=some(prepared.inputs),
        covariates=some(prepared.covariates),
        before=some(prepared.before),
        observed={c: x[rows] for c, x in prepared.observed.items()},
        time=None if prepared.time is None else prepared.time[rows],
        **{name: getattr(prepared, name)[rows] for name in plain},
    )


def _slip_std(
    data: TireData, mode: str, rig: Rig, scatter: float, shown: float | None
) -> tuple[np.ndarray, str]:
    """(noise of the slip (n,), its source): stated, else the one ``shown`` by the forces,
    else the ``scatter`` about smooth sweeps."""
    name = "alpha" if mode == "y" else "sigma_x"
    if f"{name}_std" in data:
        return np.nan_to_num(data.usable(f"{name}_std")), f"column {name}_std"
    given, of_speed = rig.slip_noise(name), rig.slip_noise(name, "_speed")
    if of_speed is not None:
        return std_with_speed(given or 0.0, of_speed, speed_of(data)), "given"
    seen = (scatter, SCATTER) if shown is None else (shown, "scatter where the force is steep")
    for size, source in ((given, "given"), seen):
        if size:
            return np.full(data.n, size), source
    return np.zeros(data.n), NOT_STATED


def neighbours(prepared: Prepared) -> list[np.ndarray]:
    """Index arrays of rows of the same run, load, speed and direction in the order of
    slip, whose neighbours differ only by noise."""
    rows = prepared.covariates
    # A rig holds a load to 5 %, a driver a speed to 10 %.
    load, speed = np.round(np.log(rows.fz) / 0.05), np.round(np.log(rows.pace) / 0.1)
    settings = np.stack([prepared.run, load, speed, np.sign(rows.turning)], axis=1)
    cell = np.ravel(np.unique(settings, axis=0, return_inverse=True)[1])
    order = np.lexsort((prepared.slip, cell))
    return np.split(order, np.flatnonzero(np.diff(cell[order])) + 1)
