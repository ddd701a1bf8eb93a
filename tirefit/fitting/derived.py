"""Quantities that follow from the parameters, with their uncertainty."""

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.compiled import compiled
from tirefit.fitting.layout import Layout
from tirefit.models import TireInputs
from tirefit.params import with_values

__all__ = ["DERIVED", "derived_values", "reference_point"]

DERIVED = {
    "C_x": ("N", "slope of the force at zero slip, 2 c_p a^2 for a brush"),
    "F_max": ("N", "peak force at the reference load and speed"),
    "slip_at_peak": ("-", "slip at which the force peaks"),
    "F_max_over_fz": ("-", "peak force over load, mu'"),
    "mu_fz": ("N", "static friction times the reference load"),
}
"""Derived quantity -> (unit, meaning)."""

_LARGEST_SLIP = 3.0


def reference_point(problem) -> dict[str, float]:
    """Median load [N] and speed [m/s] of the fitted rows."""
    fz = problem.used(problem.rows.inputs.fz)
    v = problem.used(problem.rows.inputs.v)
    return {"fz": float(np.median(fz)), "v": float(np.median(v))}


def _curve(model, values, channel: str, slip_name: str, fz, v):
    tire = with_values(model, values)

    def force(slip):
        if slip_name == "alpha":
            slip = jnp.arctan(slip)
        inputs = TireInputs(fz=fz, v=v)._replace(**{slip_name: slip})
        return getattr(tire(inputs), channel)

    return force


def _peak(force):
    """(slip, force) of the first largest force, by three rounds of a refined grid."""
    grid = jnp.geomspace(1e-5, _LARGEST_SLIP, 200)
    for _ in range(4):
        values = jax.vmap(force)(grid)
        # The first point within rounding of the largest: a plateau begins there.
        first = jnp.argmax(values >= values.max() * (1 - 1e-12))
        slip, peak = grid[first], values[first]
        low = grid[jnp.maximum(first - 1, 0)]
        high = grid[jnp.minimum(first + 1, len(grid) - 1)]
        grid = jnp.linspace(low, high, 200)
    # A force that still rises at the largest slip has no peak.
    return jnp.where(slip < 0.999 * _LARGEST_SLIP, slip, jnp.nan), peak


@compiled(static=("layout", "channel", "slip_name", "run"))
def derived_values(model, layout: Layout, z, channel, slip_name, fz, v, run: int = 0):
    """Derived quantities of a batch of parameter vectors.

    Args:
        z: unconstrained parameters, shape (m, p).
        channel: fx or fy.
        slip_name: the slip that drives it.
        fz, v: reference load [N] and speed [m/s].
        run: the run whose parameters count where they are per run.

    Returns:
        dict of arrays (m,) by name of :data:`DERIVED`. ``slip_at_peak`` is sigma for
        the longitudinal, tan(alpha) for the lateral force.
    """

    def one(z):
        values = {
            name: value[run] if jnp.ndim(value) else value
            for name, value in layout.natural(z).items()
        }
        force = _curve(model, values, channel, slip_name, fz, v)
        slip, peak = _peak(force)
        found = {
            "C_x": jax.grad(force)(0.0),
            "F_max": peak,
            "slip_at_peak": slip,
            "F_max_over_fz": peak / fz,
        }
        mu = values.get("mu", getattr(model, "mu", None))
        if mu is not None:
            found["mu_fz"] = mu * fz
        return found

    return jax.lax.map(one, z, batch_size=64)
