r"""The bicycle model along a lane, S(22) as corrected: where the vehicle goes next."""

import jax
import jax.numpy as jnp


def bicycle(c_f, c_r, mass, yaw_inertia, l_f, l_r, u):
    """Matrices of the states (y, dy/dt, heading less the road's, yaw rate).

    Args:
        c_f, c_r: cornering stiffness of the axles [N/rad], positive: 2 |C_f| of S(22),
            whose C is that of one tire, and negative.
        l_f, l_r: a and b of S(22) [m]; u: speed [m/s].

    Returns:
        A (4, 4), and the columns (4,) of the steering angle and the road's yaw rate.
    """
    both, turned = c_f + c_r, l_f * c_f - l_r * c_r
    damped = l_f**2 * c_f + l_r**2 * c_r
    zero, one = jnp.zeros_like(u), jnp.ones_like(u)
    a = jnp.stack(
        [
            jnp.stack([zero, one, zero, zero]),
            jnp.stack([zero, -both / u, both, -turned / u]) / mass,
            jnp.stack([zero, zero, zero, one]),
            jnp.stack([zero, -turned / u, turned, -damped / u]) / yaw_inertia,
        ]
    )
    steered = jnp.stack([zero, c_f / mass, zero, l_f * c_f / yaw_inertia])
    return a, steered, jnp.stack([zero, -u, -one, zero])


def lane_crossing(state, a, drive, edge, horizon, steps=40):
    """Time [s] at which ``|y|`` reaches ``edge`` [m] on the predicted path.

    Args:
        state: (4,) as of :func:`bicycle`; drive: (4,) what the inputs add, held.
        horizon: time [s] that is looked ahead, in ``steps``.

    Returns:
        the time, NaN where the vehicle stays in its lane.
    """
    h = horizon / steps

    def rate(x):
        return a @ x + drive

    def step(x, _):
        # Classical Runge-Kutta; h is a tenth of a second.
        k1 = rate(x)
        k2 = rate(x + h / 2 * k1)
        k3 = rate(x + h / 2 * k2)
        k4 = rate(x + h * k3)
        after = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return after, after[0]

    _, path = jax.lax.scan(step, state, length=steps)
    path = jnp.concatenate([state[:1], path])
    beyond = jnp.abs(path) >= edge
    k = jnp.maximum(jnp.argmax(beyond), 1)
    before, after = jnp.abs(path[k - 1]), jnp.abs(path[k])
    rise = jnp.where(after > before, after - before, 1.0)
    share = jnp.clip((edge - before) / rise, 0.0, 1.0)
    return jnp.where(jnp.any(beyond), h * (k - 1 + share), jnp.nan)
