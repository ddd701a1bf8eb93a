r"""Friction laws: kinetic and static coefficient as functions of sliding speed.

A law computes the coefficient of sliding bristles, :math:`\mu_k(v_s)`, from the static
friction :math:`\mu` of the brush. Laws are applied in sequence (``Friction``), each to the
result of the previous one. A law with ``static_too`` also lowers the static friction;
that hardly changes the force (S §4.2) but removes the hook before full sliding.
"""

import abc
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from tirefit.arrays import Numbers, Scalar
from tirefit.params import par


class AbstractFrictionLaw(eqx.Module):
    """A law of the kinetic friction; with ``static_too``, also of the static one."""

    static_too: bool = eqx.field(static=True, default=False, kw_only=True)

    @abc.abstractmethod
    def apply(self, level: Numbers, v_s: Numbers) -> Numbers:
        """Coefficient [-] at sliding speed v_s [m/s] >= 0, from the level at rest."""


class Kinetic(AbstractFrictionLaw):
    r""":math:`\mu_k = m \mu_s`, the constant friction of S(31)."""

    m: float = par(0.9, (0.0, 1.0), "-", "kinetic over static friction, mu_k / mu_s", "S(31)", "m")

    def apply(self, level: Numbers, v_s: Numbers) -> Numbers:
        return self.m * level


class LinearInSpeed(AbstractFrictionLaw):
    r""":math:`\mu_k = \mu_0 - n v_s`, S(35); needs n max(v_s) < mu_0."""

    n: float = par(0.005, (-0.2, 0.2), "s/m", "loss of friction per sliding speed", "S(35)", "n")

    def apply(self, level: Numbers, v_s: Numbers) -> Numbers:
        return level - self.n * v_s


class Logarithmic(AbstractFrictionLaw):
    r""":math:`\mu_k = \mu_1 (1 + g \ln((v_s + v_0) / 1\,m/s))`, :math:`v_0` = 0.02 m/s.

    Rubber grips more, the faster it slides, up to some m/s (Grosch 1963): measured on 1:10 cars.
    The brush's mu is that at 1 m/s.
    """

    g: float = par(
        0.1, (-0.2, 0.25), "-", "relative change of friction per e-fold of sliding speed",
        "Grosch 1963", "g",
    )  # fmt: skip

    def apply(self, level: Numbers, v_s: Numbers) -> Numbers:
        return level * (1 + self.g * jnp.log(v_s + _AT_REST))


_AT_REST = 0.02
"""Speed v_0 [m/s] added to the sliding speed: the logarithm is finite, and friction is positive at
rest for every g within its bounds."""


def _decay(v_s: Numbers, v_st: Scalar, exponent: Scalar) -> Array:
    """exp(-(v_s / v_st)^exponent) with a finite (zero) slope at rest."""
    moving = v_s > 0
    ratio = jnp.where(moving, v_s, v_st) / v_st
    return jnp.where(moving, jnp.exp(-(ratio**exponent)), 1.0)


def falling_speed(default: float = 30.0, free: bool = True, source: str = "S(36)-(37)") -> Any:
    """Field of the speed v_st of a fall of the friction."""
    meaning = "sliding speed over which friction falls"
    return par(default, (0.1, 1000.0), "m/s", meaning, source, "v_{st}", free=free, scale="log")


def falling_exponent(free: bool = True, source: str = "S(36)-(37)") -> Any:
    """Field of the exponent of that fall."""
    meaning = "exponent of the friction's fall with sliding speed"
    return par(0.5, (0.1, 3.0), "-", meaning, source, r"\varepsilon", free=free)


class Exponential(AbstractFrictionLaw):
    r""":math:`\mu_k = \mu (h + (1-h) e^{-(v_s/v_{st})^\varepsilon})`, S(37)."""

    h: float = par(
        0.5, (0.0, 1.0), "-", "friction at high sliding speed over that at rest", "S(37)", "h"
    )
    v_st: float = falling_speed(free=False)
    exponent: float = falling_exponent(free=False)

    def apply(self, level: Numbers, v_s: Numbers) -> Numbers:
        decay = _decay(v_s, self.v_st, self.exponent)
        return level * (self.h + (1 - self.h) * decay)


class Stribeck(AbstractFrictionLaw):
    r""":math:`\mu_k = \mu_c + (\mu_s - \mu_c) e^{-(v_s/v_{st})^\varepsilon}`, S(36)."""

    mu_c: float = par(0.6, (0.01, 5.0), "-", "friction at high sliding speed", "S(36)", r"\mu_c")
    v_st: float = falling_speed()
    exponent: float = falling_exponent()

    def apply(self, level: Numbers, v_s: Numbers) -> Numbers:
        decay = _decay(v_s, self.v_st, self.exponent)
        return self.mu_c + (level - self.mu_c) * decay


class Friction(eqx.Module):
    """Laws in sequence; without any, the constant friction of S(12)."""

    laws: tuple[AbstractFrictionLaw, ...] = ()

    def kinetic(self, mu: Numbers, v_s: Numbers) -> Numbers:
        """Coefficient of the sliding bristles [-] at sliding speed v_s [m/s]."""
        for law in self.laws:
            mu = law.apply(mu, v_s)
        return mu

    def static(self, mu: Numbers, v_s: Numbers) -> Numbers:
        """Static friction coefficient [-], up to which a bristle sticks."""
        for law in self.laws:
            if law.static_too:
                mu = law.apply(mu, v_s)
        return mu

    @property
    def depends_on_speed(self) -> bool:
        return any(not isinstance(law, Kinetic) for law in self.laws)
