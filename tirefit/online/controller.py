"""What a brake controller is: a record with ``init`` and ``step`` at a fixed rate.

A step sees what the sensors say at one instant and answers with what the valves do
until the next one. It costs the same whenever it comes, allocates nothing and knows no
later sample, so the record that runs in the simulated loop (:mod:`tirefit.sim.brake`)
could run on the controller of a car. Wheels come along one axis of length w, in the
order of :data:`tirefit.data.table.WHEELS`, or one wheel alone.
"""

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

INCREASE, HOLD, DECREASE = 1.0, 0.0, -1.0
"""Inlet valve open; both shut; outlet valve open, for the whole of an interval."""


class Truth(NamedTuple):
    """What no sensor tells; only a controller that is an upper limit may read it."""

    speed: Float[Array, " w"]  # [m/s] of the wheel's centre along the wheel
    slip: Float[Array, " w"]  # kappa
    peak: Float[Array, " w"]  # kappa of the largest force on the wheel's road
    mu: Float[Array, " w"]  # that force over the load
    fz: Float[Array, " w"]  # [N]


class Measurement(NamedTuple):
    """One sample of the sensors; SI units, braking positive. ``demand``, the pressure
    of the master cylinder, is the driver's wish and the most that a valve can give."""

    time: Float[Array, ""]  # [s]
    wheel_speed: Float[Array, " w"]  # [m/s] R omega, with noise and steps
    pressure: Float[Array, " w"]  # [Pa] of the wheel cylinders
    deceleration: Float[Array, ""]  # [m/s2] of the vehicle along its axis
    demand: Float[Array, ""]  # [Pa]
    steering: Float[Array, ""]  # [rad] road wheel angle
    yaw_rate: Float[Array, ""]  # [rad/s]
    truth: Truth


class Command(NamedTuple):
    """What the valves do until the next sample.

    ``valve`` (w,) in [-1, 1]: share of the interval for which the inlet (positive) or
    outlet (negative) is open; ``INCREASE``, ``HOLD`` or ``DECREASE`` if on-off.
    """

    valve: Float[Array, " w"]


Info = Mapping[str, Float[Array, " w"]]
"""What a human may want to see, by the name of its column in SI units (``xbs`` [N s/m],
``reference_speed`` [m/s], ``target_pressure`` [Pa], ...); nothing feeds back from it.
The names and shapes are the same at every step; what is of the vehicle alone is given
for every wheel."""


class AbstractController(eqx.Module):
    """One brake controller; its fields are its settings, scalars or one for each wheel.

    A state is a pytree of arrays whose shapes never change.
    """

    name: ClassVar[str]
    meaning: ClassVar[str]
    reads_truth: ClassVar[bool] = False

    rate: float = eqx.field(static=True, default=200.0)
    """Samples a second, fixed."""

    @property
    def period(self) -> float:
        """Time [s] between two samples."""
        return 1 / self.rate

    def init(self, first: Measurement) -> Any:
        """The state before the first sample, which is ``first`` (it sets the shapes and
        what the controller takes for known then, as the speed of the free wheels)."""
        raise NotImplementedError

    def step(
        self, state: Any, measurement: Measurement
    ) -> tuple[Any, Command, dict[str, Float[Array, " w"]]]:
        """The state, the command and the info after a sample."""
        raise NotImplementedError


class NoController(AbstractController):
    """The driver's pressure on every wheel: a wheel that he locks stays locked."""

    name: ClassVar[str] = "none"
    meaning: ClassVar[str] = "no controller: the driver's pressure on every wheel"

    def init(self, first: Measurement) -> tuple[()]:
        return ()

    def step(self, state, measurement):
        return state, Command(jnp.full_like(measurement.pressure, INCREASE)), {}
