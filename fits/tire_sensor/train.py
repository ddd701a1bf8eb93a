"""Trains the weights of ``tire-sensor``: ``python -m fits.tire_sensor.train``.

The network is trained on tirefit's brush (``Brush.pure``): friction uniform from 0.1 to
1.2; used friction uniform from 0.05 to 1 for a part of the points, the sliding share
uniform for the others, so that the slip angle is accurate near full sliding. SciPy's
L-BFGS uses all points at once, from fixed first weights, and is reproducible on one
machine.
"""

import json

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from scipy.optimize import minimize

from tirefit.models import Brush
from tirefit.online.tire_sensor import LEAST_FORCE, LEAST_FRICTION, MOST_FRICTION, WEIGHTS, network

WIDTHS = (2, 16, 16, 2)
STEPS = 3000


def training_points():
    """y, m, theta, used (n,) of tirefit's brush at unit load and length."""
    by_use = 1 - np.cbrt(1 - np.linspace(0.05, 1, 30))
    sliding = np.r_[by_use, np.linspace(by_use[0], 1, 40)]
    mu, sliding = np.meshgrid(np.linspace(LEAST_FRICTION, MOST_FRICTION, 45), sliding)
    mu, sliding = mu.ravel(), sliding.ravel()
    theta, used = mu * sliding, 1 - (1 - sliding) ** 3
    # theta = 2 c sigma / (3 F_z); with c = 1.5 and F_z = 1 it is the slip.
    force, moment = jax.vmap(lambda t, m: Brush(1.5, m).pure(t, 1.0, 0.0))(theta, mu)
    y, m = np.asarray(force), -np.asarray(moment)
    kept = y >= LEAST_FORCE
    return y[kept], m[kept], theta[kept], used[kept]


def train(steps: int = STEPS, seed: int = 0):
    """Layers (matrix, offsets), and their mean square error."""
    random = np.random.default_rng(seed)
    first = [
        (random.normal(size=(b, a)) / np.sqrt(a), np.zeros(b))
        for a, b in zip(WIDTHS[:-1], WIDTHS[1:], strict=True)
    ]
    flat, unravel = ravel_pytree(first)
    y, m, theta, used = map(jnp.asarray, training_points())

    @jax.jit
    @jax.value_and_grad
    def loss(x):
        weights = unravel(x)
        t, u = jax.vmap(lambda a, b: network(weights, a, b))(y, m)
        return jnp.mean((u - used) ** 2 + ((t - theta) / y) ** 2)

    done = minimize(
        lambda x: [np.asarray(part, float) for part in loss(x)],
        flat,
        jac=True,
        method="L-BFGS-B",
        options={"maxiter": steps, "maxfun": 2 * steps, "maxcor": 30},
    )
    return unravel(done.x), float(done.fun)


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    layers, error = train()
    rounded = [
        {"matrix": np.round(a, 5).tolist(), "offset": np.round(b, 5).tolist()} for a, b in layers
    ]
    WEIGHTS.write_text(json.dumps({"layers": rounded}) + "\n")
    print(f"root mean square error {error**0.5:.4f}")


if __name__ == "__main__":
    main()
