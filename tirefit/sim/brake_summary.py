"""Summarise stops: the numbers of one log, and their means over many seeds."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy import stats

from tirefit.sim.brake import SPUN, STANDS, Log
from tirefit.sim.brake_plant import Plant

LOCKED_SLIP = 0.9  # slip kappa above which a wheel counts as locked
RECOVERED = 0.8
"""Share of the available friction at which a controller has adapted to a new road."""
_SLOW = 2.0
"""Speed [m/s] below which locking and pressure are ignored: brake controllers switch off there."""
_WINDOW = 1.0  # length [s] of the running mean from which fluctuations are measured
_BUILT_UP = 0.5  # time [s] after which the first rise of the pressure is over
_HELD = 0.1  # time [s] over which a recovered friction is averaged


class Summary(NamedTuple):
    """Numbers of one stop, or (k,) of many; NaN where there is none.

    Their units are in :data:`UNITS`, their meanings in :data:`MEANINGS`.
    """

    stopping_distance: Float[Array | np.ndarray, "*k"]
    stopping_time: Float[Array | np.ndarray, "*k"]
    mean_friction_used: Float[Array | np.ndarray, "*k"]
    locked_time: Float[Array | np.ndarray, "*k"]
    pressure_rms_fluctuation: Float[Array | np.ndarray, "*k"]
    slip_speed_rms_fluctuation: Float[Array | np.ndarray, "*k"]
    recovery_time: Float[Array | np.ndarray, "*k"]
    heading: Float[Array | np.ndarray, "*k"]
    stopped: Float[Array | np.ndarray, "*k"]
    end_time: Float[Array | np.ndarray, "*k"]
    end_speed: Float[Array | np.ndarray, "*k"]
    fine: Float[Array | np.ndarray, "*k"]


UNITS = {
    "stopping_distance": "m",
    "stopping_time": "s",
    "mean_friction_used": "-",
    "locked_time": "s",
    "pressure_rms_fluctuation": "Pa",
    "slip_speed_rms_fluctuation": "m/s",
    "recovery_time": "s",
    "heading": "rad",
}
"""Name of a reported number -> its unit, in the order of the report."""

MEANINGS = {
    "stopping_distance": f"distance until the car is slower than {STANDS:g} m/s",
    "stopping_time": f"time until the car is slower than {STANDS:g} m/s",
    "mean_friction_used": "mean over time of sum F_x / sum mu_peak F_z of the wheels",
    "locked_time": f"time with a wheel at kappa >= {LOCKED_SLIP:g}, above {_SLOW:g} m/s",
    "pressure_rms_fluctuation": f"rms of the wheels' pressures about their running"
    f" means over {_WINDOW:g} s, from {_BUILT_UP:g} s on, above {_SLOW:g} m/s",
    "slip_speed_rms_fluctuation": "the same of v - R omega",
    "recovery_time": f"from all wheels on the new road until the friction used is"
    f" {RECOVERED:g} over {_HELD:g} s",
    "heading": "angle by which the car has turned since the braking began",
}


def _fluctuation(values, counted, samples: int):
    """Rms of columns (n, w) about their running means over ``samples`` rows, in the rows
    that ``counted`` (n,) marks."""
    weight = jnp.ones(samples)

    def smooth(column):
        return jnp.convolve(column, weight, mode="same")

    shares = smooth(counted)
    total = jnp.zeros(())
    for k in range(values.shape[1]):
        mean = smooth(values[:, k] * counted) / jnp.maximum(shares, 1.0)
        total += jnp.sum(counted * (values[:, k] - mean) ** 2)
    return jnp.sqrt(total / jnp.maximum(values.shape[1] * jnp.sum(counted), 1.0))


def _recovery(plant: Plant, log: Log, used, period: float):
    """Time [s] from the jump of the friction until the new friction is used."""
    car = plant.vehicle
    behind = jnp.max(jnp.asarray(car.x)) - jnp.min(jnp.asarray(car.x))
    on_it = (log.motion.distance >= plant.road.jump + behind) & (log.moving > 0)
    held = max(round(_HELD / period), 1)
    before = jnp.concatenate([jnp.zeros(1), jnp.cumsum(used)])
    n = len(used)
    start = jnp.maximum(jnp.arange(n) + 1 - held, 0)
    mean = (before[1:] - before[start]) / held
    there = on_it & (mean >= RECOVERED)
    crossed, recovered = jnp.argmax(on_it), jnp.argmax(there)
    return jnp.where(jnp.any(there), (recovered - crossed) * period, jnp.nan)


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
    time = last * period
    return Summary(
        stopping_distance=jnp.where(stopped, s.distance[last], jnp.nan),
        stopping_time=jnp.where(stopped, time, jnp.nan),
        mean_friction_used=jnp.sum(used * moving) / jnp.maximum(jnp.sum(moving), 1.0),
        locked_time=jnp.sum(fast * locked) * period,
        pressure_rms_fluctuation=_fluctuation(s.pressure, judged, samples),
        slip_speed_rms_fluctuation=_fluctuation(sliding, judged, samples),
        recovery_time=_recovery(plant, log, used, period),
        heading=s.heading[last],
        stopped=stopped.astype(float),
        end_time=time,
        end_speed=s.v_x[last],
        fine=jnp.min(log.fine),
    )


def reason_of(summary: Summary) -> str:
    """Why one stop ended, as text."""
    time, speed = float(summary.end_time), float(summary.end_speed)
    if float(summary.fine) < 1:
        return "the integration failed: a step needed more than 4096 substeps"
    if float(summary.stopped) > 0:
        return f"stopped: slower than {STANDS:g} m/s"
    if abs(float(summary.heading)) > SPUN:
        return f"spun: turned by more than 90 degrees after {time:.3g} s"
    return (
        f"did not stop: still {speed:.3g} m/s at the time limit of {time:.4g} s; brake"
        " harder, or raise --time-limit"
    )


class Interval(NamedTuple):
    """Mean of k values with its 95 % confidence interval; ``std`` of a single value."""

    mean: float
    low: float
    high: float
    std: float
    k: int


def interval(values: np.ndarray) -> Interval:
    """The :class:`Interval` of values (k,) by Student's t; NaN are ignored."""
    known: Any = np.asarray(values, float)
    known = known[np.isfinite(known)]
    k = len(known)
    mean = float(known.mean()) if k else np.nan
    std = float(known.std(ddof=1)) if k > 1 else np.nan
    half = float(stats.t.ppf(0.975, k - 1)) * std / np.sqrt(k)
    return Interval(mean, mean - half, mean + half, std, k)
