r"""A pressure density given as a table, or as a function that is sampled into one.

Between its points the density is linear in :math:`u = 1 + \xi`. Its integrals are then
polynomials, and the bristle that breaks away is the crossing of two straight lines.
"""

from collections.abc import Callable, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from tirefit.arrays import Numbers
from tirefit.models.pressure import AbstractPressure
from tirefit.results import InputProblem, UsageError

_POINTS = 4001
"""Samples of a function, evenly spaced in the angle of xi = -cos(angle): chords miss the
integrals of the parabolic and the elliptic density by less than 1e-6 of the load."""
_BEND = 0.01  # largest distance of a function from a chord, over its maximum
_JUMP = 1e-9
"""Distance in xi before and behind a kink at which a function is sampled as well, as its value
may jump there; the ends of a table may miss -1 and 1 by as much."""

Points = Float[Array | np.ndarray, " n"]


class Tabulated(AbstractPressure):
    """A numerical pressure law, made by :meth:`from_function` or :meth:`from_table`.

    A brush with it becomes a model to fit under a name of your choice::

        xi, density = np.loadtxt("patch.csv", delimiter=",", skiprows=1, unpack=True)
        law = Tabulated.from_table(xi, density)
        tirefit.MODELS["mine"] = Brush(pressure=law)
        tirefit.fit(data, "mine")

    ``at`` (n,): u of the points; ``value`` and ``slope`` of the density behind each;
    ``load`` and ``lever``: :meth:`cdf` and :meth:`moment` there; ``ratios``: the demand
    ratio at which the bristle there breaks away. None is a parameter.
    """

    at: Points
    value: Points
    slope: Points
    load: Points
    lever: Points
    ratios: Points

    @classmethod
    def from_function(
        cls, density: Callable[[np.ndarray], np.ndarray], kinks: Sequence[float] | np.ndarray = ()
    ) -> "Tabulated":
        """The law of a density over xi = x/a, +1 the leading edge.

        Args:
            density: NumPy function of an array of xi in [-1, 1]; any positive scale.
            kinks: xi at which its slope or value jumps.

        Raises:
            UsageError: the density is negative, not finite or nowhere positive, or it varies
                too fast for a table; or one breakaway point does not describe its patch.
        """
        kinks = np.asarray(kinks, float)
        even = -np.cos(np.linspace(0, np.pi, _POINTS))
        # A kink at an end of the patch has no side beyond it.
        sides = np.maximum(kinks - _JUMP, -1), np.minimum(kinks + _JUMP, 1)
        xi = np.unique(np.concatenate([even, kinks, *sides]))
        value, between = (
            np.broadcast_to(np.asarray(density(x), float), x.shape)
            for x in (xi, (xi[1:] + xi[:-1]) / 2)
        )
        bend = np.abs(between - (value[1:] + value[:-1]) / 2)
        if bend.max() > _BEND * np.abs(value).max():
            reason = f"the pressure density jumps or bends near xi = {xi[bend.argmax()]:.4g}"
            raise UsageError(reason, "name the place as one of the kinks, or give a table")
        return cls.from_table(xi, value)

    @classmethod
    def from_table(cls, xi: ArrayLike, density: ArrayLike) -> "Tabulated":
        """The law of a density that is linear between points, (n,) each.

        Args:
            xi: x/a from -1, the trailing edge, to 1, the leading edge; increasing.
            density: pressure there, any positive scale.

        Raises:
            UsageError: as :meth:`from_function`; points not rising from -1 to 1.
        """
        xi, density = np.asarray(xi, float), np.asarray(density, float)
        if xi.ndim != 1 or xi.shape != density.shape or len(xi) < 2:
            reason = f"xi {xi.shape} and density {density.shape} are not two columns"
            raise UsageError(reason, "give two columns of at least two rows")
        ends = np.zeros(len(xi), bool)
        ends[[0, -1]] = abs(xi[0] + 1) > _JUMP, abs(xi[-1] - 1) > _JUMP
        rows = (
            (~np.isfinite(xi + density), "xi or density is not a finite number", "give one"),
            (density < 0, "the pressure density is negative", "a pressure is >= 0"),
            (np.diff(xi, prepend=-np.inf) <= 0, "xi does not increase", "order the rows"),
            (ends, "xi does not go from -1 to 1", "divide x by the contact half-length"),
        )
        problems = []
        for wrong, reason, remedy in rows:
            if wrong.any():
                k = int(wrong.argmax())
                where = f"{reason} at xi = {xi[k]:.4g} (point {k})"
                problems.append(InputProblem(where, remedy))
        UsageError.raise_for(problems)
        return cls._of(1 + xi, density)

    @classmethod
    def _of(cls, u: np.ndarray, value: np.ndarray) -> "Tabulated":
        """The law of checked points."""
        step, slope = np.diff(u), np.diff(value) / np.diff(u)
        load = np.append(0.0, np.cumsum(step * (value[1:] + value[:-1]) / 2))
        lever = step * (value[:-1] * (u[:-1] - 1) + value[1:] * (u[1:] - 1)) / 2
        lever = np.append(0.0, np.cumsum(lever - slope * step**3 / 6))
        if not load[-1] > 0:
            reason = "the pressure density is nowhere positive"
            raise UsageError(reason, "give one that carries a load")
        # The limit at the leading edge, where no bristle is deflected.
        last = np.inf if value[-1] > 0 else -slope[-1]
        ratios = np.append(value[:-1] / (2 - u[:-1]), last)
        best = np.maximum.accumulate(ratios)
        # Rounding errors of the density matter if the demand is small.
        rounding = 1e-14 * value.max() / np.maximum(2 - u, step[-1])
        falls = ratios < (1 - 1e-9) * best - rounding
        if falls.any():
            raise UsageError(
                f"the pressure density over (1 - xi) falls at xi = {u[falls][0] - 1:.4g}: bristles"
                " nearer to the leading edge slide first, and one breakaway point"
                " does not describe the patch (as for d < -1/3 in S(24))",
                "let the density fall less early or less steeply towards xi = 1",
            )
        scaled = (x / load[-1] for x in (value, np.append(slope, 0.0), load, lever, best))
        return cls(u, *scaled)

    def _behind(self, known: Points, x: Numbers) -> tuple[list[Array], Array]:
        """``at``, ``value`` and ``slope`` of the last point that is not beyond x, and its index.

        Args:
            known: column (n,) of the points, increasing, with which x (...) is compared.
        """
        k = jnp.searchsorted(jnp.asarray(known), x, side="right") - 1
        k = jnp.clip(k, 0, len(known) - 2)
        return [jnp.asarray(part)[k] for part in (self.at, self.value, self.slope)], k

    def density(self, u: Numbers) -> Array:
        (at, value, slope), _ = self._behind(self.at, u)
        return value + slope * (u - at)

    def cdf(self, u: Numbers) -> Array:
        (at, value, slope), k = self._behind(self.at, u)
        t = u - at
        return jnp.asarray(self.load)[k] + t * (value + t * slope / 2)

    def moment(self, u: Numbers) -> Array:
        (at, value, slope), k = self._behind(self.at, u)
        t = u - at
        of_value = t * ((at - 1) + t / 2) * value
        return jnp.asarray(self.lever)[k] + of_value + t**2 * ((at - 1) / 2 + t / 3) * slope

    def breakaway(self, rho: Numbers) -> Array:
        ratios = jnp.asarray(self.ratios)
        sliding, partly = rho >= ratios[-1], (rho > ratios[0]) & (rho < ratios[-1])
        (at, value, slope), _ = self._behind(ratios, rho)
        ahead = (rho * (2 - at) - value) / jnp.where(partly, slope + rho, 1.0)
        return jnp.where(partly, at + ahead, jnp.where(sliding, 2.0, 0.0))
