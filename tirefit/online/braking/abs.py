r"""Conventional anti-lock braking by rules on wheel acceleration and slip.

The cycle is that of a textbook, Bosch (2014). If a wheel slows faster than the car can,
its pressure is held; if it slips as well, the pressure falls until the wheel stops
slowing. The pressure is held while the wheel speeds up. Then it rises, fast to a share of
the pressure at which the wheel last tended to lock, and then in small steps.

====== ======== ==============================================================
phase  valve    next phase, and when
====== ======== ==============================================================
build  increase *hold* at :math:`\dot v_w < -a`; *dump* at slip > :math:`\lambda_2`
hold   hold     *dump* at slip > :math:`\lambda_1`; *step* at :math:`\dot v_w > -a`
dump   decrease *wait* at :math:`\dot v_w > -a`
wait   hold     *step* after :math:`\dot v_w > +a` has ended, or at once at
                :math:`\dot v_w > +A`; *dump* if slip stays above
                :math:`\lambda_1` and the wheel has not sped up in time
step   steps up *dump* at :math:`\dot v_w < -a` and slip > :math:`\lambda_1`
====== ======== ==============================================================

The slip is computed with a reference speed: that of the fastest wheel, which falls no
faster than the measured deceleration of the car plus a margin. Both rear wheels have the
lower pressure of the two (select-low). Below a speed the controller switches off.

The thresholds have the best mean friction of some 900 random sets, on two tires (brush-m
with m = 0.5, Magic Formula) and the roads mu = 0.12, 0.3, 0.8 and 0.3 to 0.8; a dozen
other sets are within 0.5 % of it.
"""

from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from tirefit.arrays import Number
from tirefit.online.braking.controller import (
    DECREASE,
    HOLD,
    INCREASE,
    AbstractController,
    Measurement,
)
from tirefit.params import par

PHASES = ("build", "hold", "dump", "wait", "step")
BUILD, HELD, DUMP, WAIT, STEP = range(len(PHASES))


class _State(NamedTuple):
    """State of the cycle, for each wheel (w,)."""

    reference: Number  # [m/s]
    wheel: Float[Array, " w"]  # speed at the previous sample
    acceleration: Float[Array, " w"]  # filtered rate of the speed
    phase: Int[Array, " w"]
    since: Float[Array, " w"]  # [s] in the phase
    fast: Float[Array, " w"]  # 1 if the wheel has sped up in this *wait*
    lock: Float[Array, " w"]  # [Pa] at the last tendency to lock


class ConventionalABS(AbstractController):
    """Rules on wheel acceleration and slip, with a reference speed."""

    name: ClassVar[str] = "abs"
    meaning: ClassVar[str] = "conventional ABS: rules on wheel acceleration and slip"

    slowing: float = par(
        9.0, (1.0, 200.0), "m/s2", "deceleration above which a wheel tends to lock"
    )
    speeding: float = par(5.0, (0.5, 200.0), "m/s2", "acceleration above which a wheel recovers")
    racing: float = par(90.0, (1.0, 500.0), "m/s2", "acceleration at which pressure rises at once")
    slip: float = par(0.07, (0.005, 0.5), "-", "slip beside a deceleration")
    most_slip: float = par(0.16, (0.01, 0.9), "-", "slip that is too much in any case")
    patience: float = par(0.04, (0.0, 1.0), "s", "time in which a wheel should speed up")
    quick: float = par(
        0.65, (0.0, 1.0), "-", "share of the last lock pressure to which it rises fast"
    )
    dump_share: float = par(0.45, (0.05, 1.0), "-", "share of time with the outlet open, in a dump")
    step_share: float = par(0.12, (0.0, 1.0), "-", "share of time with the inlet open, in steps")
    step_growth: float = par(1.2, (0.0, 20.0), "1/s", "rate at which that share grows")
    smoothing: float = par(0.006, (0.0, 1.0), "s", "time constant of the wheel acceleration")
    margin: float = par(0.3, (0.0, 10.0), "m/s2", "by which the reference may fall faster")
    off: float = par(1.5, (0.0, 10.0), "m/s", "speed below which it is off")

    def init(self, first: Measurement) -> _State:
        none = jnp.zeros_like(first.wheel_speed)
        speed, lock = first.wheel_speed, jnp.full_like(none, jnp.inf)
        return _State(jnp.max(speed), speed, none, none.astype(int), none, none, lock)

    def step(self, state: _State, measurement: Measurement) -> Any:
        wheel = measurement.wheel_speed
        rate = (wheel - state.wheel) / self.period
        share = self.period / (self.period + self.smoothing)
        acceleration = state.acceleration + share * (rate - state.acceleration)
        fall = jnp.maximum(measurement.deceleration, 0.0) + self.margin
        reference = jnp.maximum(jnp.max(wheel), state.reference - fall * self.period)
        fast = jnp.where(acceleration > self.speeding, 1.0, state.fast)
        seen = _State(reference, wheel, acceleration, state.phase, state.since, fast, state.lock)
        slip = 1 - wheel / jnp.maximum(reference, 1e-3)
        phase = self._next_phase(seen, slip)
        since = jnp.where(phase != state.phase, 0.0, state.since + self.period)
        tends = (phase == HELD) | (phase == DUMP)
        first = tends & ((state.phase == BUILD) | (state.phase == STEP))
        lock = jnp.where(first, measurement.pressure, state.lock)
        fast = jnp.where(phase == WAIT, fast, 0.0)
        after = _State(reference, wheel, acceleration, phase, since, fast, lock)
        info = {
            "reference_speed": jnp.full_like(slip, reference),
            "wheel_acceleration": acceleration,
            "phase": phase.astype(float),
        }
        return after, self._valve(after, measurement), info

    def _next_phase(self, seen: _State, slip: Float[Array, " w"]) -> Int[Array, " w"]:
        """Phases (w,) by the table of the module."""
        slows = seen.acceleration < -self.slowing
        slips, deep = slip > self.slip, slip > self.most_slip
        build = jnp.where(deep, DUMP, jnp.where(slows, HELD, BUILD))
        held = jnp.where(slips, DUMP, jnp.where(slows, HELD, STEP))
        dump = jnp.where(slows, DUMP, WAIT)
        settled = (seen.fast > 0) & (seen.acceleration < self.speeding) & ~deep
        idle = (seen.fast == 0) & (seen.since >= self.patience)
        rolls = settled | (seen.acceleration > self.racing) | (idle & ~slips)
        wait = jnp.where(rolls, STEP, jnp.where(slows | (idle & slips), DUMP, WAIT))
        step = jnp.where((slows & slips) | deep, DUMP, jnp.where(slows, HELD, STEP))
        # A dump lasts at least two samples, so that it reduces a large slip.
        dump = jnp.where((seen.since < self.period) & slips, DUMP, dump)
        choices = [build, held, dump, wait, step]
        after = jnp.select([seen.phase == k for k in range(len(PHASES))], choices)
        return jnp.where(seen.reference < self.off, BUILD, after)

    def _valve(self, state: _State, measurement: Measurement) -> Float[Array, " w"]:
        near = measurement.pressure >= self.quick * state.lock
        steps = jnp.clip(self.step_share + self.step_growth * state.since, 0.0, 1.0)
        step = jnp.where(near, steps, INCREASE)
        choices = INCREASE, HOLD, DECREASE * self.dump_share, HOLD, step
        spread = [jnp.broadcast_to(jnp.asarray(c, float), step.shape) for c in choices]
        valve = jnp.select([state.phase == k for k in range(len(PHASES))], spread)
        if len(valve) != 4:
            return valve
        # Select-low: the rear wheel that tends to lock sets the pressure of both.
        return valve.at[2:].set(jnp.min(valve[2:]))
