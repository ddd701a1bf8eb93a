"""The result of ``tirefit brake``: numbers of one stop or many, of one or more controllers."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy import stats

from tirefit.data.write import csv_text
from tirefit.display import Record
from tirefit.files import json_safe
from tirefit.results import Outcome
from tirefit.sim.brake import SPUN, STANDS, Log, Plant
from tirefit.sim.brake_request import Request

LOCKED_SLIP = 0.9  # slip kappa above which a wheel counts as locked
RECOVERED = 0.8
"""Share of the available friction at which a controller has adapted to a new road."""
_SLOW = 2.0
"""Speed [m/s] below which locking and pressure are ignored: brake controllers switch off there."""
_WINDOW = 1.0  # length [s] of the running mean from which fluctuations are measured
_BUILT_UP = 0.5  # time [s] after which the first rise of the pressure is over
_HELD = 0.1  # time [s] over which a recovered friction is averaged


Each = Float[Array | np.ndarray, "*k"]


class Summary(NamedTuple):
    """Numbers of one stop, or (k,) of many; NaN where there is none.

    Their units and meanings are in :data:`UNITS`.
    """

    stopping_distance: Each
    stopping_time: Each
    mean_friction_used: Each
    locked_time: Each
    pressure_rms_fluctuation: Each
    slip_speed_rms_fluctuation: Each
    recovery_time: Each
    heading: Each
    stopped: Each
    end_time: Each
    end_speed: Each
    fine: Each

    @property
    def reason(self) -> str:
        """Why one stop ended, as text."""
        time, speed = float(self.end_time), float(self.end_speed)
        if float(self.fine) < 1:
            return "the integration failed: a step needed more than 4096 substeps"
        if float(self.stopped) > 0:
            return f"stopped: slower than {STANDS:g} m/s"
        if abs(float(self.heading)) > SPUN:
            return f"spun: turned by more than 90 degrees after {time:.3g} s"
        return (
            f"did not stop: still {speed:.3g} m/s at the time limit of {time:.4g} s; brake"
            " harder, or raise --time-limit"
        )


UNITS = {
    "stopping_distance": "m",  # until the car is slower than STANDS
    "stopping_time": "s",  # the same
    "mean_friction_used": "-",  # mean over time of sum F_x / sum mu_peak F_z of the wheels
    "locked_time": "s",  # with a wheel at kappa >= LOCKED_SLIP, above 2 m/s
    # rms of the wheels' pressures about their running means over 1 s, from 0.5 s on, above 2 m/s
    "pressure_rms_fluctuation": "Pa",
    "slip_speed_rms_fluctuation": "m/s",  # the same of v - R omega
    "recovery_time": "s",  # from all wheels on the new road until RECOVERED is used over 0.1 s
    "heading": "rad",  # angle by which the car has turned since the braking began
}
"""Name of a reported number -> its unit, in the order of the report."""


def _fluctuation(values: Array, counted: Array, samples: int) -> Array:
    """Rms of columns (n, w) about their running means over ``samples`` rows, in the rows
    that ``counted`` (n,) marks."""
    smooth = jax.vmap(partial(jnp.convolve, v=jnp.ones(samples), mode="same"), 1, 1)
    counted = counted[:, None]
    mean = smooth(values * counted) / jnp.maximum(smooth(counted), 1.0)
    total = jnp.sum(counted * (values - mean) ** 2)
    return jnp.sqrt(total / jnp.maximum(values.shape[1] * jnp.sum(counted), 1.0))


def summarise(plant: Plant, log: Log, period: float) -> Summary:
    """The summary of one log; a pure function, for vmap."""
    n = len(log.moving)
    s, moving = log.motion, log.moving
    end = jnp.sum(moving).astype(int)
    last = jnp.minimum(end, n - 1)
    ended = end < n
    stopped = ended & (s.v_x[last] <= STANDS) & (jnp.abs(s.heading[last]) <= SPUN)
    there = jnp.sum(log.reading.truth.mu * log.contacts.fz, axis=1)
    used = jnp.sum(log.contacts.fx, axis=1) / there
    fast = moving * (s.v_x > _SLOW)
    locked = jnp.any(log.contacts.slips.kappa >= LOCKED_SLIP, axis=1)
    judged = fast * (log.reading.time >= _BUILT_UP)
    turning = s.omega * jnp.asarray(plant.vehicle.radius)[None]
    sliding = log.contacts.v_x - turning
    samples = min(round(_WINDOW / period), n)  # at most the whole log
    # From the jump of the friction until the new friction is used.
    car = plant.vehicle
    behind = jnp.max(jnp.asarray(car.x)) - jnp.min(jnp.asarray(car.x))
    on_it = (s.distance >= plant.road.jump + behind) & (moving > 0)
    held = max(round(_HELD / period), 1)
    before = jnp.concatenate([jnp.zeros(1), jnp.cumsum(used)])
    mean = (before[1:] - before[jnp.maximum(jnp.arange(n) + 1 - held, 0)]) / held
    adapted = on_it & (mean >= RECOVERED)
    recovery = (jnp.argmax(adapted) - jnp.argmax(on_it)) * period
    time = last * period
    return Summary(
        stopping_distance=jnp.where(stopped, s.distance[last], jnp.nan),
        stopping_time=jnp.where(stopped, time, jnp.nan),
        mean_friction_used=jnp.sum(used * moving) / jnp.maximum(jnp.sum(moving), 1.0),
        locked_time=jnp.sum(fast * locked) * period,
        pressure_rms_fluctuation=_fluctuation(s.pressure, judged, samples),
        slip_speed_rms_fluctuation=_fluctuation(sliding, judged, samples),
        recovery_time=jnp.where(jnp.any(adapted), recovery, jnp.nan),
        heading=s.heading[last],
        stopped=stopped.astype(float),
        end_time=time,
        end_speed=s.v_x[last],
        fine=jnp.min(log.fine),
    )


def interval(values: np.ndarray) -> dict[str, float]:
    """Mean of k values (k,) with its 95 % confidence interval by Student's t, and ``std`` of a
    single value; NaN are ignored."""
    known = np.asarray(values, float)
    known = known[np.isfinite(known)]
    k = len(known)
    mean = float(known.mean()) if k else np.nan
    std = float(known.std(ddof=1)) if k > 1 else np.nan
    half = float(stats.t.ppf(0.975, k - 1)) * std / np.sqrt(k)
    return {"mean": mean, "low": mean - half, "high": mean + half, "std": std, "k": k}


SCHEMA = "tirefit.brake/1"


@dataclass(frozen=True)
class Stop:
    """A stop by one controller: ``log`` (n, ...) until it ended, summary, settings."""

    name: str
    log: Log
    summary: Summary
    wheels: tuple[str, ...]
    settings: Mapping[str, Any]

    def columns(self) -> dict[str, np.ndarray]:
        """Columns of ``series.csv``: header -> values (n,); suffixes name the wheels."""
        log, s, c = self.log, self.log.motion, self.log.contacts
        read = log.reading
        table: dict[str, Any] = {
            "time": read.time, "distance": s.distance, "v": s.v_x, "v_y": s.v_y,
            "yaw_rate": s.yaw_rate, "heading": s.heading, "x": s.x, "y": s.y,
            "deceleration": read.deceleration, "demand": read.demand,
        }  # fmt: skip
        wheels = {
            "omega": s.omega, "slip": c.slips.kappa, "alpha": c.slips.alpha,
            "fx": c.fx, "fy": c.fy, "fz": c.fz, "mu": np.hypot(c.fx, c.fy) / c.fz,
            "mu_peak": read.truth.mu, "slip_peak": read.truth.peak,
            "pressure": s.pressure, "valve": log.valve,
            "wheel_speed": read.wheel_speed, "d": log.d,
            "xbs": log.info.get("xbs", np.full_like(c.fx, np.nan)),
            "xbs_true": log.xbs_true,
        }  # fmt: skip
        wheels |= {key: value for key, value in log.info.items() if key != "xbs"}
        for key, values in wheels.items():
            for k, wheel in enumerate(self.wheels):
                table[key + wheel] = values[:, k]
        return {key: np.asarray(value) for key, value in table.items()}

    def to_dict(self) -> dict[str, Any]:
        """The numbers of the stop, by the names in :data:`UNITS`."""
        numbers = {name: float(getattr(self.summary, name)) for name in UNITS}
        stopped = bool(float(self.summary.stopped) > 0)
        return {**numbers, "stopped": stopped, "reason": self.summary.reason}


@dataclass(frozen=True, repr=False)
class Braking(Record):
    """Stops of controllers on one road, with the same noise.

    ``stops``: the stops of the first seed, by controller; ``many``: summaries (k,) of
    all seeds by controller, empty for one seed; ``peak``: of the tire's curve in figures.
    """

    text_by: ClassVar[str] = "tirefit.report.braking:braking_text"
    plot_by: ClassVar[str] = "tirefit.report.braking:plot_braking"

    request: Request
    stops: Mapping[str, Stop]
    many: Mapping[str, Summary]
    seed: int
    version: str
    notes: tuple[str, ...] = ()  # warnings on the request

    @property
    def limits(self) -> dict[Outcome, str]:
        """The stops that did not end standing, and why."""
        ends = {name: stop.summary for name, stop in self.stops.items()}
        off = [f"{name}: {end.reason}" for name, end in ends.items() if not end.stopped]
        counts = {k: each.stopped for k, each in self.many.items() if not np.all(each.stopped)}
        off += [f"{k}: {int(x.sum())} of {len(x)} stops ended" for k, x in counts.items()]
        return {Outcome.INCOMPLETE: "; ".join(off)}

    @property
    def warnings(self) -> tuple[str, ...]:
        """Stops that did not end standing, and ``notes``."""
        return (*super().warnings, *self.notes)

    def table(self) -> dict[str, dict[str, Any]]:
        """Controller -> name of a number -> mean and 95 % interval over the seeds."""
        return {
            name: {
                **{key: interval(getattr(all_, key)) for key in UNITS},
                "stopped": int(np.sum(all_.stopped)),
                "stops": len(all_.stopped),
            }
            for name, all_ in self.many.items()
        }

    def to_dict(self) -> dict[str, Any]:
        """Content of ``summary.json``; the numbers of the first controller are on top."""
        stops = self.stops.items()
        each = {k: {**stop.to_dict(), "settings": dict(stop.settings)} for k, stop in stops}
        first = next(iter(self.stops.values()))
        head = {
            "schema": SCHEMA, "version": self.version, "seed": self.seed,
            "convention": "braking, SI", "controller": first.name, **first.to_dict(),
            "units": UNITS, "manoeuvre": self.request.about(),
            "controllers": each,
        }  # fmt: skip
        return json_safe(head | ({"seeds": self.table()} if self.many else {}))

    def files(self, name: str = "") -> dict[str, str]:
        """``summary.json``, ``series.csv`` and, with several seeds, ``stops.csv``."""
        tables = {"series.csv": self.columns()}
        tables |= {"stops.csv": self.stops_columns()} if self.many else {}
        texts = {file: csv_text(columns) for file, columns in tables.items()}
        return texts | {"summary.json": self.to_json()}

    def columns(self) -> dict[str, Any]:
        """Columns of ``series.csv``; several controllers are below each other, with the
        name of the controller in the first column."""
        tables = {name: stop.columns() for name, stop in self.stops.items()}
        if len(tables) == 1:
            return dict(*tables.values())
        headers = dict.fromkeys(key for table in tables.values() for key in table)
        names = [name for name, table in tables.items() for _ in table["time"]]
        return {"controller": names} | {
            key: np.concatenate(
                [table.get(key, np.full_like(table["time"], np.nan)) for table in tables.values()]
            )
            for key in headers
        }

    def stops_columns(self) -> dict[str, Any]:
        """Columns of ``stops.csv``: one row for each seed and controller."""
        many = self.many.items()
        seeds = [self.seed + k for _, all_ in many for k in range(len(all_.stopped))]
        rows = {"controller": [name for name, all_ in many for _ in all_.stopped], "seed": seeds}
        return rows | {
            key: np.concatenate([getattr(all_, key) for _, all_ in many]).tolist()
            for key in (*UNITS, "stopped")
        }
