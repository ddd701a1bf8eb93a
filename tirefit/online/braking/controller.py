"""Base of brake controllers: records with ``init`` and ``step`` at a fixed rate.

A step receives the sensor values at one time and returns the valve commands until the
next. Its cost is constant, it allocates no memory and uses no later sample, so the record
that runs in the simulated loop (:mod:`tirefit.sim.brake`) could run in a car. Wheels are
along an axis of length w, in the order of :data:`tirefit.data.table.WHEELS`, or one wheel.
"""

from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from tirefit.arrays import Number

INCREASE, HOLD, DECREASE = 1.0, 0.0, -1.0
"""Inlet valve open, both valves shut, outlet valve open; for the whole interval."""


class Truth(NamedTuple):
    """Values that no sensor measures, for a controller that serves as an upper limit."""

    speed: Float[Array, " w"]  # [m/s] of the wheel's centre along the wheel
    slip: Float[Array, " w"]  # kappa
    peak: Float[Array, " w"]  # kappa of the largest force on the wheel's road
    mu: Float[Array, " w"]  # that force over the load
    fz: Float[Array, " w"]  # [N]


class Measurement(NamedTuple):
    """One sample of the sensors; SI units, braking positive. ``demand`` is the pressure of
    the master cylinder: the driver's demand, and the largest pressure of a wheel."""

    time: Number  # [s]
    wheel_speed: Float[Array, " w"]  # [m/s] R omega, with noise and steps
    pressure: Float[Array, " w"]  # [Pa] of the wheel cylinders
    deceleration: Number  # [m/s2] of the vehicle along its axis
    demand: Number  # [Pa]
    steering: Number  # [rad] road wheel angle
    yaw_rate: Number  # [rad/s]
    truth: Truth


class AbstractController(eqx.Module):
    """One brake controller; its fields are its settings, scalars or one for each wheel.

    A state is a pytree of arrays whose shapes never change.
    """

    name: ClassVar[str]
    meaning: ClassVar[str]

    rate: float = eqx.field(static=True, default=200.0)  # the fixed number of samples per second

    @property
    def period(self) -> float:
        """Time [s] between two samples."""
        return 1 / self.rate

    def init(self, first: Measurement) -> Any:
        """The state before ``first``, the first sample, which gives the shapes and initial
        values such as the speed of the free wheels."""
        raise NotImplementedError

    def step(
        self, state: Any, measurement: Measurement
    ) -> tuple[Any, Float[Array, " w"], dict[str, Float[Array, " w"]]]:
        """The state, the command, and values for the log by the name of their column.

        The command (w,), in [-1, 1], is the share of the interval until the next sample for which
        the inlet (positive) or outlet (negative) is open. The values (w,) have no effect on the
        control. Names and shapes are the same at every step.
        """
        raise NotImplementedError


class NoController(AbstractController):
    """No control: every wheel has the driver's pressure, so a locked wheel stays locked."""

    name: ClassVar[str] = "none"
    meaning: ClassVar[str] = "no controller: the driver's pressure on every wheel"

    def init(self, first: Measurement) -> tuple[()]:
        return ()

    def step(self, state: Any, measurement: Measurement) -> tuple[Any, Array, dict[str, Array]]:
        return state, jnp.full_like(measurement.pressure, INCREASE), {}
