r"""A brake control by extended braking stiffness, O sections 3.1 and 3.2.

It has three layers, each with a few numbers per wheel (O Figure 7):

* **stiffness to deceleration**: the target of the extended braking stiffness
  :math:`\hat k` (:mod:`tirefit.online.braking.xbs`) is :math:`k_0` of O(22), that of a given share
  :math:`\gamma` of the friction, whatever the friction is. The target deceleration of the wheel is
  that of the vehicle plus ``pull`` times :math:`e = (\hat k - k_0)/k_0`, so that its slip velocity
  grows while there is a margin; for negative e, plus ``release`` times e, so that it shrinks;
* **deceleration to pressure**: torque proportional to the speed of the wheel above a
  reference with that deceleration, :math:`T = (J a / r) (v_w - v_0)`, O(8). It makes a
  wheel stable beyond the peak if O(11) holds;
* **pressure to valve**: the share of the next interval for which the inlet or the
  outlet must be open, considering commands that have not yet taken effect.

O(11) is checked when the record is made. The delay of the valves, which bounds the gain from above
(75 1/s is stable for the default car, 100 is not), is part of the relation of the estimator. There
are three differences from O. The estimator uses 3-30 Hz, where the pole is at a share of 90 %, and
the speed itself instead of :math:`v_w - v_0`, which a wheel with p far above a hardly follows. It
drops a past that is much stronger than the present. The deceleration of the vehicle is measured.

Small gains are no disadvantage: the estimate has a delay of 0.3 s, and a slip velocity
that grows by 0.5 m/s2 crosses the peak of a road of 0.3 in less than a second.
"""

from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tirefit.arrays import Number
from tirefit.models.combined import braking_slope
from tirefit.online.base import Flag, code
from tirefit.online.braking.controller import AbstractController, Measurement
from tirefit.online.braking.xbs import Xbs, XbsState
from tirefit.params import par
from tirefit.results import UsageError

Wheels = Float[Array, " w"]
_STEADY = 0.05  # time [s] over which the deceleration of the vehicle is averaged
_SLOWEST = 2.0  # speed [m/s] of the vehicle below which the pressures are held: k goes with 1/v
_LEAST_FLOW = 1e5


class XbsServoState(NamedTuple):
    """State of the servo and its estimators."""

    xbs: XbsState
    speed: Wheels  # [m/s] at the previous sample
    target: Wheels  # [Pa]
    coming: Float[Array, "d w"]  # delayed changes of pressure [Pa]
    slowing: Number  # filtered deceleration [m/s2]
    vehicle: Number  # speed [m/s]


class XbsServo(AbstractController):
    """Brake at a share of the friction that is estimated from the vibration of the wheels.

    Settings of wheel and brake may be one for all wheels or ``(w,)``; those of the valves
    are data of their manufacturer.
    """

    name: ClassVar[str] = "xbs-servo"
    meaning: ClassVar[str] = "extended braking stiffness held where O(22) says"

    share: float = par(0.9, (0.3, 0.995), "-", "wanted share of the friction")
    pull: float = par(0.5, (0.01, 50.0), "m/s2", "extra deceleration at twice the target stiffness")
    release: float = par(0.3, (0.0, 50.0), "m/s2", "less deceleration for zero stiffness")
    most_pull: float = par(8.0, (0.1, 100.0), "m/s2", "limit of both")
    start_pull: float = par(7.0, (0.0, 100.0), "m/s2", "the same until there is an estimate")
    servo_gain: float = par(75.0, (-500.0, 500.0), "1/s", "gain of the deceleration servo")
    stiffness: Any = 6e4  # K_s = 2 c_p a^2 [N] of each tire
    stiffness_ratio: float = par(0.7, (0.05, 20.0), "-", "lateral over longitudinal stiffness")
    least_slope: float = par(-250.0, (-1e5, 0.0), "N s/m", "smallest k on any road at any slip")
    radius: Any = 0.3  # rolling radius r [m]
    inertia: Any = 1.2  # J [kg m2] of each wheel
    brake_gain: Any = 1.35e-4  # torque over pressure [N m/Pa] of each brake
    steered: Any = 0.0  # 1 for steered wheels
    ahead: Any = 0.0  # distance [m] of each wheel ahead of the centre of gravity
    rise: float = 40e6  # fastest rise of a wheel's pressure through its inlet [Pa/s]
    fall: float = 80e6  # fastest fall through its outlet [Pa/s]
    lag: float = 0.02  # time constant [s] of an open valve
    delay: float = eqx.field(static=True, default=0.01)  # time [s] until a command takes effect
    low: float = par(3.0, (0.1, 50.0), "Hz", "lower edge of the band")
    high: float = par(30.0, (0.5, 500.0), "Hz", "upper edge of the band")
    forgetting: float = par(0.98, (0.5, 1.0), "-", "forgetting factor per sample")
    quiet: float = par(0.6, (0.0, 1.0), "-", "share of the past's power that makes it forgotten")
    road_corner: float = par(1.0, (0.0, 500.0), "Hz", "below it the road's disturbance is white")
    speed_noise: float = par(0.006, (0.0, 1.0), "m/s", "std of the noise of the wheel's speed")
    xbs: Any = None  # the estimator, computed from the settings above; its wheel has J / r^2 = 1

    def __post_init__(self) -> None:
        gain, least = float(self.servo_gain), float(self.least_slope)
        radius, inertia = float(np.max(self.radius)), float(np.min(self.inertia))
        bound = -least * radius**2 / inertia
        if not gain > bound:
            raise UsageError(
                f"the gain of the deceleration servo breaks O(11), a > -k_min r^2/J:"
                f" {gain:g} is not above {bound:g} 1/s (k_min = {least:g} N s/m,"
                f" r = {radius:g} m, J = {inertia:g} kg m2)",
                f"give servo_gain more than {bound:.3g}, or a least_slope nearer zero",
            )
        alike = "rate servo_gain low high forgetting quiet road_corner speed_noise".split()
        self.xbs = Xbs(
            **{name: getattr(self, name) for name in alike},
            radius=1.0,
            wheel_inertia=1.0,
            # The mean of a ramp over an interval has a delay of half an interval.
            servo_delay=self.delay + 0.5 * self.period,
        )

    def init(self, first: Measurement) -> XbsServoState:
        speed = first.wheel_speed
        none = jnp.zeros_like(speed)
        coming = jnp.zeros((round(self.delay * self.rate), *speed.shape))
        xbs = jax.tree.map(lambda x: jnp.broadcast_to(x, (*speed.shape, *x.shape)), self.xbs.init())
        return XbsServoState(xbs, speed, none, coming, jnp.zeros(()), jnp.max(speed))

    def step(self, state: XbsServoState, measurement: Measurement) -> Any:
        s, m = state, measurement
        weight = self.period / (self.period + _STEADY)  # in a mean over that time
        slowing = s.slowing + weight * (m.deceleration - s.slowing)
        vehicle = jnp.maximum(s.vehicle - self.period * slowing, 0.0)
        ready = m.pressure + jnp.sum(s.coming, axis=0)
        # Error of the pressure [Pa] up to which the servo acts as in O(8).
        follows = jnp.abs(s.target - ready) < 3e5
        xbs, slope, slope_std, flag = self._slope(s, m.wheel_speed, follows)
        wanted = self._wanted(m, vehicle)
        error = (slope - wanted) / wanted
        unknown = flag >= code(Flag.SETTLING)
        asked = jnp.where(error > 0, self.pull, self.release) * error
        pull = jnp.where(unknown, self.start_pull, asked)
        pull = jnp.clip(pull, -self.most_pull, self.most_pull)
        change = -self.period * (slowing + pull)
        # Pressure per wheel speed above the reference [Pa s/m], J a / (r g).
        per_speed = jnp.asarray(self.inertia) * self.servo_gain / jnp.asarray(self.radius)
        per_speed = per_speed / jnp.asarray(self.brake_gain)
        more = per_speed * (m.wheel_speed - s.speed - change)
        target = s.target + jnp.where(vehicle > _SLOWEST, more, 0.0)
        # The target stays within 1 MPa of the pressure.
        target = jnp.clip(target, ready - 1e6, ready + 1e6)
        target = jnp.clip(target, 0.0, m.demand)
        valve, moved = self._valves(target - ready, ready, m.demand)
        coming = jnp.concatenate([s.coming, moved[None]])[1:]
        after = XbsServoState(xbs, m.wheel_speed, target, coming, slowing, vehicle)
        info = {
            "xbs": slope,
            "xbs_std": slope_std,
            "xbs_wanted": wanted,
            "xbs_flag": flag.astype(float),
            "target_pressure": target,
            "target_deceleration": slowing + pull,
        }
        return after, valve, info

    def _slope(
        self, s: XbsServoState, speed: Wheels, use: Bool[Array, " w"]
    ) -> tuple[XbsState, Wheels, Wheels, Int[Array, " w"]]:
        """States of the estimators, k [N s/m] with its std, and flags, (w,) each."""
        sample = {"omega": speed, "use": use.astype(float)}
        xbs, made = jax.vmap(self.xbs.step)(s.xbs, sample)
        scale = jnp.asarray(self.inertia) / jnp.asarray(self.radius) ** 2
        return xbs, scale * made.value[:, 0], scale * made.std[:, 0], made.flag

    def _wanted(self, m: Measurement, vehicle: Number) -> Wheels:
        """k_0 (w,) [N s/m] of O(22), with the direction of the force from steering and yaw
        rate, assuming no sideslip of the vehicle."""
        turning = jnp.maximum(m.wheel_speed, _SLOWEST)
        moving = jnp.maximum(vehicle, _SLOWEST)
        angle = jnp.asarray(self.steered) * m.steering
        angle = angle - jnp.asarray(self.ahead) * m.yaw_rate / moving
        along = jnp.maximum(moving / turning - 1, 0.01)
        across = self.stiffness_ratio * jnp.tan(angle) * (1 + along)
        slope = braking_slope(self.share, jnp.asarray(self.stiffness), jnp.arctan2(across, along))
        return slope / turning

    def _valves(self, error: Wheels, ready: Wheels, demand: Wheels) -> tuple[Wheels, Wheels]:
        """Commands (w,), and the changes of pressure [Pa] that they cause."""
        up = jnp.clip((demand - ready) / self.lag, _LEAST_FLOW, self.rise)
        down = jnp.clip(ready / self.lag, _LEAST_FLOW, self.fall)
        full = self.period * jnp.where(error > 0, up, down)
        share = jnp.clip(error / full, -1.0, 1.0)
        return share, share * full
