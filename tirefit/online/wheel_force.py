r"""Braking force of a wheel from its speed and torque, S section 3.8.

Of :math:`J \dot\omega = R F - T` the force is estimated in the source's two ways:

* recursive least squares with forgetting on
  :math:`\omega_i - \omega_{i-1} + T \Delta t / J = (R \Delta t / J) F`,
* an adaptive observer, :math:`\dot{\hat\omega} = (R \hat F - T)/J + 2 p \tilde\omega,
  \; \dot{\hat F} = p^2 (J / R) \tilde\omega`, whose error dies as :math:`e^{-pt}`.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp


class Observer(NamedTuple):
    """Wheel speed [rad/s] and force [N] of the adaptive observer."""

    omega: Any
    force: Any


def observer_step(state: Observer, omega, torque, dt, radius, inertia, pole):
    """The observer after ``dt`` [s] with a torque [N m], corrected by a wheel speed.

    The gains are those with which both errors of the discrete loop shrink by
    exp(-pole dt) a sample, at any dt.

    Args:
        omega: measured wheel speed [rad/s]; pole: p [1/s].
        radius: [m]; inertia: J [kg m2] of the wheel.
    """
    lever = radius * dt / inertia
    ahead = state.omega + lever * state.force - dt * torque / inertia
    error = omega - ahead
    keep = jnp.exp(-pole * dt)
    gain = (1 - keep) ** 2 / jnp.maximum(lever, 1e-12)
    return Observer(ahead + (1 - keep * keep) * error, state.force + gain * error)


def observer_std(omega_std, torque_std, dt, radius, inertia, pole):
    """Standard deviation [N] of the observer's force, from that of white noise.

    ``omega_std`` [rad/s] and ``torque_std`` [N m] of one sample, ``dt`` [s] apart; for
    pole dt well below one.
    """
    of_speed = inertia * omega_std * jnp.sqrt(dt * pole**3 / 4)
    return jnp.hypot(of_speed, torque_std * jnp.sqrt(dt * pole / 4)) / radius


class WheelRls(NamedTuple):
    """Wheel speed [rad/s] of the last sample; force [N] and P [N2]."""

    omega: Any
    force: Any
    spread: Any


def wheel_rls_step(
    state: WheelRls, omega, torque, dt, radius, inertia, memory, omega_std
):
    """Least squares with forgetting after one more sample.

    Args:
        omega: measured [rad/s], with noise of ``omega_std``; torque [N m] since then.
        memory: time [s] in which the weight of a sample falls to 1/e.
    """
    lever = radius * dt / inertia
    # A difference of two speeds has the noise of both.
    noise = 2 * omega_std**2
    grown = state.spread * jnp.exp(dt / memory)
    gain = grown * lever / (lever * lever * grown + noise)
    error = omega - state.omega + torque * dt / inertia - lever * state.force
    return WheelRls(omega, state.force + gain * error, grown * (1 - gain * lever))
