"""Covariates of the rows, and typical sizes of a file: the units of the amplitudes, so
that one library of effects serves trucks and model cars."""

from typing import NamedTuple

import numpy as np

from tirefit.data.table import TireData
from tirefit.data.vehicle.findings import point_confirmed
from tirefit.diagnosis.effects.state import Covariates
from tirefit.diagnosis.engine import FLAT, ROUNDING
from tirefit.diagnosis.rows.rig import STANDS
from tirefit.diagnosis.rows.slips import Sweeps, segments, shown_runs, slip_rate
from tirefit.params import Values
from tirefit.slip import GRAVITY

LOADS, _ANGLE = 0.03, 1e-3
"""Spread above which a quantity varies: relative (loads, speeds, pressures, other forces),
and of camber, steering or the other slip [rad]."""


def _largest(values: Values) -> float:
    """Typical largest size of values (n,)."""
    return float(np.quantile(np.abs(values), 0.95))


def half_force_slip(slip: np.ndarray, share: np.ndarray) -> float:
    """Median size of the slips (n,) at 0.4 to 0.6 of the largest ``share``, the force
    over load (n,); at least a thousandth of the largest slip, which counts as 1 at most."""
    # At an angle of 90 degrees the slip is infinite: no unit for the error of a slip.
    size, share = np.minimum(np.abs(slip), 1.0), np.abs(share)
    top = _largest(share)
    half = (share > 0.4 * top) & (share < 0.6 * top)
    middle = np.median(size[half] if half.any() else size)
    return float(max(middle, FLAT + 1e-3 * _largest(size)))


def sizes_of(
    rows: Covariates, slip: np.ndarray, mean_load: float, radius: float | None
) -> dict[str, float]:
    """Units of the expected amplitudes of a file with these covariates, primary slips (n,), mean
    load [N] and rolling radius [m], None where unknown."""
    spread, rise = float(np.std(np.clip(slip, -1.0, 1.0))), float(rows.rise[0])

    def per(of: float, size: float | np.floating) -> float:  # the reciprocal of no range is 1
        return of / float(size) if size > ROUNDING else of

    def rms(values: Values | float) -> float:
        return np.sqrt(np.mean(values**2))

    speeds = np.ptp(rows.v)
    return {
        "plain": 1.0,
        "slip": rise,  # slip at half of the largest force over load
        "sliding": per(1.0, _largest(rows.sliding)),  # reciprocal range of the sliding speed [s/m]
        "rolling": per(1.0, speeds),  # that of the speed [s/m]
        "growth": per(rise, speeds),  # changes the slip by "slip" over the range of v [s/m]
        # The same over that of 1/v [m/s].
        "inverse_speed": per(rise, np.ptp(1 / rows.pace) if speeds > 0 else 0.0),
        # Time [s] and distance [m] in which the slip changes by its standard deviation.
        "period": per(spread, rms(rows.rate)),
        "way": per(spread, rms(rows.rate / rows.pace)),
        "temperature": per(1.0, np.ptp(rows.temperature)),  # reciprocal range in 20 K
        # Changes the slip by "slip" at the usual yaw rate over v [m].
        "lever": per(rise, np.std(rows.yaw)),
        # Changes the force by the load at the usual yaw acceleration [kg m].
        "swing": per(mean_load, np.std(rows.swing)),
        # Of the carried mass at the rolling radius [kg m^2].
        "inertia": mean_load / GRAVITY * radius**2 if radius else 1.0,
    }


class Derived(NamedTuple):
    """A force derived from the motion of the vehicle as -(mass a_y + inertia r')."""

    mass: float  # [kg]
    inertia: float  # yaw inertia over wheelbase [kg m]
    steered: bool  # whether the force is normal to road wheels that steer

    @property
    def arm(self) -> float:
        """Length [m] of the vehicle: about the arm of the axle."""
        return self.inertia / self.mass


def derived_from(data: TireData, channel: str) -> Derived | None:
    """The law of a lateral force that follows exactly from the file's accelerations."""
    needed = ("a_y", "yaw_acceleration")
    if channel != "fy" or any(name not in data for name in needed):
        return None
    motion = np.stack([data.usable(name) for name in needed], axis=1)
    if np.linalg.matrix_rank(motion - motion.mean(axis=0)) < motion.shape[1]:
        return None
    laws, across = [], [data.usable(channel)]
    if "steering" in data:
        angle = data.usable("steering")
        across.append(across[0] * np.cos(angle))
        if "fx" in data:  # of an axle that drives
            across.append(across[1] + data.usable("fx") * np.sin(angle))
    for ahead in across:
        share = np.linalg.lstsq(motion, ahead)[0]
        missed = float(np.std(ahead - motion @ share) / np.std(ahead))
        mass, inertia = np.abs(share).tolist()
        laws.append((missed, Derived(mass, inertia, ahead is not across[0])))
    best = min(laws, key=lambda law: law[0])
    # A measured force does not agree with accelerometers to a thousandth.
    return best[1] if best[0] < 1e-3 else None


def work_of_sliding(power: np.ndarray, time: np.ndarray, run: np.ndarray) -> np.ndarray:
    """Work of sliding so far, from its power (n,), with each cooling: (n, coolings)."""
    coolings, span = np.array([np.inf, 0.2, 0.05]), np.ptp(time)  # in shares of the record
    work, heated = np.zeros((len(power), len(coolings))), np.zeros(len(power))
    if span <= 0:
        return work
    for part in segments(time, run):
        mean = 0.5 * (power[part][1:] + power[part][:-1])
        heated[part[1:]] = mean * np.diff(time[part])
    order = np.lexsort((time, run))
    step = np.maximum(np.diff(time[order], prepend=time[order][0]), 0.0)
    warmth, keep = np.zeros(len(coolings)), np.exp(-step[:, None] / (coolings * span))
    for row, left in zip(order.tolist(), keep, strict=True):
        warmth = left * warmth + heated[row]
        work[row] = warmth
    return work


def column(data: TireData, name: str) -> np.ndarray:
    """Used rows (n,) of a column, zero without it."""
    return data.usable(name) if name in data else np.zeros(data.n)


def _force_of(data: TireData, mode: str) -> np.ndarray:
    """The force that the slip causes (n,); its size if both slips cause it."""
    if mode == "xy":
        return np.hypot(column(data, "fx"), column(data, "fy"))
    return column(data, f"f{mode}")


def slowest(v: np.ndarray) -> float:
    """Speed [m/s] below which a wheel counts as standing; of the speeds (n,)."""
    usual = float(np.median(np.abs(v)))
    return STANDS * usual if usual else 1.0


def _over_range(values: np.ndarray) -> np.ndarray:
    """Values minus their mean, over their range; zero if they do not vary."""
    span = np.ptp(values)
    varies = span > FLAT * np.max(np.abs(values))
    return (values - np.mean(values)) / span if varies else np.zeros(len(values))


def covariates_of(
    data: TireData,
    mode: str,
    sweeps: Sweeps,
    slip: np.ndarray,
    second: np.ndarray,
    radius: float | None,
) -> Covariates:
    """Covariates that follow from the columns; the base fit adds the others."""
    fz, v, zero = data.usable("fz"), column(data, "v"), np.zeros(data.n)
    time, run, size = column(data, "time"), data.run[data.used], np.hypot(slip, second)
    omega, force = column(data, "omega"), _force_of(data, mode)
    sigma, tan_alpha = column(data, "sigma_x"), np.tan(column(data, "alpha"))
    spin = slip_rate(omega, time, run).rate if "omega" in data else zero
    interval = np.full(data.n, sweeps.past.interval)
    pace = np.maximum(np.abs(v), slowest(v))
    temperature = column(data, "temperature")
    sliding = np.abs(v * (size if mode == "y" else size / (1 + sigma)))
    work = work_of_sliding(np.abs(force) * sliding, time, run)
    other = {"x": tan_alpha * (1 + sigma), "y": sigma, "xy": zero}[mode]
    steering, past = column(data, "steering"), sweeps.past
    steering_rate = column(data, "steering_rate") if "steering_rate" in data else None
    of_runs = (name for name in Covariates._fields if name.startswith("run_"))
    of_the_fit = ("force", "usage", "traction", *of_runs)
    return Covariates(
        fz=fz / np.mean(fz), v=v, time=_over_range(time),
        temperature=(temperature - np.mean(temperature)) / 20.0,
        inflation=_over_range(column(data, "pressure")), gamma=column(data, "gamma"),
        rate=sweeps.rate, turning=sweeps.turning, side=np.sign(slip), other=other,
        spin=spin / radius if radius else zero, load=np.full(data.n, np.mean(fz)),
        past=past.path, pull=np.zeros_like(past.path), twist=np.zeros_like(past.path),
        burden=past.of(fz) / fz[:, None], interval=interval, step=interval * pace,
        pace=pace, sliding=sliding,
        brisk=np.full(data.n, max(_largest(sliding), ROUNDING)),
        cruise=np.full(data.n, np.exp(np.mean(np.log(pace)))),
        rise=np.full(data.n, half_force_slip(size, force / fz)),
        peak=np.full(data.n, _largest(force / fz)),
        work=np.stack([_over_range(part) for part in work.T], axis=1),
        across=column(data, {"x": "fy", "y": "fx"}.get(mode, "")),
        yaw=column(data, "yaw_rate") / pace, ahead=_over_range(column(data, "a_x")),
        swing=column(data, "yaw_acceleration"), heading=column(data, "heading"),
        lean=column(data, "a_y") / GRAVITY, steering=steering, pivot=zero,
        steered=past.of(steering, steering_rate, time),
        **dict.fromkeys(of_the_fit, zero),
    )  # fmt: skip


def needs_met(
    data: TireData,
    mode: str,
    rows: Covariates,
    sweeps: bool,
    radius: float | None,
    derived: Derived | None,
) -> frozenset[str]:
    """Names of the needs of effects that this data meets."""

    def varies(name: str, least: float = 0.0) -> bool:
        return name in data and bool(np.std(data.usable(name)) > least)

    def relative(values: Values) -> float:
        return float(np.std(values)) / max(float(np.mean(np.abs(values))), FLAT)

    heading = column(data, "heading")
    met = {
        "v": bool(np.median(np.abs(rows.v)) > 0),
        "speeds": relative(rows.v) > LOADS,
        "loads": relative(rows.fz) > LOADS,
        "time": "time" in data and bool(np.any(rows.time)),
        "temperature": varies("temperature", LOADS * 20.0),
        "pressure": relative(column(data, "pressure")) > LOADS,
        "gamma": varies("gamma", _ANGLE),
        "signs": 0.1 < np.mean(rows.side > 0) < 0.9,
        "sweeps": sweeps,
        "omega": "omega" in data,
        "rolling_radius": radius is not None,
        "other slip": float(np.max(np.abs(rows.other))) > _ANGLE,
        "mz": mode != "x" and "mz" in data,
        "other force": np.std(rows.across) > LOADS * np.std(_force_of(data, mode)),
        "yaw_rate": np.std(rows.yaw) > 0,
        "a_x": np.any(rows.ahead),
        "work": np.any(rows.work) and np.any(rows.time),
        "runs": len(shown_runs(data.run[data.used], data.runs)) > 1,
        "derived force": derived is not None,
        "doubted point": not point_confirmed(data.source.constants),
        "yaw_acceleration": varies("yaw_acceleration"),
        # The vehicle drives in several directions.
        "heading": np.std(np.cos(heading)) + np.std(np.sin(heading)) > 0.5,
        "a_y": varies("a_y"),
        "steering": varies("steering", _ANGLE) and (not derived or derived.steered),
    }
    return frozenset(name for name, here in met.items() if here)
