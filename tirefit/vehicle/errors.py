"""Errors of predictions of a car over windows of its logs, by quantity and horizon."""

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid

from tirefit.data.vehicle.vehicle import Vehicle
from tirefit.diagnosis.engine.left_out import jackknife_error
from tirefit.vehicle.effects import Samples

QUANTITIES = {
    "yaw_rate": "rad/s",
    "sideslip": "rad",
    "a_y": "m/s2",
    "heading": "rad",
    "lateral": "m",
}
"""Compared quantity -> unit; ``lateral`` is the distance across the measured heading."""

Series = Mapping[str, Any]
"""``v_y``, ``yaw_rate``, ``heading``, ``x``, ``y`` and ``a_y``, (w, k) each."""


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
    """Windows of a log: times and speed (w, k), wheel angle (w, l + k), which begins l samples
    before; the measured series, NaN beyond the end of each, as the times; and samples of the
    effects."""

    time: Any
    v_x: Any
    steering: Any
    series: Series
    samples: Samples | None = None


def errors_of(predicted: Series, windows: Measured, steps: Sequence[int]) -> Errors:
    """The errors of predicted series."""
    at, v_x, true = np.asarray(steps), windows.v_x, windows.series
    missed = {name: (predicted[name] - true[name])[:, at] for name in true}
    cos, sin = np.cos(true["heading"][:, at]), np.sin(true["heading"][:, at])
    slip = np.arctan2(predicted["v_y"], v_x) - np.arctan2(true["v_y"], v_x)
    missed |= {"sideslip": slip[:, at], "lateral": cos * missed["y"] - sin * missed["x"]}
    return Errors({name: missed[name] for name in QUANTITIES})


def errors_without_slip(vehicle: Vehicle, windows: Measured, steps: Sequence[int]) -> Errors:
    """The errors of a car without slip: r = v_x tan(delta) / (l_f + l_r)."""
    v_x, start = windows.v_x, [windows.series[name][:, :1] for name in ("heading", "x", "y")]
    yaw = v_x * np.tan(windows.steering[:, -v_x.shape[1] :]) / (vehicle.l_f + vehicle.l_r)
    sideways, rate = vehicle.l_r * yaw, vehicle.filter.sample_rate
    series = {"v_y": sideways, "yaw_rate": yaw}
    series |= zip(("heading", "x", "y"), integrated(yaw, v_x, sideways, rate, start), strict=True)
    series["a_y"] = np.gradient(sideways, 1 / rate, axis=1) + v_x * yaw
    return errors_of(series, windows, steps)


def integrated(
    yaw_rate: np.ndarray, v_x: np.ndarray, v_y: np.ndarray, rate: float, start: Any = (0, 0, 0)
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Heading and position (..., k) of a motion with these rates at k samples, from its start."""
    integral = partial(cumulative_trapezoid, dx=1 / rate, axis=-1, initial=0)
    heading = start[0] + integral(yaw_rate)
    cos, sin = np.cos(heading), np.sin(heading)
    x = start[1] + integral(v_x * cos - v_y * sin)
    return heading, x, start[2] + integral(v_x * sin + v_y * cos)


PARTS = 8  # number of parts of the time, each left out in turn for an error
FEWEST = 16
"""Smallest number of starts for a ratio, and for a horizon at which models are compared."""


class Fans(NamedTuple):
    """Measured and predicted series of each window of a log, at times (w, k) [s] after
    ``epoch``; time and measured series are NaN beyond its end."""

    time: np.ndarray
    measured: Series
    predicted: Series
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
    parts = np.array_split(np.flatnonzero(there), PARTS)
    products = np.array([(true[p] @ predicted[p], predicted[p] @ predicted[p]) for p in parts])
    whole, left = products.sum(axis=0), products.sum(axis=0) - products
    return float(whole[0] / whole[1]), float(jackknife_error(left[:, 0] / left[:, 1]))
