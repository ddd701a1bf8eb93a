"""A controller that serves as an upper limit, and an example of a controller of one's own."""

from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from tirefit.online.braking.controller import AbstractController, Measurement
from tirefit.params import par

__all__ = ["SlipControl"]


class _State(NamedTuple):
    """Slip speed (w,) [m/s] at the previous sample, and its filtered rate."""

    sliding: Float[Array, " w"]
    rate: Float[Array, " w"]


class SlipControl(AbstractController):
    r"""Slip control at the true peak of the road with the true slip and load, an upper limit.

    It commands the pressure that holds the wheel there; its loss is that of the hydraulics:

    .. math:: p = \frac{R \mu F_z}{g} \left(1 + K (\kappa^* - \kappa)
        - \frac{J}{R^2 \mu F_z} D (\dot v - \dot v_w) \right)
    """

    name: ClassVar[str] = "slip"
    meaning: ClassVar[str] = "slip held at the true peak of the road: the upper limit"

    share: float = par(0.8, (0.1, 2.0), "-", "target slip over that of the peak")
    gain: float = par(10.0, (0.0, 100.0), "-", "pressure by slip error")
    damping: float = par(0.4, (0.0, 50.0), "-", "torque by rate of the slip speed")
    smoothing: float = par(0.0025, (0.0, 1.0), "s", "time constant of that rate")
    response: float = par(0.045, (1e-3, 1.0), "s", "time constant of a pressure error")
    rise: Any = 40e6  # of an open inlet [Pa/s]
    fall: Any = 80e6  # of an open outlet [Pa/s]
    radius: Any = 0.3
    inertia: Any = 1.2
    brake_gain: Any = 1.35e-4

    def init(self, first: Measurement) -> _State:
        none = jnp.zeros_like(first.wheel_speed)
        return _State(none, none)

    def step(self, state: _State, measurement: Measurement) -> Any:
        truth = measurement.truth
        sliding = truth.slip * truth.speed
        share = self.period / (self.period + self.smoothing)
        rate = (sliding - state.sliding) / self.period
        rate = state.rate + share * (rate - state.rate)
        wanted = self.share * truth.peak
        holding = truth.mu * truth.fz * self.radius
        damped = self.damping * self.inertia / self.radius * rate
        torque = holding * (1 + self.gain * (wanted - truth.slip)) - damped
        target = jnp.clip(torque / self.brake_gain, 0.0, measurement.demand)
        error = (target - measurement.pressure) / self.response
        valve = jnp.where(error > 0, error / self.rise, error / self.fall)
        info = {"target_pressure": target, "target_slip": wanted}
        return _State(sliding, rate), jnp.clip(valve, -1.0, 1.0), info
