"""The tires of a car, and what is not known of the car, from its trajectories:
:func:`fit_trajectory`.

A log is cut into windows. In each the car of :mod:`tirefit.vehicle.car` runs freely
from a start state of its own; the tires of both axles, the unknowns of the car and all
start states together minimise the squares of predicted less logged. Nothing is
differentiated and nothing but the speed ahead is filtered, so that slow, noisy and
quantised channels are as good as they are. The start states are eliminated window by
window (a Schur complement); the covariance of the rest is the sandwich of the scores of
blocks of windows, which holds where residuals are correlated within a block.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.stats import t as student

from tirefit.data.vehicle import Vehicle
from tirefit.fitting.layout import Layout
from tirefit.fitting.source import axle_tire
from tirefit.models import AbstractTire
from tirefit.params import with_values
from tirefit.precision import require_x64
from tirefit.results import InputProblem, UsageError, did_you_mean
from tirefit.vehicle.car import (
    Car,
    State,
    car_of,
    predicted,
    steps_a_sample,
)
from tirefit.vehicle.shooting import (
    CHANNELS,
    Data,
    linearised,
    minimised,
    sandwich,
    windows_of,
)
from tirefit.vehicle.windows import cut_logs, known_vehicle, steering_problems


class Unknown(NamedTuple):
    """An unknown of the car."""

    unit: str
    prior: float  # standard error of a weak prior at zero; of a factor's logarithm
    is_factor: bool


UNKNOWNS = {
    "yaw_inertia": Unknown("kg m2", 0.5, True),
    "steering_ratio": Unknown("-", 0.3, True),  # wheel angle over that of the map
    "steering_offset": Unknown("rad", 0.1, False),  # added to the wheel angle
    "steering_delay": Unknown("s", 0.1, False),  # of the wheels behind the log
    "sideslip_zero": Unknown("rad", 0.05, False),  # logged sideslip less the car's
}
"""What may be estimated beside the tires."""

WINDOW = 0.5
"""Length [s] of a window."""
_ROUNDS = 3
"""Times that the noise of the channels is estimated anew."""


@dataclass(frozen=True)
class Estimate:
    """A parameter: its value, standard error and 95 % interval."""

    value: float
    std: float
    ci95: tuple[float, float]
    unit: str


@dataclass(frozen=True)
class TrajectoryFit:
    """What :func:`fit_trajectory` found.

    Attributes:
        front, rear: the tires of the axles.
        parameters: ``front.cpa2``, ``yaw_inertia``, ... -> estimate.
        noise: channel -> rms of predicted less logged, which counts as its noise.
        windows: number of windows; ``blocks`` of them are independent.
        vehicle: with the yaw inertia that was found.
        converged: whether the last step changed the cost by less than a millionth.
    """

    front: AbstractTire
    rear: AbstractTire
    parameters: Mapping[str, Estimate]
    noise: Mapping[str, float]
    windows: int
    blocks: int
    vehicle: Vehicle
    converged: bool


def fit_trajectory(
    logs: Sequence,
    vehicle: Vehicle | str,
    front="brush",
    rear="brush",
    *,
    unknowns: Sequence[str] = ("steering_delay", "steering_offset"),
    window: float = WINDOW,
) -> TrajectoryFit:
    """Fit both axles' tires, and unknowns of the car, to windows of its logs.

    Args:
        logs: vehicle logs, as for :func:`tirefit.derive_files`.
        vehicle: a vehicle or its ``vehicle.toml``, with a steering map.
        front, rear: where the fit begins: a fit of the axle or its ``fit.json``, whose
            free parameters are estimated.
        unknowns: of :data:`UNKNOWNS`, estimated beside the tires.
        window: length of a window [s].

    Raises:
        UsageError: an unknown that is not known, a vehicle without a steering map, or
            a tire that is no fit.
        DataError: a log that cannot be read, or no window in it.
    """
    require_x64("a fit by trajectory")
    vehicle = known_vehicle(vehicle)
    tires = axle_tire(front), axle_tire(rear)
    _check(vehicle, unknowns, tires)
    rate = vehicle.filter.sample_rate
    found = cut_logs(
        logs, vehicle,
        lambda track, motion: windows_of(track, motion, vehicle, window),
        f"{window:g} s long", "a shorter window",
    )  # fmt: skip
    parts = [windows for _, windows in found.values()]
    data = Data(*(jnp.concatenate(each) for each in zip(*parts, strict=True)))
    problem = _Problem(vehicle, tires, tuple(unknowns), rate, data)
    return problem.solved()


def _check(vehicle: Vehicle, unknowns, tires) -> None:
    problems = steering_problems(vehicle, "a fit by trajectory")
    for name in unknowns:
        if name not in UNKNOWNS:
            remedy = f"{did_you_mean(name, UNKNOWNS)}valid: {', '.join(UNKNOWNS)}"
            problems.append(InputProblem(f"{name!r} is no unknown of a car", remedy))
    for axle, tire in zip(("front", "rear"), tires, strict=True):
        if tire.fit is None:
            reason = f"the {axle} tire {tire.name} is no fit: nothing is free in it"
            remedy = f"fit it first: tirefit derive --axle {axle}, then tirefit fit"
            problems.append(InputProblem(reason, remedy))
    UsageError.raise_for(problems)


class _Problem:
    """Squares of predicted less logged over all windows.

    z holds the tires' parameters in their unconstrained space, then the unknowns.
    """

    def __init__(self, vehicle, tires, unknowns, rate, data: Data):
        self.vehicle, self.tires, self.unknowns = vehicle, tires, unknowns
        self.rate, self.data = rate, data
        self.layouts: list[Layout] = [tire.fit[0] for tire in tires]
        self.first = np.cumsum([0, *(layout.size for layout in self.layouts)])
        self.z = np.concatenate([*(t.fit[1] for t in tires), np.zeros(len(unknowns))])
        self.names = CHANNELS[data.logged.shape[-1]]
        slowest = float(np.min(data.v_x))
        parts = steps_a_sample(self.car(self.z), slowest, rate)
        self.run = linearised(self.missed, parts)

    def unknown(self, z, name: str, default: float = 0.0):
        """The value of an unknown, in its unit; a factor of one without it."""
        if name not in self.unknowns:
            return default
        value = z[self.first[-1] + self.unknowns.index(name)]
        return jnp.exp(value) if UNKNOWNS[name].is_factor else value

    def tire(self, z, axle: int) -> AbstractTire:
        first, last = self.first[axle : axle + 2]
        values = self.layouts[axle].natural(z[first:last])
        return with_values(self.tires[axle].tire, values)

    def car(self, z) -> Car:
        inertia = self.unknown(z, "yaw_inertia", 1.0)
        return car_of(self.vehicle, self.tire(z, 0), self.tire(z, 1), inertia)

    def missed(self, z, start, window: Data, parts: int):
        """Predicted less logged (k, c) of one window."""
        step, count = 1 / self.rate, window.v_x.shape[0]
        lead = window.steering.shape[0] - count
        time = step * jnp.arange(-lead, count)
        late = time[lead:] - self.unknown(z, "steering_delay")
        steering = jnp.interp(late, time, window.steering)
        steering = steering * self.unknown(z, "steering_ratio", 1.0)
        steering = steering + self.unknown(z, "steering_offset")
        whole = jnp.concatenate([start, jnp.zeros(5 - len(start))])
        states = predicted(
            self.car(z), State(*whole), window.v_x, steering, step, parts
        )
        zero = self.unknown(z, "sideslip_zero")
        if len(self.names) == 2:
            found = [states.v_y + zero * window.v_x, states.yaw_rate]
        else:
            found = [states.heading - zero, states.x, states.y]
        return jnp.stack(found, axis=1) - window.logged

    def solved(self) -> TrajectoryFit:
        z, starts = jnp.asarray(self.z), jnp.asarray(self.data.start)
        pull, now = self.pulls(), self.run(z, starts, self.data)
        for _ in range(_ROUNDS):
            noise = jnp.sqrt(jnp.mean(now[0] ** 2, axis=(0, 1)))
            z, starts, now, converged = minimised(
                self.run, z, starts, now, self.data, noise, pull
            )
        missed, by_z, by_start = now
        free = self.data.start.size + len(self.z)
        count = missed.shape[0] * missed.shape[1]
        noise = jnp.sqrt(
            jnp.sum(missed**2, axis=(0, 1)) / max(count - free / len(self.names), 1)
        )
        covariance, blocks = sandwich(missed, by_z, by_start, noise, pull)
        return self.told(
            np.asarray(z), covariance, blocks, np.asarray(noise), converged
        )

    def pulls(self) -> np.ndarray:
        """Precision (p,) of the weak priors of the unknowns at zero."""
        priors = [1 / UNKNOWNS[name].prior ** 2 for name in self.unknowns]
        return np.concatenate([np.zeros(self.first[-1]), priors])

    def told(self, z, covariance, blocks: int, noise, converged) -> TrajectoryFit:
        reach = student.ppf(0.975, max(blocks - 1, 1))
        std, found = np.sqrt(np.diag(covariance)), {}

        def add(name, unit, k, natural: Callable):
            sides = z[k] - reach * std[k], z[k] + reach * std[k]
            low, high = sorted(float(natural(side)) for side in sides)
            slope = abs(natural(z[k] + 1e-6) - natural(z[k] - 1e-6)) / 2e-6
            value = float(natural(z[k]))
            found[name] = Estimate(value, float(slope * std[k]), (low, high), unit)

        for axle, layout in enumerate(self.layouts):
            for k, (label, free) in enumerate(layout.elements):

                def natural(value, k=k, layout=layout, axle=axle):
                    own = np.array(z[self.first[axle] : self.first[axle + 1]])
                    own[k] = value
                    return layout.vector(own)[k]

                name = f"{('front', 'rear')[axle]}.{label}"
                add(name, free.spec.unit, self.first[axle] + k, natural)
        for k, name in enumerate(self.unknowns):
            one = UNKNOWNS[name]
            scale = self.vehicle.yaw_inertia if name == "yaw_inertia" else 1.0
            by = partial(_factor, scale) if one.is_factor else float
            add(name, one.unit, self.first[-1] + k, by)
        car = self.car(z)
        vehicle = self.vehicle.model_copy(
            update={"yaw_inertia": float(car.yaw_inertia)}
        )
        return TrajectoryFit(
            car.front, car.rear, found,
            {c: float(s) for c, s in zip(self.names, noise, strict=True)},
            len(self.data.v_x), blocks, vehicle, bool(converged),
        )  # fmt: skip


def _factor(scale: float, logarithm) -> float:
    return scale * float(np.exp(logarithm))
