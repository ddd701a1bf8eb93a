"""The No-U-Turn sampler of blackjax in the whitened space, every chain at once.

The only importer of blackjax. Hoffman and Gelman (Journal of Machine Learning Research
15, 2014): trajectories of adapted length, whose cost grows slowly with the number of
parameters, while that of an ensemble sampler grows fast. Step size and mass are
adapted in discarded steps, pooled over all chains, and are then fixed.
"""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from tirefit.fitting.uncertainty.importance import Density
from tirefit.params import Values

_MANY = 20
"""Parameters above which NUTS is the default. With 20 (10 runs of 300 rows) it takes 24
s of processor time, emcee 100 s; with 90 emcee did not finish in 600 s."""


_ACCEPTANCE = 0.8
_WARM_UP = 3
"""Chunks that are discarded: the step size is adapted in every one, the mass from the
second half of all but the last."""
_DOUBLINGS = 8
"""A trajectory has at most 2^8 steps, far more than a whitened posterior needs."""
_SHRINKAGE = 10.0
"""Weight, in draws, of a unit covariance in the mass: the chains may have too few."""


def sampler_of_chains(sampler: str | None, size: int) -> str:
    """The named sampler of chains, else the default for ``size`` parameters."""
    default = "nuts" if size > _MANY else "emcee"
    return sampler if sampler in ("emcee", "nuts") else default


def nuts_start(
    density: Density, size: int, ensembles: int, walkers: int, seed: int
) -> dict[str, np.ndarray]:
    """First state of ``ensembles x walkers`` independent chains."""
    key, first = jax.random.split(jax.random.key(seed))
    # Wider than the posterior, so that R-hat can see chains that disagree.
    position = 1.3 * np.asarray(jax.random.normal(first, (ensembles * walkers, size)))
    for _ in range(20):
        outside = ~np.isfinite(np.asarray(density(position)))
        position = np.where(outside[:, None], position / 2, position)
    return {
        "position": position,
        "key": np.asarray(jax.random.key_data(key)),
        "step_size": np.array(0.5),
        "covariance": np.eye(size),
        "shape": np.array([ensembles, walkers]),
        "stage": np.array(0),
        "divergences": np.array(0),
    }


def _arrays(density: Density) -> Density:
    """The density as a pytree of its arrays: one program serves every data set."""
    if not isinstance(density, partial):
        return density

    def array(leaf: Any) -> Any:
        return jnp.asarray(leaf) if isinstance(leaf, float | np.generic) else leaf

    arguments = jax.tree.map(array, (density.args, density.keywords))
    return jax.tree_util.Partial(density.func, *arguments[0], **arguments[1])


@eqx.filter_jit
def _scan(
    density: Density,
    position: Array,
    key: Array,
    step_size: Array,
    covariance: Array,
    adapt: Array,
    steps: int,
) -> tuple[Array, ...]:
    """(position, key, step size, positions, values, acceptance, divergences).

    ``adapt`` is an array: one program, costly to compile, for warm-up and sampling.
    """
    # Imported here, because it is slow to import and only NUTS needs it.
    from blackjax.adaptation.step_size import dual_averaging_adaptation
    from blackjax.mcmc import nuts

    kernel = nuts.build_kernel()
    begin, update, final = dual_averaging_adaptation(_ACCEPTANCE)

    def one(u: Array) -> Values:
        return density(u[None])[0]

    def step(key: Array, state: Any, size: Array) -> tuple[Any, Any]:
        return kernel(key, state, one, size, covariance, max_num_doublings=_DOUBLINGS)

    def transition(carry: tuple[Any, Any], key: Array) -> tuple[tuple[Any, Any], Any]:
        states, averaging = carry
        size = jnp.where(adapt, jnp.exp(averaging.log_step_size), step_size)
        keys = jax.random.split(key, len(position))
        states, info = jax.vmap(step, (0, 0, None))(keys, states, size)
        rate = jnp.mean(info.acceptance_rate)
        averaging = update(averaging, rate)
        drawn = states.position, states.logdensity, rate, info.is_divergent
        return (states, averaging), drawn

    states = jax.vmap(lambda u: nuts.init(u, one))(position)
    keys = jax.random.split(key, steps + 1)
    (states, averaging), (positions, values, rates, divergent) = jax.lax.scan(
        transition, (states, begin(step_size)), keys[1:]
    )
    size = jnp.where(adapt, final(averaging), step_size)
    return (states.position, keys[0], size, positions, values, rates.mean(), divergent.sum())


def _advanced(
    density: Density, state: dict[str, np.ndarray], steps: int, adapt: bool
) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, float]:
    """(state, positions (steps, chains, p), values (steps, chains), acceptance)."""
    position, key, size, positions, values, rate, divergences = _scan(
        _arrays(density),
        jnp.asarray(state["position"]),
        jax.random.wrap_key_data(jnp.asarray(state["key"])),
        jnp.asarray(state["step_size"]),
        jnp.asarray(state["covariance"]),
        jnp.asarray(adapt),
        steps,
    )
    after = state | {
        "position": np.asarray(position),
        "key": np.asarray(jax.random.key_data(key)),
        "step_size": np.asarray(size),
    }
    if not adapt:
        after["divergences"] = state["divergences"] + np.asarray(divergences)
    return after, np.asarray(positions), np.asarray(values), float(rate)


def _warmed_up(density: Density, state: dict[str, np.ndarray], steps: int) -> dict[str, np.ndarray]:
    """The state with step size and mass adapted to its chains; the steps are discarded."""
    while (stage := int(state["stage"])) < _WARM_UP:
        state, positions, _, _ = _advanced(density, state, steps, adapt=True)
        if stage < _WARM_UP - 1:
            flat = positions[steps // 2 :].reshape(-1, positions.shape[-1])
            share = len(flat) / (len(flat) + _SHRINKAGE)
            learned = share * np.atleast_2d(np.cov(flat.T))
            covariance = learned + (1 - share) * np.eye(len(learned))
            state = state | {"covariance": covariance}
        state = state | {"stage": np.array(stage + 1)}
    return state


def nuts_chunk(
    density: Density, state: dict[str, np.ndarray], steps: int
) -> tuple[np.ndarray, np.ndarray, float, dict[str, np.ndarray]]:
    """Advance every chain: (samples, log density, acceptance, state), as emcee's.

    The state counts the divergent transitions among the samples, without the warm-up.
    """
    state, positions, values, rate = _advanced(
        density, _warmed_up(density, state, steps), steps, adapt=False
    )
    ensembles, walkers = (int(value) for value in state["shape"])
    samples = positions.reshape(steps, ensembles, walkers, -1).swapaxes(0, 1)
    log_density = values.reshape(steps, ensembles, walkers).swapaxes(0, 1)
    return samples, log_density, rate, state
