"""Hamiltonian Monte Carlo in the whitened space, every chain at once, inside JAX.

There the posterior is nearly a unit Gaussian, so an identity mass and a handful of
leapfrog steps give nearly independent samples (Neal 2011). The step size is adapted
to 80 % acceptance in steps that are not kept, and then left alone.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

__all__ = ["hmc_chunk", "hmc_start"]

_LEAPFROG = 4
_TARGET = 0.8
_ADAPTATION = 100


def hmc_start(density, size: int, ensembles: int, walkers: int, seed: int):
    """First state of ``ensembles x walkers`` independent chains."""
    key, first = jax.random.split(jax.random.key(seed))
    position = 1.3 * jax.random.normal(first, (ensembles * walkers, size))
    return {
        "position": np.asarray(position),
        "key": np.asarray(jax.random.key_data(key)),
        "step_size": np.array(0.5),
        "shape": np.array([ensembles, walkers]),
        "adapting": np.array(1.0),
    }


@partial(jax.jit, static_argnames=("static", "steps"))
def _scan(arrays, static, position, key, step_size, adapting, steps):
    density = partial(static.function, **arrays, **dict(static.options))

    def value_and_slope(position):
        value, pull = jax.vjp(density, position)
        (slope,) = pull(jnp.ones_like(value))
        return value, jnp.nan_to_num(slope)

    def leapfrog(carry, _):
        position, momentum, slope, _, size = carry
        momentum = momentum + size / 2 * slope
        position = position + size * momentum
        value, slope = value_and_slope(position)
        momentum = momentum + size / 2 * slope
        return (position, momentum, slope, value, size), None

    def transition(carry, key):
        position, value, slope, step_size = carry
        kick, jitter, coin = jax.random.split(key, 3)
        momentum = jax.random.normal(kick, position.shape)
        # A jittered step size: a fixed length can be periodic on a Gaussian.
        size = step_size * jax.random.uniform(
            jitter, (len(position), 1), minval=0.6, maxval=1.2
        )
        start = (position, momentum, slope, value, size)
        end, _ = jax.lax.scan(leapfrog, start, None, length=_LEAPFROG)
        kinetic = 0.5 * jnp.sum(momentum**2 - end[1] ** 2, axis=1)
        log_ratio = jnp.nan_to_num(end[3] - value + kinetic, nan=-jnp.inf)
        accept = jnp.log(jax.random.uniform(coin, value.shape)) < log_ratio
        rate = jnp.mean(jnp.exp(jnp.minimum(log_ratio, 0.0)))
        keep = partial(jnp.where, accept[:, None])
        position, slope = keep(end[0], position), keep(end[2], slope)
        value = jnp.where(accept, end[3], value)
        step_size = step_size * jnp.exp(adapting * 0.1 * (rate - _TARGET))
        return (position, value, slope, step_size), (position, value, rate)

    value, slope = value_and_slope(position)
    keys = jax.random.split(key, steps + 1)
    carry, (positions, values, rates) = jax.lax.scan(
        transition, (position, value, slope, step_size), keys[1:]
    )
    return carry[0], keys[0], carry[3], positions, values, rates.mean()


class _Static:
    """The hashable part of a partial log density: its function and static options."""

    def __init__(self, density):
        self.function = density.func
        self.options = ()

    def __hash__(self):
        return hash((self.function, self.options))

    def __eq__(self, other):
        return (self.function, self.options) == (other.function, other.options)


def hmc_chunk(density, state: dict, steps: int):
    """Advance every chain: (samples, log density, acceptance, state), as emcee's.

    The steps that adapt the step size come first and are not among the samples.
    """
    if state["adapting"]:
        state = _advanced(density, state, _ADAPTATION)[3]
    return _advanced(density, state, steps)


def _advanced(density, state: dict, steps: int):
    static = _Static(density)
    arrays = {
        k: v for k, v in density.keywords.items() if k not in dict(static.options)
    }
    ensembles, walkers = (int(value) for value in state["shape"])
    position, key, step_size, positions, values, rate = _scan(
        arrays, static, jnp.asarray(state["position"]),
        jax.random.wrap_key_data(jnp.asarray(state["key"])),
        jnp.asarray(state["step_size"]), jnp.asarray(state["adapting"]), steps,
    )  # fmt: skip
    shape = (steps, ensembles, walkers)
    samples = np.asarray(positions).reshape(*shape, -1).swapaxes(0, 1)
    log_density = np.asarray(values).reshape(shape).swapaxes(0, 1)
    after = {
        "position": np.asarray(position),
        "key": np.asarray(jax.random.key_data(key)),
        "step_size": np.asarray(step_size),
        "shape": state["shape"],
        "adapting": np.array(0.0),
    }
    return samples, log_density, float(rate), after
