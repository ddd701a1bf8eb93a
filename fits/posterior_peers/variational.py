"""Stochastic variational inference by NumPyro: ``pip install`` the group ``peers``.

The model is written as usual in NumPyro, with a site for each parameter and one for the
forces; bounds, prior, noise, rows and starting point are those of tirefit's fit.
``mean-field`` is ``AutoNormal``, ``full-rank`` is
``AutoMultivariateNormal``: a Gaussian in NumPyro's unconstrained coordinates, without
and with correlations.
"""

from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jax.flatten_util import ravel_pytree
from numpyro.distributions import biject_to
from numpyro.infer import SVI, Trace_ELBO, init_to_value
from numpyro.infer.autoguide import AutoMultivariateNormal, AutoNormal
from numpyro.optim import Adam

from tirefit.fitting.problem.likelihood import FitProblem
from tirefit.fitting.result import FitResult
from tirefit.models import TireInputs
from tirefit.params import Spec, with_values

__all__ = ["GUIDES", "Fitted", "Given", "given", "log_joint", "tire_model", "vary"]

GUIDES = {"mean-field": AutoNormal, "full-rank": AutoMultivariateNormal}

FIRST_RATE, LAST_RATE = 0.02, 1e-5
"""First and last rate of Adam, with exponential decay: at a constant rate a Gaussian with a
width of 0.01 would fluctuate by more than its width."""

WIDTH = 0.01
"""First width of a guide. From NumPyro's default of 0.1 the same ELBO needs about four times
as many steps: these posteriors are about 0.003 to 0.1 wide in its coordinates."""

STEPS = {"mean-field": 20_000, "full-rank": 50_000}
"""Steps after which three times as many raise the ELBO by less than 0.1."""


class Given(NamedTuple):
    """The data of a fit of tirefit: rows (n,), and a first value by parameter."""

    slip: jax.Array
    fz: jax.Array
    force: jax.Array
    noise: jax.Array
    first: dict[str, jax.Array]


def given(problem: FitProblem, first: Mapping[str, float]) -> Given:
    """Rows and noise of a fit of F_x with known slip, and first values.

    The noise is that of the fit's intervals: multiplied by the square root of the number
    of rows that count as one.
    """
    rows, inflation = problem.rows, problem.rules["fx"].inflation
    noise = rows.scale["fx"] * jnp.sqrt(inflation)
    parts = rows.inputs.sigma_x, rows.inputs.fz, rows.observed["fx"], noise
    used = [jnp.asarray(problem.used(part)) for part in parts]
    return Given(*used, {name: jnp.asarray(value) for name, value in first.items()})


def tire_model(problem: FitProblem, data: Given) -> None:
    """The tire as a NumPyro model: flat priors in tirefit's bounds, Gaussian noise."""
    values = {
        parameter.name: numpyro.sample(
            parameter.name, dist.Uniform(parameter.spec.lower, parameter.spec.upper)
        )
        for parameter in problem.layout.free
    }
    tire = with_values(problem.model, values)
    force = jax.vmap(lambda slip, fz: tire(TireInputs(slip, 0.0, fz)).fx)(data.slip, data.fz)
    numpyro.sample("fx", dist.Normal(force, data.noise), obs=data.force)


def log_joint(problem: FitProblem, data: Given, values: dict) -> jax.Array:
    """log prior + log likelihood of NumPyro's model at natural values."""
    density, _ = numpyro.infer.util.log_density(tire_model, (problem, data), {}, values)
    return density


class Fitted(NamedTuple):
    """A Gaussian of q parameters for each of B data sets: mean (B, q), covariance
    (B, q, q) in NumPyro's coordinates, in alphabetical order; the ELBO (B,)."""

    mean: np.ndarray
    covariance: np.ndarray
    elbo: np.ndarray


def _gaussian(name: str, parameters: dict) -> tuple[jax.Array, jax.Array]:
    """Mean and covariance of a guide with these parameters."""
    if name == "full-rank":
        root = parameters["auto_scale_tril"]
        return parameters["auto_loc"], root @ root.T

    def gathered(suffix):
        ends = {k: v for k, v in parameters.items() if k.endswith(suffix)}
        return ravel_pytree(dict(sorted(ends.items())))[0]

    return gathered("_auto_loc"), jnp.diag(gathered("_auto_scale") ** 2)


def _starting(name: str, first: dict, specs: dict[str, Spec]) -> dict:
    """The start of the guide: the optimum of least squares."""
    there = {
        k: biject_to(dist.Uniform(specs[k].lower, specs[k].upper).support).inv(v)
        for k, v in first.items()
    }
    if name == "full-rank":
        return {"auto_loc": ravel_pytree(dict(sorted(there.items())))[0]}
    return {f"{k}_auto_loc": v for k, v in there.items()}


@partial(jax.jit, static_argnames=("name", "steps", "particles"))
def _run(problem, batch: Given, name: str, steps: int, seed, particles: int = 2000):
    """Gaussian and ELBO of each data set of a batch, vectorized."""
    rate = jnp.log(LAST_RATE / FIRST_RATE) / steps
    optimizer = Adam(lambda step: FIRST_RATE * jnp.exp(rate * step))
    one = jax.tree.map(lambda part: part[0], batch)
    specs = {parameter.name: parameter.spec for parameter in problem.layout.free}
    model = partial(tire_model, problem)
    guide = GUIDES[name](model, init_loc_fn=init_to_value(values=one.first), init_scale=WIDTH)
    svi = SVI(model, guide, optimizer, Trace_ELBO())
    key = jax.random.key(seed)
    own = svi.get_params(svi.init(key, one))

    def fitted(data, key):
        begin, draw, end = jax.random.split(key, 3)
        state = svi.init(begin, data, init_params=own | _starting(name, data.first, specs))
        state = state._replace(rng_key=draw)
        state, _ = jax.lax.scan(
            lambda state, _: (svi.update(state, data)[0], None), state, None, steps
        )
        parameters = svi.get_params(state)
        loss = Trace_ELBO(particles).loss(end, parameters, model, guide, data)
        return *_gaussian(name, parameters), -loss

    keys = jax.random.split(key, len(batch.force))
    return Fitted(*jax.vmap(fitted)(batch, keys))


def vary(
    results: list[FitResult], name: str, steps: int | None = None, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """The guide ``name`` for each fit of one model: natural intervals and ELBO.

    Returns:
        central 95 % intervals (B, p, 2) in the order of the fits' labels, and the ELBO
        (B,).
    """
    each = [
        given(result.problem, {k: v.value for k, v in result.least_squares.items()})
        for result in results
    ]
    batch = jax.tree.map(lambda *parts: jnp.stack(parts), *each)
    problem = results[0].problem
    fitted = _run(problem, batch, name, steps or STEPS[name], seed)
    fitted = jax.tree.map(np.asarray, fitted)
    intervals = np.empty((*fitted.mean.shape, 2))
    alphabetical = sorted(p.name for p in problem.layout.free)
    for i, parameter in enumerate(problem.layout.free):
        k, spec = alphabetical.index(parameter.name), parameter.spec
        std = np.sqrt(fitted.covariance[:, k, k])
        ends = fitted.mean[:, k, None] + std[:, None] * np.array([-1.959964, 1.959964])
        bounded = biject_to(dist.Uniform(spec.lower, spec.upper).support)
        intervals[:, i] = np.asarray(bounded(jnp.asarray(ends)))
    return intervals, fitted.elbo
