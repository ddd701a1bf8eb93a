r"""What the surprises of the last seconds say about a method's stated uncertainty.

A method states the standard deviation of its next prediction; the surprise is the error over it.
If the model misses something, surprises are larger than one and follow each other. With their
mean square :math:`s^2` and the correlation :math:`\rho` of one with the next, the sum of many
has :math:`s^2 (1 + \rho) / (1 - \rho)` times the variance of independent ones of size one,
and so has the estimate, which is such a sum. The window forgets after ten seconds, or fifty
surprises if these take longer.

The numbers were chosen on logs of `fits/friction_benchmark`, mainly on one (f1tenth, tires a); no
other measured log has judged them.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from tirefit.online.base import AbstractEstimator, Estimate, Flag, code, flag_of

_SECONDS, _STEPS = 10.0, 50.0
"""Memory of the window: the longer one of this time [s] and this number of surprises."""
_ENOUGH = 10.0
"""Independent surprises that a window needs: their rms is then known to a fifth."""
_LARGEST = 20.0  # limit of one surprise, so that a spike does not fill the window
_CORRELATED = 0.98  # largest correlation that a window of some hundred surprises shows
MODEL = 0.05
"""Error of a tire model in mu that no surprise shows, relative: batch fits of one run each
differ by 3 to 6 % on the f1tenth and DART cars."""
_MOVES = 0.2
"""Standard deviation of mu within the window, relative, above which it has not settled."""


class Window(NamedTuple):
    """Weighted sums over the recent steps, and the values of the last one."""

    squares: Float[Array, ""]  # of the surprises
    products: Float[Array, ""]  # of each with the one before
    weight: Float[Array, ""]  # number of surprises
    last: Float[Array, ""]  # surprise, 0 before the first
    waited: Float[Array, ""]  # [s] since it
    mean: Float[Array, ""]  # of mu
    spread: Float[Array, ""]  # squared deviations of mu from its mean
    steps: Float[Array, ""]  # number of values of mu

    @property
    def rms(self):
        """Root mean square of the surprises [-]; one more, of size one, is assumed."""
        return jnp.sqrt((self.squares + 1) / (self.weight + 1))

    @property
    def dependence(self):
        """Variance of the sum of the surprises over that of independent ones [-]."""
        rho = jnp.clip(self.products / (self.squares + 1), 0.0, _CORRELATED)
        return (1 + rho) / (1 - rho)

    def waiting(self, dt) -> "Window":
        """The window ``dt`` [s] later."""
        return self._replace(waited=self.waited + dt)

    def after(self, surprise, mu) -> "Window":
        """The window after a step; a surprise or friction of NaN is left out."""
        there, known = jnp.isfinite(surprise), jnp.isfinite(mu)
        z = jnp.clip(jnp.where(there, surprise, 0.0), -_LARGEST, _LARGEST)
        faded = jnp.exp(-self.waited / _SECONDS)
        keep = jnp.where(there, jnp.maximum(faded, 1 - 1 / _STEPS), 1.0)
        steps = jnp.where(known, keep * self.steps + 1, self.steps)
        off = jnp.where(known, mu - self.mean, 0.0)
        return Window(
            squares=keep * self.squares + z * z,
            products=keep * self.products + z * self.last,
            weight=keep * self.weight + there,
            last=jnp.where(there, z, self.last),
            waited=jnp.where(there, 0.0, self.waited),
            mean=self.mean + off / jnp.maximum(steps, 1.0),
            spread=keep * self.spread + off * off,
            steps=steps,
        )


def first_window() -> Window:
    """The window before the first step."""
    return Window(*[jnp.zeros(())] * len(Window._fields))


def judged(estimator: AbstractEstimator, window: Window, estimate: Estimate) -> Estimate:
    """The estimate with standard deviations that include what the model misses.

    All of them are multiplied by the root of :math:`s^2 (1 + \\rho) / (1 - \\rho)`, if that
    is above one; that of mu also includes the error of a tire model. Flags: mu is not known to
    ``resolved``; or it is, but from too few independent surprises, or it still moves.
    """
    if not estimator.resolved:
        return estimate
    names, std = estimator.method.parameters, jnp.asarray(estimate.std)
    few = moves = jnp.zeros((), bool)
    if estimator.widened:
        std = jnp.maximum(window.rms * jnp.sqrt(window.dependence), 1.0) * std
        few = (window.weight > 0) & (window.weight < _ENOUGH * window.dependence)
    flag = flag_of((few, Flag.SETTLING))
    if "mu" in names:
        k = names.index("mu")
        mu = estimate.value[k]
        if estimator.widened:
            std = std.at[k].set(jnp.hypot(std[k], MODEL * mu))
            moves = jnp.sqrt(window.spread / jnp.maximum(window.steps, 1.0)) > _MOVES * mu
        settling = flag_of((few | moves, Flag.SETTLING))
        flag = jnp.where(std[k] < estimator.resolved * mu, settling, code(Flag.LOW_USE))
    return estimate._replace(std=std, flag=jnp.maximum(estimate.flag, flag))


def mu_of(estimator: AbstractEstimator, estimate: Estimate):
    """The friction of an estimate; NaN if the method has none."""
    names = estimator.method.parameters
    return estimate.value[names.index("mu")] if "mu" in names else jnp.full((), jnp.nan)
