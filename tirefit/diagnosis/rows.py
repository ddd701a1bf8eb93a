"""Data as the diagnosis sees them: slips, covariates, and what could be seen at all."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from tirefit.data.table import TireData
from tirefit.diagnosis.rates import Sweeps, slip_rate
from tirefit.diagnosis.slip_check import SlipCheck, check_slip
from tirefit.diagnosis.state import Covariates
from tirefit.models import TireInputs
from tirefit.results import DataError, InputProblem

__all__ = ["Prepared", "neighbours", "prepare", "thinned"]

MODES = {"x": ("fx",), "y": ("fy", "mz"), "xy": ("fx", "fy", "mz")}
"""Slips that drive the forces -> forces that may be diagnosed."""

_ONE_SLIP = 10.0
"""Ratio of the spreads of two slips from which one drives and the other disturbs."""

_MOVES, _SPEEDS, _LOADS = 0.1, 0.2, 0.03
"""Median speed [m/s] that counts as moving; range of the speeds over their mean, and
standard deviation of log F_z, that count as several."""

_BOTH_SIGNS = 0.1
"""Share of the rows that each sign of slip must have."""

_WARMS, _LEANS = 0.4, 1e-4
"""Standard deviations of temperature [K] and camber [rad] that count as varying."""

_OTHER_MOVES, _OTHER_STANDS = 1e-4, 1e-3
"""Standard deviation and size of the other slip that count as there."""

_LEAST_ROWS = 20
"""Rows that a diagnosis needs."""

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
    are. ``slip_check`` is the slip column against that of the wheel speed.
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

    @property
    def n(self) -> int:
        return len(self.slip)

    def column(self, name: str) -> np.ndarray:
        """A column of the data, (n,)."""
        return self.data.usable(name)[self.kept]


def _varies(values, share: float = 0.0) -> bool:
    return bool(np.ptp(values) > max(share * np.mean(np.abs(values)), 1e-9))


def _mode(data: TireData) -> str:
    def drives(slip, force):
        return slip in data and force in data and np.std(data.usable(slip)) > 1e-6

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


def _column(data: TireData, name: str, default: float = 0.0) -> np.ndarray:
    return data.usable(name) if name in data else np.full(data.n, default)


def _centered(values, width: float) -> np.ndarray:
    return (values - np.mean(values)) / width


def _check(data: TireData) -> None:
    file = data.source.path or data.name
    if "fz" not in data:
        reason = "a diagnosis needs fz (load, N) for every row"
        remedy = "name its column with --column fz=HEADER, or --constant fz=4000"
        raise DataError(InputProblem(reason, remedy, file))
    if data.n < _LEAST_ROWS:
        reason = f"{data.n} usable rows: a diagnosis needs {_LEAST_ROWS} or more"
        raise DataError(InputProblem(reason, "measure more points", file))


def _channels(data: TireData, mode: str, given) -> tuple[str, ...]:
    """Measured forces of the slip that varies that a model gives."""
    channels = tuple(c for c in MODES[mode] if c in data and c in given)
    if not channels:
        reason = f"{' or '.join(MODES[mode])}, whose slip varies, is not simulated"
        remedy = f"the model gives {', '.join(given) or 'no force'}: choose another"
        file = data.source.path or data.name
        raise DataError(InputProblem(reason, remedy, file))
    return channels


def prepare(data: TireData, rig, model) -> Prepared:
    """Slips, channels and covariates of the used rows.

    Raises:
        DataError: no force with a slip that varies, or no load.
    """
    _check(data)
    mode = _mode(data)
    sigma, tan_alpha = _column(data, "sigma_x"), np.tan(_column(data, "alpha"))
    slip = tan_alpha if mode == "y" else sigma
    channels = _channels(data, mode, model)
    fz, v = data.usable("fz"), _column(data, "v")
    time = data.usable("time") if "time" in data else None
    run = data.run[data.used]
    sweeps = _sweeps(data, slip, mode, rig, time, run)
    std, source = _slip_std(data, mode, rig, sweeps.noise)
    other = sigma if mode == "y" else tan_alpha * (1 + sigma)
    other = np.zeros(data.n) if mode == "xy" else other
    omega = _column(data, "omega")
    spin = slip_rate(omega, time, run).rate if "omega" in data else 0 * v
    interval = np.full(data.n, sweeps.past.interval)
    radius = rig.radius_for(data)
    covariates = Covariates(
        fz=fz / np.exp(np.mean(np.log(fz))),
        v=v,
        time=_centered(time, max(np.ptp(time), 1e-9)) if time is not None else 0 * v,
        temperature=_centered(_column(data, "temperature"), 20.0),
        gamma=_column(data, "gamma"),
        rate=sweeps.rate,
        lag=sweeps.rate / np.maximum(np.abs(v), 0.5),
        turning=sweeps.turning,
        side=np.sign(slip),
        other=other,
        force=np.zeros(data.n),
        usage=np.zeros(data.n),
        spin=spin / radius if radius else 0 * v,
        load=np.full(data.n, np.mean(fz)),
        past=sweeps.past.path,
        pull=np.zeros_like(sweeps.past.path),
        interval=interval,
        step=interval * np.maximum(np.abs(v), 0.05),
        sliding=np.abs(v * (slip if mode == "y" else slip / (1 + slip))),
        change=np.zeros(data.n),
        traction=np.zeros(data.n),
    )
    inputs = TireInputs(
        np.zeros(data.n), np.zeros(data.n), fz, v, _column(data, "gamma"),
        _column(data, "pressure"), _column(data, "time"),
    )  # fmt: skip
    return Prepared(
        data, mode, channels, inputs, slip, std,
        tan_alpha if mode == "xy" else np.zeros(data.n),
        {c: data.usable(c) for c in channels}, covariates,
        TireInputs(*(sweeps.past.of(part) for part in inputs)),
        _holdings(data, mode, covariates, sweeps.found, radius), time, run,
        -1.0 if data.source.slip_definition in ("kappa", "s") else 1.0, source,
        rig.run_order == "random", np.arange(data.n),
        check_slip(data, rig.rolling_radius),
    )  # fmt: skip


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
    stated, _ = _slip_std(data, mode, rig, 0.0)
    return slip_rate(slip, time, run, float(np.median(stated)))


def _slip_std(data: TireData, mode: str, rig, scatter: float):
    """(noise of the slip (n,), where it comes from)."""
    name = "alpha" if mode == "y" else "sigma_x"
    if f"{name}_std" in data:
        return np.nan_to_num(data.usable(f"{name}_std")), f"column {name}_std"
    given = rig.slip_noise(name)
    if given is not None:
        return np.full(data.n, given), "given"
    if scatter:
        return np.full(data.n, scatter), "scatter about smooth sweeps"
    return np.zeros(data.n), "none assumed"


def _holdings(data: TireData, mode: str, rows, sweeps: bool, radius) -> frozenset:
    """Names of the needs of effects that this data meets."""
    positive = np.mean(rows.side > 0)
    found = {
        "v": "v" in data and float(np.median(np.abs(rows.v))) > _MOVES,
        "speeds": "v" in data and _varies(rows.v, _SPEEDS),
        "loads": float(np.std(np.log(rows.fz))) > _LOADS,
        "time": "time" in data and _varies(rows.time),
        "temperature": "temperature" in data and _varies(rows.temperature * 20, 0.0)
        and float(np.std(rows.temperature)) > _WARMS / 20,
        "gamma": "gamma" in data and float(np.std(rows.gamma)) > _LEANS,
        "signs": _BOTH_SIGNS < positive < 1 - _BOTH_SIGNS,
        "sweeps": sweeps,
        "omega": "omega" in data,
        "rolling_radius": radius is not None,
        "other slip": float(np.std(rows.other)) > _OTHER_MOVES
        or float(np.max(np.abs(rows.other))) > _OTHER_STANDS,
        "mz": mode != "x" and "mz" in data,
    }  # fmt: skip
    return frozenset(name for name, here in found.items() if here)


def neighbours(prepared: Prepared) -> list[np.ndarray]:
    """Rows of like load, speed and direction in the order of their slip: index arrays.

    What varies between neighbours there is noise, whatever the force does.
    """
    rows = prepared.covariates
    settings = np.stack([
        prepared.run, np.round(np.log(rows.fz) / 0.05),
        np.round(np.log(np.maximum(np.abs(rows.v), 0.1)) / 0.1), np.sign(rows.turning),
    ], axis=1)  # fmt: skip
    _, cell = np.unique(settings, axis=0, return_inverse=True)
    cell = np.ravel(cell)
    order = np.lexsort((prepared.slip, cell))
    return np.split(order, np.flatnonzero(np.diff(cell[order])) + 1)
