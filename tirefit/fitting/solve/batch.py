"""Many fits of one model at once: least squares under vmap, in cache-sized batches."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tirefit.data.write import csv_text
from tirefit.display import Record
from tirefit.files import json_safe
from tirefit.fitting.problem.build import find_model, guess_from_curve
from tirefit.fitting.problem.layout import FreeParameter, Layout
from tirefit.fitting.solve.least_squares import least_squares
from tirefit.models import TireInputs
from tirefit.models.base import AbstractTire
from tirefit.params import Values, specs, with_values
from tirefit.precision import require_x64
from tirefit.results import DataError, Outcome, UsageError


@dataclass(frozen=True, repr=False)
class BatchFit(Record):
    """Estimates of B fits: values and standard deviations (B, p) by ``names``."""

    text_by: ClassVar[str] = "tirefit.report.records:batch_text"
    plot_by: ClassVar[str] = "tirefit.report.records:batch_figure"

    names: tuple[str, ...]
    values: np.ndarray
    std: np.ndarray
    converged: np.ndarray  # (B,) bool

    @property
    def limits(self) -> dict[Outcome, str]:
        """How many fits did not converge."""
        off = int(np.sum(~self.converged))
        message = f"{off} of {len(self.converged)} fits did not converge"
        return {Outcome.NOT_CONVERGED: message if off else ""}

    def columns(self) -> dict[str, np.ndarray]:
        """``fits.csv``: estimate and standard deviation of each parameter, by fit."""
        table = {"converged": self.converged.astype(int)}
        for name, value, std in zip(self.names, self.values.T, self.std.T, strict=True):
            table |= {name: value, f"{name}_std": std}
        return table

    def to_dict(self) -> dict[str, Any]:
        """The columns as lists."""
        return json_safe(self.columns())

    def files(self, name: str = "") -> dict[str, str]:
        """``fits.csv``."""
        return {"fits.csv": csv_text(self.columns())}


def fit_many(
    data: Mapping[str, Float[Values, "b n"] | float], model: str | None = None
) -> BatchFit:
    """Fit a model to B data sets of n points each, by least squares on the normal equations.

    Args:
        data: canonical columns, as :func:`tirefit.fit` takes them, each of shape (B, n)
            or a scalar: ``sigma_x`` [-] with ``fx`` [N], or ``alpha`` [rad] with ``fy``
            [N]; ``fz`` [N]; and ``v`` [m/s], 0 by default.
        model: a name of ``tirefit.MODELS``; ``brush`` if None.

    Returns:
        Estimates, with standard deviations from the covariance at the noise of the
        residuals (assumed independent and equal).

    Raises:
        UsageError: unknown model, or a transient one; or 32-bit floats in use.
        DataError: no slip with its force, no load, or shapes that do not match.

    Example:
        >>> slip = np.linspace(0, 0.1, 30) * np.ones((2, 1))
        >>> rows = {"sigma_x": slip[0], "fz": np.full(30, 4000.0)}
        >>> force = [predict("brush", rows, {"mu": mu})["fx"] for mu in (0.7, 0.9)]
        >>> many = fit_many({"sigma_x": slip, "fx": np.stack(force), "fz": 4000.0})
        >>> many.values[:, many.names.index("mu")].round(3)
        array([0.7, 0.9])
    """
    require_x64("fit_many")
    template = find_model(model or "brush")
    if template.transient:
        reason = f"{model} follows the slip through time, which fit_many does not have"
        raise UsageError(reason, "fit each data set by tirefit.fit")
    axis = "fy" if "fy" in data and "alpha" in data else "fx"
    slip_name = "alpha" if axis == "fy" else "sigma_x"
    missing = [name for name in (slip_name, axis, "fz") if name not in data]
    if missing:
        raise DataError(f"no {' and no '.join(missing)}", "give it as an array (B, n)")
    slip, force = jnp.asarray(data[slip_name], float), jnp.asarray(data[axis], float)
    if slip.ndim != 2 or slip.shape != force.shape:
        reason = f"{slip_name} {slip.shape} and {axis} {force.shape} must both be (B, n)"
        raise DataError(reason, "give arrays of one shape, a row for each data set")
    layout = Layout(tuple(FreeParameter(k, s) for k, s in specs(template).items() if s.free))
    fz, v = (
        jnp.broadcast_to(jnp.asarray(x, float), slip.shape)
        for x in (data["fz"], data.get("v", 0.0))
    )
    values, std, converged = _solve_all(template, layout, slip, force, fz, v, axis)
    return BatchFit(layout.labels, np.asarray(values), np.asarray(std), np.asarray(converged))


@partial(jax.jit, static_argnames=("layout", "axis"))
def _solve_all(
    template: AbstractTire,
    layout: Layout,
    slip: Array,
    force: Array,
    fz: Array,
    v: Array,
    axis: str,
) -> tuple[Array, Array, Array]:
    def solve_one(data: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array]:
        slip, force, fz, v = data
        slip_name = "sigma_x" if axis == "fx" else "alpha"

        def residual(z: Array) -> tuple[Array, None]:
            tire = with_values(template, layout.natural(z))

            def at(slip: Array, fz: Array, v: Array) -> Array:
                inputs = TireInputs(fz=fz, v=v)._replace(**{slip_name: slip})
                return getattr(tire(inputs), axis)

            return (force - jax.vmap(at)(slip, fz, v)) / jnp.mean(fz), None

        # Slope of the smaller slips and the largest force, in terms of the parameters.
        small = jnp.abs(slip) <= 0.2 * jnp.max(jnp.abs(slip))
        stiffness = jnp.sum(small * slip * force) / jnp.sum(small * slip**2)
        curve = guess_from_curve(stiffness, jnp.max(jnp.abs(force) / fz), jnp.mean(fz))
        guess = {p.name: jnp.asarray(p.spec.default, float) for p in layout.free}
        guess |= {name: value for name, value in curve.items() if name in guess}
        end = least_squares(residual, jnp.asarray(layout.unconstrained(guess)))
        noise = end.cost / (slip.size - layout.size)
        slope = jax.jacfwd(layout.vector)(end.z)
        cov = slope @ jnp.linalg.inv(end.normal) @ slope.T * noise
        return layout.vector(end.z), jnp.sqrt(jnp.diagonal(cov)), end.converged

    return jax.lax.map(solve_one, (slip, force, fz, v), batch_size=64)
