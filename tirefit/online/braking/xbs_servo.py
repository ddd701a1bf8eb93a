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

O(11) is checked when the record is made, and also an upper limit of the gain by the delay of the
valves, which O does not state. That delay is part of the relation of the estimator as well. There
are three differences from O. The estimator uses 3-30 Hz, where the pole is at a share of 90 %, and
the speed itself instead of :math:`v_w - v_0`: both are equivalent if :math:`v_0` slows evenly, but
a wheel with p far above a hardly follows a reference that does not. It drops a past that is much
stronger than the present (``quiet``). And the deceleration of the vehicle is measured.

Small gains are no disadvantage: the estimate has a delay of 0.3 s, and a slip velocity
that grows by 0.5 m/s2 crosses the peak of a road of 0.3 in less than a second.
"""

import dataclasses
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


def loop_matrix(gain: float, pole: float, rate: float, delay: int, lag: float) -> np.ndarray:
    r"""One sample of the linearised loop of wheel, deceleration servo and valves.

    The wheel is :math:`\dot x = -p x - q`, with deviations x of its speed [m/s] and q of
    the brake torque over J/r [m/s2] from an equilibrium. The pressure follows its target
    with a lag and a delay of whole samples; the target is a x.

    Args:
        gain: a [1/s]; pole: p = k r^2 / J [1/s].
        delay: samples; lag: [s], > 0.

    Returns:
        Matrix (2 + delay, 2 + delay) for (x, q, delayed targets).
    """
    from scipy.linalg import expm

    block = np.zeros((3, 3))
    block[0, :2] = -pole, -1.0
    block[1, 1:] = -1 / lag, 1 / lag
    sampled = expm(block / rate)
    matrix = np.zeros((2 + delay, 2 + delay))
    matrix[:2, :2] = sampled[:2, :2]
    if delay == 0:
        matrix[:2, 0] += sampled[:2, 2] * gain
        return matrix
    matrix[:2, 2] = sampled[:2, 2]
    matrix[2:-1, 3:] = np.eye(delay - 1)
    matrix[-1, 0] = gain
    return matrix


def refuse_unstable(
    gain: float, least_slope: float, most_slope: float, radius: float, inertia: float, rate: float,
    delay: int, lag: float,
) -> None:  # fmt: skip
    """Check O(11), and the stability of the loop with sampling, delay and lag.

    Args:
        gain: a [1/s].
        least_slope, most_slope: range of k [N s/m] of a wheel.
        radius: r [m]; inertia: J [kg m2]; others as in :func:`loop_matrix`.

    Raises:
        UsageError: names the condition that is broken and its numbers.
    """
    poles = {k: k * radius**2 / inertia for k in (least_slope, most_slope)}
    bound = -poles[least_slope]
    if not gain > bound:
        raise UsageError(
            f"the gain of the deceleration servo breaks O(11), a > -k_min r^2/J:"
            f" {gain:g} is not above {bound:g} 1/s (k_min = {least_slope:g} N s/m,"
            f" r = {radius:g} m, J = {inertia:g} kg m2)",
            f"give servo_gain more than {bound:.3g}, or a least_slope nearer zero",
        )
    for slope, pole in poles.items():
        largest = np.abs(np.linalg.eigvals(loop_matrix(gain, pole, rate, delay, lag))).max()
        if largest >= 1:
            raise UsageError(
                f"the deceleration servo is unstable at k = {slope:g} N s/m: with a"
                f" gain of {gain:g} 1/s, a delay of {1e3 * delay / rate:g} ms and a"
                f" lag of {1e3 * lag:g} ms, sampled {rate:g} times a second, the"
                f" largest eigenvalue of the loop is {largest:.4g}, not below 1",
                "O(11) bounds the gain from below only: give a smaller servo_gain",
            )


_OF_XBS = {f.name: f.metadata["spec"] for f in dataclasses.fields(Xbs) if "spec" in f.metadata}
"""Specifications of the settings of the estimator, of which making one takes a second."""


def _of_xbs(name: str, default: float) -> Any:
    """The setting of the estimator, with another default."""
    spec = _OF_XBS[name]
    return par(default, spec.bounds, spec.unit, spec.meaning, spec.source, spec.symbol)


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

    share: float = par(0.9, (0.3, 0.995), "-", "wanted share of the friction", "O(22)", r"\gamma")
    pull: float = par(
        0.5, (0.01, 50.0), "m/s2", "extra deceleration at twice the target stiffness", "O §3.1", "c"
    )
    release: float = par(
        0.3, (0.0, 50.0), "m/s2", "less deceleration for zero stiffness", "O §3.1", "c_-"
    )
    most_pull: float = par(8.0, (0.1, 100.0), "m/s2", "limit of both", "O §3.1", "c_{max}")
    start_pull: float = par(
        7.0, (0.0, 100.0), "m/s2", "the same until there is an estimate", "", "c_0"
    )
    servo_gain: float = par(
        75.0, (-500.0, 500.0), "1/s", "gain of the deceleration servo", "O(8)", "a"
    )
    stiffness: Any = 6e4  # K_s = 2 c_p a^2 [N] of each tire
    stiffness_ratio: float = par(
        0.7, (0.05, 20.0), "-", "lateral over longitudinal stiffness", "O(13)", r"K_\beta / K_s"
    )
    least_slope: float = par(
        -250.0, (-1e5, 0.0), "N s/m", "smallest k on any road at any slip", "O(11)", r"k_{min}"
    )
    most_slope: float = par(
        3e4, (1.0, 1e7), "N s/m", "largest k at any speed that is controlled", "", r"k_{max}"
    )
    radius: Any = 0.3  # rolling radius r [m]
    inertia: Any = 1.2  # J [kg m2] of each wheel
    brake_gain: Any = 1.35e-4  # torque over pressure [N m/Pa] of each brake
    steered: Any = 0.0  # 1 for steered wheels
    ahead: Any = 0.0  # distance [m] of each wheel ahead of the centre of gravity
    rise: float = 40e6  # fastest rise of a wheel's pressure through its inlet [Pa/s]
    fall: float = 80e6  # fastest fall through its outlet [Pa/s]
    lag: float = 0.02  # time constant [s] of an open valve
    delay: float = eqx.field(static=True, default=0.01)  # time [s] until a command takes effect
    reach: float = 1e6  # largest distance [Pa] of the target from the pressure
    response: float = par(
        1.0, (0.05, 1.0), "-", "share of that error removed in an interval", "", "q"
    )
    low: float = _of_xbs("low", 3.0)
    high: float = _of_xbs("high", 30.0)
    forgetting: float = _of_xbs("forgetting", 0.98)
    quiet: float = _of_xbs("quiet", 0.6)
    road_corner: float = _of_xbs("road_corner", 1.0)
    speed_noise: float = _of_xbs("speed_noise", 0.006)
    xbs: Any = None  # the estimator, computed from the settings above; its wheel has J / r^2 = 1

    def __post_init__(self) -> None:
        refuse_unstable(
            float(self.servo_gain),
            float(self.least_slope),
            float(self.most_slope),
            float(np.max(self.radius)),
            float(np.min(self.inertia)),
            self.rate,
            round(self.delay * self.rate),
            self.period / self.response,
        )
        alike = ("rate", "servo_gain", "low", "high", "forgetting", "quiet")
        self.xbs = Xbs(
            **{name: getattr(self, name) for name in (*alike, "road_corner", "speed_noise")},
            radius=1.0,
            wheel_inertia=1.0,
            # The mean of a ramp over an interval has a delay of half an interval.
            servo_delay=self.delay + (1 / self.response - 0.5) * self.period,
        )

    def init(self, first: Measurement) -> XbsServoState:
        speed = first.wheel_speed
        none = jnp.zeros_like(speed)
        coming = jnp.zeros((round(self.delay * self.rate), *speed.shape))
        xbs = jax.tree.map(lambda x: jnp.full_like(speed, x), self.xbs.init())
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
        target = jnp.clip(target, ready - self.reach, ready + self.reach)
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
        share = jnp.clip(self.response * error / full, -1.0, 1.0)
        return share, share * full
