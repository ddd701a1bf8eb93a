r"""Reported standard deviations: what a method states, and what its estimates show.

A method's own standard deviation follows from the noise that it assumes. If its model misses
something, its estimates of mu wander by more. The reported variance of mu is

.. math:: s^2 = s_{own}^2 + s_{20}^2 + (0.05 \mu)^2

with :math:`s_{20}` the scatter of the estimates of the last 20 s about their mean, each weighted by
:math:`1/(1 + (s_{own} / 0.15 \mu)^2)`, so that estimates without information count little; a
detected change starts a new mean. Alarms, detection of changes and flags use :math:`s_{own}`.

The form and the 20 s were chosen on the measured logs of `fits/friction_benchmark`; 10 or 40 s
serve the f1tenth logs as well.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool

from tirefit.arrays import Number
from tirefit.online.base import RESOLVED, AbstractEstimator, Estimate, Flag, code

MODEL = 0.05
"""Error of a tire model in mu that no log shows by itself, relative: batch fits of one run each
differ by 3 to 6 % on the f1tenth and DART cars."""


class Scatter(NamedTuple):
    """Recent estimates of mu, weighted by time, age and their own standard deviation."""

    mean: Number | float = 0.0  # [-] since the last detected change
    square: Number | float = 0.0  # sum of squared deviations from the mean of their time
    weight: Number | float = 0.0  # sum of the weights of all
    level: Number | float = 0.0  # sum of the weights since the last change

    @property
    def variance(self) -> Number:
        """Weighted mean square deviation [-] of the recent estimates; 0 before the first."""
        return self.square / jnp.where(self.weight > 0, self.weight, 1.0)

    def after(self, mu: Array, std: Array, dt: Array) -> "Scatter":
        """The scatter with an estimate that holds for ``dt`` [s], and its own std."""
        new = dt / (1 + (std / (RESOLVED * mu)) ** 2)
        new = jnp.where(jnp.isfinite(new) & jnp.isfinite(mu), new, 0.0)
        keep = jnp.exp(-dt / 20.0)  # memory of the scatter [s]
        weight, level = keep * self.weight + new, keep * self.level + new
        off = jnp.where(new > 0, mu - self.mean, 0.0)
        step = new / jnp.where(level > 0, level, 1.0) * off
        square = keep * self.square + new * off * (off - step)
        return Scatter(self.mean + step, square, weight, level)


def reported(
    estimator: AbstractEstimator,
    scatter: Scatter,
    estimate: Estimate,
    dt: Number,
    changed: Bool[Array, ""],
) -> tuple[Scatter, Estimate]:
    """The scatter after a row, and the estimate with the reported standard deviation of mu.

    ``own_std`` keeps the standard deviations of the method, by which a row is flagged if mu is not
    resolved.

    Args:
        scatter: before the row.
        dt: time [s] for which the estimate holds; 0 if the sample cannot be used.
        changed: whether a new mean starts with the row.
    """
    names, method_std = estimator.method.parameters, jnp.asarray(estimate.std)
    if "mu" not in names:
        return scatter, estimate._replace(own_std=method_std)
    k = names.index("mu")
    mu, flag = estimate.value[k], estimate.flag
    level = jnp.where(changed, 0.0, scatter.level)
    scatter = scatter._replace(level=level).after(mu, method_std[k], dt)
    wide = jnp.sqrt(method_std[k] ** 2 + scatter.variance + (MODEL * mu) ** 2)
    if estimator.judged:
        flag = jnp.where(method_std[k] < RESOLVED * mu, flag, jnp.maximum(flag, code(Flag.LOW_USE)))
    return scatter, estimate._replace(std=method_std.at[k].set(wide), own_std=method_std, flag=flag)
