"""Errors of the prediction of a car, by quantity and horizon."""

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid

from tirefit.data.vehicle.vehicle import Vehicle
from tirefit.diagnosis.engine.left_out import jackknife_error
from tirefit.vehicle.car import State
from tirefit.vehicle.effects import Samples

QUANTITIES = {
    "yaw_rate": "rad/s",
    "sideslip": "rad",
    "a_y": "m/s2",
    "heading": "rad",
    "lateral": "m",
}
"""Compared quantity -> unit; ``lateral`` is the distance across the measured heading."""


class Errors(NamedTuple):
    """Predicted - measured at each horizon: {quantity: (windows, horizons)}, NaN if the
    log ends before."""

    of: Mapping[str, np.ndarray]

    def rms(self) -> dict[str, list[float | None]]:
        """Root mean square by quantity, for each horizon; None without windows."""
        rms_of = {}
        for name, values in self.of.items():
            count = np.isfinite(values).sum(axis=0)
            squares = np.nansum(values**2, axis=0)
            rms = np.sqrt(squares / np.maximum(count, 1))
            rms_of[name] = [float(x) if n else None for x, n in zip(rms, count, strict=True)]
        return rms_of


class Measured(NamedTuple):
    """Windows of one log: times (w, k); start states (w,); speed and steering (w, k);
    measured values (w, k), NaN beyond the end of each; and samples of the effects."""

    time: np.ndarray
    start: State
    v_x: np.ndarray
    steering: np.ndarray
    measured: State
    a_y: np.ndarray
    samples: Samples | None = None


def floor_of(tire: Errors, noisy: Sequence[Errors]) -> Errors:
    """The effect of the noise of the log on the errors: their change by added noise, at
    the start of a window and where it is compared."""
    each = {k: [noised.of[k] - missed for noised in noisy] for k, missed in tire.of.items()}
    return Errors({name: np.concatenate(parts) for name, parts in each.items()})


def errors_of(states: State, a_y: np.ndarray, windows: Measured, steps: Sequence[int]) -> Errors:
    """The errors of predicted states (w, k)."""
    at, true = np.asarray(steps), windows.measured

    def missed(name: str) -> np.ndarray:
        return (getattr(states, name) - getattr(true, name))[:, at]

    cos, sin = np.cos(true.heading[:, at]), np.sin(true.heading[:, at])
    v_x = windows.v_x[:, at]
    slip = np.arctan2(states.v_y[:, at], v_x) - np.arctan2(true.v_y[:, at], v_x)
    return Errors(
        {
            "yaw_rate": missed("yaw_rate"),
            "sideslip": slip,
            "a_y": (a_y - windows.a_y)[:, at],
            "heading": missed("heading"),
            "lateral": cos * missed("y") - sin * missed("x"),
        }
    )


def errors_without_slip(vehicle: Vehicle, windows: Measured, steps: Sequence[int]) -> Errors:
    """The errors of a car without slip: r = v_x tan(delta) / (l_f + l_r)."""
    v_x, steering = windows.v_x, windows.steering
    yaw = v_x * np.tan(steering) / (vehicle.l_f + vehicle.l_r)
    sideways, rate = vehicle.l_r * yaw, vehicle.filter.sample_rate
    integral = partial(cumulative_trapezoid, dx=1 / rate, axis=1, initial=0)
    heading = windows.start.heading[:, None] + integral(yaw)
    cos, sin = np.cos(heading), np.sin(heading)
    x = windows.start.x[:, None] + integral(v_x * cos - sideways * sin)
    y = windows.start.y[:, None] + integral(v_x * sin + sideways * cos)
    a_y = np.gradient(sideways, 1 / rate, axis=1) + v_x * yaw
    return errors_of(State(sideways, yaw, heading, x, y), a_y, windows, steps)


_BLOCKS = 8  # number of parts of the starts; their spread gives the error of a ratio
FEWEST = 16
"""Smallest number of starts for a ratio, and for a horizon at which models are compared."""


class Fans(NamedTuple):
    """Measured and predicted ``x``, ``y`` [m], ``yaw_rate`` [rad/s] and ``a_y`` [m/s2]
    of each window of a log, (w, k) at times (w, k) [s] after ``epoch``, NaN beyond its end."""

    time: np.ndarray
    measured: Mapping[str, np.ndarray]
    predicted: Mapping[str, np.ndarray]
    epoch: float = 0.0


def turning(fans: Iterable[Fans], horizon: float) -> tuple[float, float] | None:
    """Measured over predicted yaw rate at a horizon [s], by least squares over all starts, with
    its standard error between parts of the starts; None with few starts or hardly any turning."""
    pairs = []
    for fan in fans:
        step = round(horizon / float(fan.time[0, 1] - fan.time[0, 0]))
        pairs.append([of["yaw_rate"][:, step] for of in (fan.measured, fan.predicted)])
    true, predicted = (np.concatenate(part) for part in zip(*pairs, strict=True))
    there = np.isfinite(true) & np.isfinite(predicted)
    if there.sum() < FEWEST or not np.any(predicted[there]):
        return None
    parts = np.array_split(np.flatnonzero(there), _BLOCKS)
    products = np.array([(true[p] @ predicted[p], predicted[p] @ predicted[p]) for p in parts])
    whole, left = products.sum(axis=0), products.sum(axis=0) - products
    return float(whole[0] / whole[1]), float(jackknife_error(left[:, 0] / left[:, 1]))
