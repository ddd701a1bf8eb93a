"""Which parameters a fit estimates, and how a vector of real numbers names them all.

A parameter is free (shared by all runs, or one per run), fixed at a value, or tied to
another one. The solver and the samplers see one unconstrained vector z; ``natural``
turns it into named values within their bounds.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.params import Spec, constrain, log_jacobian, unconstrain

__all__ = ["FreeParameter", "Layout", "Tie"]


@dataclass(frozen=True)
class FreeParameter:
    """A parameter to estimate: one value, or one per run where ``per_run``."""

    name: str
    spec: Spec
    per_run: bool = False
    prior: tuple[float, float] | None = None
    """Mean and standard deviation of a Gaussian prior; None is flat in the bounds."""


@dataclass(frozen=True)
class Tie:
    """``name = factor * other``."""

    name: str
    other: str
    factor: float = 1.0


@dataclass(frozen=True)
class Layout:
    """The free parameters in order, the ties, and the runs of the data."""

    free: tuple[FreeParameter, ...]
    ties: tuple[Tie, ...] = ()
    runs: tuple[str, ...] = field(default=("run",), compare=False, repr=False)
    """Not compared: the names of the runs would compile a fit of every file anew."""

    @property
    def labels(self) -> tuple[str, ...]:
        """One label per element of z: ``mu``, or ``mu[run]`` where it is per run."""
        return tuple(label for label, _ in self.elements)

    @property
    def elements(self) -> tuple[tuple[str, FreeParameter], ...]:
        """(label, parameter) of every element of z, in order."""
        found = []
        for parameter in self.free:
            if parameter.per_run:
                found += [(f"{parameter.name}[{run}]", parameter) for run in self.runs]
            else:
                found.append((parameter.name, parameter))
        return tuple(found)

    @property
    def size(self) -> int:
        """Length of z."""
        return len(self.elements)

    def natural(self, z) -> dict:
        """Named values: shape () where shared, (runs,) where per run; ties resolved."""
        values, start = {}, 0
        for parameter in self.free:
            count = len(self.runs) if parameter.per_run else 1
            part = constrain(z[start : start + count], parameter.spec)
            values[parameter.name] = part if parameter.per_run else part[0]
            start += count
        for tie in self.ties:
            values[tie.name] = tie.factor * values[tie.other]
        return values

    def vector(self, z):
        """Natural value of every element of z, shape (size,)."""
        library = jnp if isinstance(z, jax.Array) else np
        values = [constrain(z[i], p.spec) for i, (_, p) in enumerate(self.elements)]
        return library.stack(values)

    def unconstrained(self, values: Mapping[str, float]):
        """z of the given natural values, by parameter name or by label."""
        found = [
            unconstrain(values[label if label in values else p.name], p.spec)
            for label, p in self.elements
        ]
        traced = any(isinstance(value, jax.Array) for value in found)
        return jnp.stack(found) if traced else np.array(found, float)

    def log_volume(self, z):
        """log |d natural / d z|: the prior flat in the bounds, in coordinates z."""
        return sum(log_jacobian(z[i], p.spec) for i, (_, p) in enumerate(self.elements))

    def prior_residual(self, z):
        """Gaussian priors as pseudo-measurements, shape (number of priors,)."""
        pulls = [
            (constrain(z[i], p.spec) - p.prior[0]) / p.prior[1]
            for i, (_, p) in enumerate(self.elements)
            if p.prior is not None
        ]
        return jnp.stack(pulls) if pulls else jnp.zeros(0)
