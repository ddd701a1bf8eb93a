"""The result of ``tirefit brake``: one stop or many, of one or more controllers."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from tirefit import __version__
from tirefit.data.write import csv_text
from tirefit.display import Record
from tirefit.files import json_safe
from tirefit.precision import require_x64
from tirefit.results import Outcome
from tirefit.sim.brake import Log, simulate_stop
from tirefit.sim.brake_plant import Plant
from tirefit.sim.brake_request import Request, arrays, check, plant_of
from tirefit.sim.brake_summary import MEANINGS, UNITS, Summary, interval, reason_of, summarise

SCHEMA = "tirefit.brake/1"

_TOGETHER = 50
"""Stops in one batch: more need much memory, and all wait for the slowest one."""


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
            "time": read.time,
            "distance": s.distance,
            "v": s.v_x,
            "v_y": s.v_y,
            "yaw_rate": s.yaw_rate,
            "heading": s.heading,
            "x": s.x,
            "y": s.y,
            "deceleration": read.deceleration,
            "demand": read.demand,
        }
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

    @property
    def reason(self) -> str:
        """Why the stop ended, as text."""
        return reason_of(self.summary)

    def to_dict(self) -> dict[str, Any]:
        """The numbers of the stop, by the names in :data:`tirefit.sim.brake_summary.UNITS`."""
        numbers = {name: float(getattr(self.summary, name)) for name in UNITS}
        stopped = bool(float(self.summary.stopped) > 0)
        return {**numbers, "stopped": stopped, "reason": self.reason}


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
        off = [f"{k}: {stop.reason}" for k, stop in self.stops.items() if not stop.summary.stopped]
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
                **{key: interval(getattr(all_, key))._asdict() for key in UNITS},
                "stopped": int(np.sum(all_.stopped)),
                "stops": len(all_.stopped),
            }
            for name, all_ in self.many.items()
        }

    def to_dict(self) -> dict[str, Any]:
        """Content of ``summary.json``; the numbers of the first controller are on top."""
        each = {
            name: {**stop.to_dict(), "settings": dict(stop.settings)}
            for name, stop in self.stops.items()
        }
        first = next(iter(self.stops.values()))
        head = {
            "schema": SCHEMA,
            "version": self.version,
            "seed": self.seed,
            "convention": "braking, SI",
            "controller": first.name,
            **first.to_dict(),
            "units": UNITS,
            "meanings": MEANINGS,
            "manoeuvre": self.request.about(),
            "controllers": each,
        }
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
        rows: dict[str, Any] = {"controller": []} | {key: [] for key in headers}
        for name, table in tables.items():
            n = len(table["time"])
            rows["controller"] += [name] * n
            for key in headers:
                rows[key].append(table.get(key, np.full(n, np.nan)))
        return {
            key: values if key == "controller" else np.concatenate(values)
            for key, values in rows.items()
        }

    def stops_columns(self) -> dict[str, Any]:
        """Columns of ``stops.csv``: one row for each seed and controller."""
        rows: dict[str, Any] = {"controller": [], "seed": []}
        rows |= {name: [] for name in (*UNITS, "stopped")}
        for name, all_ in self.many.items():
            k = len(all_.stopped)
            rows["controller"] += [name] * k
            rows["seed"] += list(range(self.seed, self.seed + k))
            for key in (*UNITS, "stopped"):
                rows[key] += np.asarray(getattr(all_, key)).tolist()
        return rows


@eqx.filter_jit
def many_stops(
    plants: Plant, controller, sensors, speed, keys, samples: int, queue: int
) -> Summary:
    """Summaries (k,) of stops in one vmapped run.

    Args:
        plants: leaves (k, ...): tires and roads.
        controller: the same for all stops.
        keys: random keys (k,) of the noise; other arguments as in
            :func:`tirefit.sim.brake.simulate_stop`.
    """

    def one(given):
        plant, key = given
        log = simulate_stop(plant, controller, sensors, speed, key, samples, queue)
        return summarise(plant, log, 1 / controller.rate)

    return jax.lax.map(one, (plants, keys), batch_size=_TOGETHER)


def braked(
    request: Request,
    controllers: Mapping[str, Any],
    *,
    seed: int = 0,
    stops: int = 1,
    progress: Callable[[float, str], None] | None = None,
) -> Braking:
    """Brake with each of the controllers, under the same noise.

    Args:
        request: tire, road, speed, vehicle.
        controllers: name -> record with ``rate``, ``init``, ``step``.
        seed: of the noise; stop k has ``seed + k``.
        stops: number of seeds.
        progress: called with the share done and the next step.

    Raises:
        UsageError: a problem of the request; 32-bit floats.
    """
    require_x64("a simulated stop")
    check(request)
    plant, sensors = plant_of(request), arrays(request.sensors)
    speed, wheels = jnp.asarray(request.speed, float), plant.vehicle.wheels
    done, many = {}, {}
    for number, (name, controller) in enumerate(controllers.items()):
        if progress is not None:
            progress(number / len(controllers), name)
        rate = controller.rate
        how = (request.samples(rate), request.hydraulics.queue(rate))
        run = partial(simulate_stop, plant, controller, sensors, speed)
        log = run(jax.random.key(seed), *how)
        summary = jax.jit(summarise, static_argnums=2)(plant, log, 1 / rate)
        done[name] = _stop(name, log, summary, wheels, controller)
        if stops > 1:
            plants = jax.tree.map(lambda x: jnp.repeat(x[None], stops, 0), plant)
            keys = jax.vmap(jax.random.key)(jnp.arange(seed, seed + stops))
            all_ = many_stops(plants, controller, sensors, speed, keys, *how)
            many[name] = jax.tree.map(np.asarray, all_)
    return Braking(request, done, many, seed, __version__)


def _stop(name, log: Log, summary, wheels, controller) -> Stop:
    """The stop with its rows until the end, as NumPy arrays."""
    end = min(int(np.sum(log.moving)) + 1, len(log.moving))
    kept = jax.tree.map(lambda leaf: np.asarray(leaf)[:end], log)
    leaves = {
        key: np.asarray(value).tolist()
        for key, value in vars(controller).items()
        if isinstance(value, int | float | jax.Array | np.ndarray)
    }
    return Stop(name, kept, jax.tree.map(np.asarray, summary), wheels, leaves)
