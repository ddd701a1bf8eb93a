"""Base of online estimators: records with ``init``, ``step``, ``hold``, ``open``.

A step uses one sample and has a constant cost, so the same record runs over a log
(:mod:`tirefit.online.run`, one scan) and on a vehicle, sample by sample. Every sample
that it receives is usable: for missing, locked, standing or unordered samples the runner
calls ``hold`` instead. A further method is a file with such a record, and a line in
:data:`tirefit.online.methods.METHODS`.
"""

import enum
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tirefit.arrays import Number, Scalar, Tree
from tirefit.params import par

Sample = Mapping[str, Number]
"""Inputs of a method by canonical column, each the mean of ``count`` samples (a further
key): noise of ``std`` in a sample is std / sqrt(count) here."""
Condition = Bool[Array, ""] | bool
"""Whether something holds."""


class Flag(enum.Enum):
    """Reason why the sample of a row does not support the estimate; the value is its text.

    If several hold, the last one in this list is reported.
    """

    OK = ""
    LOW_USE = "friction used too little for mu"
    OUT_OF_RANGE = "outside the valid range of the method"
    SETTLING = "filter settles"
    NEAR_LIMIT = "force near its limit"
    LITTLE_EXCITATION = "little excitation"
    GAP = "samples missing before this one"
    CHANGED = "change detected"
    NO_LOAD = "no load"
    IMPLAUSIBLE = "force beyond five times the load"
    LOCKED = "wheel locked"
    STANDSTILL = "standstill"
    MISSING = "sample missing"
    TIME_BACK = "time went back"
    RESET = "not finite: restarted"


FLAGS = tuple(Flag)


def code(flag: Flag) -> int:
    """The number of a flag in arrays; larger ones have precedence."""
    return FLAGS.index(flag)


def flag_of(*reasons: tuple[Any, Flag]) -> Int[Array, ""]:
    """The flag of highest precedence among those whose condition (bool) holds."""
    codes = [jnp.where(holds, code(flag), 0) for holds, flag in reasons]
    return jnp.max(jnp.stack(codes))


RESOLVED = 0.15
"""Relative standard deviation above which mu is not resolved: asphalt, gravel and snow
differ by 0.2 to 0.3, two of these standard deviations."""


class Estimate(NamedTuple):
    """The estimate after one sample (in a scan: after each)."""

    value: Float[Array | np.ndarray, "*n p"]  # SI units, NaN without an estimate
    std: Float[Array | np.ndarray, "*n p"]  # standard deviation of each
    flag: Int[Array | np.ndarray, "*n"]  # code of a :class:`Flag`
    surprise: Float[Array | np.ndarray, "*n"]  # error of prediction / its std
    own_std: Float[Array | np.ndarray, "*n p"] | None = None
    """Standard deviations by the method alone, if the runner has widened ``std``."""


class Parameter(NamedTuple):
    """A parameter that a method estimates: unit, symbol for figures, meaning."""

    unit: str
    symbol: str
    meaning: str


PARAMETERS = {
    "mu": Parameter("-", r"\mu", "friction coefficient"),
    "theta": Parameter("-", r"\theta", "friction level over that of the tire"),
    "cpa2": Parameter("N", r"c_p a^2", "bristle stiffness; C_x = 2 c_p a^2"),
    "slip_slope": Parameter("-", "k", "slope of force over load by slip, near zero"),
    "slip_offset": Parameter("-", r"\delta", "measured slip at zero force"),
    "radius_std": Parameter("-", "r", "relative std of the rolling radius"),
    "road": Parameter("-", "road", "1 asphalt, 2 gravel, 3 snow, 4 ice"),
    "alpha": Parameter("rad", r"\alpha", "slip angle"),
    "used": Parameter("-", r"\mu_u", "friction used, over friction"),
    "xbs": Parameter("N s/m", "k", "slope of force over slip velocity"),
    "C_f": Parameter("N/rad", "C_f", "cornering stiffness of the front axle"),
    "C_r": Parameter("N/rad", "C_r", "cornering stiffness of the rear axle"),
    "F_xf": Parameter("N", "F_{xf}", "braking force of the front axle, observed"),
    "F_xf_rls": Parameter("N", "F_{xf}", "the same by least squares"),
    "F_x": Parameter("N", "F_x", "braking force of all tires"),
    "F_yf": Parameter("N", "F_{yf}", "lateral force of the front axle"),
    "F_yr": Parameter("N", "F_{yr}", "lateral force of the rear axle"),
    "tlc": Parameter("s", "t_{lc}", "time to lane crossing, none without crossing"),
}
"""Every parameter that a method estimates, under one name and in one unit."""


class Method(NamedTuple):
    """Description of a method, for ``tirefit methods`` and for checks.

    ``inputs``: canonical columns in addition to time; ``parameters``: keys of
    :data:`PARAMETERS`; ``valid``: range of used friction in which it is valid;
    ``model``: the tire model that it assumes.
    """

    name: str
    meaning: str
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    valid: str
    source: str
    model: str = "brush"


class AbstractEstimator(eqx.Module):
    """One online method; its fields are its settings, made by ``tirefit.params.par``.

    A state is a pytree of scalars or small arrays whose shapes never change.
    """

    method: ClassVar[Method]
    judged: ClassVar[bool] = True
    """Whether the runner flags rows whose mu is not resolved to :data:`RESOLVED`."""

    average: float = par(10.0, (1.0, 1e4), "-", "samples averaged before a step", "", r"n")

    def init(self) -> Any:
        """The state before the first sample."""
        raise NotImplementedError

    def step(self, state: Any, sample: Sample) -> tuple[Any, Estimate]:
        """The state and the estimate after a usable sample."""
        raise NotImplementedError

    def hold(self, state: Any, dt: Number, steps: Number) -> tuple[Any, Estimate]:
        """The state ``dt`` [s] after the previous row; ``steps`` samples were lost.

        It is called at every row, before a step if there is one.
        """
        raise NotImplementedError

    def open(self, state: Any) -> Any:
        """The state after a detected change: the past has less weight."""
        return state


class Single(NamedTuple):
    """The last estimates (p,) from a sample, and their standard deviations."""

    value: Float[Array, " p"]
    std: Float[Array, " p"]


class AbstractSingleSample(AbstractEstimator):
    """A method without memory: it computes all parameters from every sample alone."""

    def from_sample(self, sample: Sample) -> tuple[Single, Any, Int[Array, ""]]:
        """The estimates of a sample, whether they can be used, and the flag."""
        raise NotImplementedError

    def init(self) -> Single:
        nothing = jnp.full(len(self.method.parameters), jnp.nan)
        return Single(nothing, nothing)

    def step(self, state: Single, sample: Sample) -> tuple[Single, Estimate]:
        made, usable, flag = self.from_sample(sample)
        after: Single = choose(usable, made, state)
        return after, Estimate(*after, flag, jnp.full((), jnp.nan))

    def hold(self, state: Single, dt: Number, steps: Number) -> tuple[Single, Estimate]:
        return state, Estimate(*state, jnp.zeros((), int), jnp.full((), jnp.nan))


def choose(condition: Bool[Array, ""], yes: Tree, no: Tree) -> Tree:
    """Either of two pytrees of equal structure, leaf by leaf."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)


def floats(*values: Scalar) -> Float[Array, " n"]:
    """Numbers, settings or scalar arrays as one array."""
    return jnp.stack([jnp.asarray(value, float) for value in values])


def widest(covariance: Float[Array, "n n"], prior: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """The larger of the variances (n,) in a covariance and a prior, without correlation."""
    return jnp.diag(jnp.maximum(jnp.diag(covariance), jnp.diag(prior)))


def nominal_stiffness() -> Any:
    """Field of the expected stiffness; by default from the load."""
    meaning = "expected c_p a^2; 9.26 times the load if not given"
    return par(2.5e5, (1e-2, 1e9), "N", meaning, "S(47)", r"c_{p0} a^2", scale="log")


def nominal_friction(default: float = 0.98, source: str = "S(48)") -> Any:
    """Field of the expected friction."""
    return par(default, (0.01, 5.0), "-", "expected friction", source, r"\mu_0")


def braking(sample: Sample) -> tuple[Number, Number]:
    """Physical slip [-] and force [N] along it of a sample, as if it braked: both are odd."""
    side = jnp.where(sample["sigma_x"] < 0, -1.0, 1.0)
    return side * sample["sigma_x"], side * sample["fx"]


def force_noise(default: float = 0.0447, source: str = "S §5.1") -> Any:
    """Field of the standard deviation of the force over the load."""
    meaning = "std of the force over the load"
    return par(default, (1e-5, 1.0), "-", meaning, source, r"\sigma_F", scale="log")


def slip_noise() -> Any:
    """Field of the standard deviation of the slip, S section 5.1."""
    return par(0.00447, (0.0, 1.0), "-", "std of the slip", "S §5.1", r"\sigma_\lambda")


def excitation(source: str = "S §5.3") -> Any:
    """Field of the smallest excitation with which a sample is used."""
    meaning = "smallest expected force over load of a sample that is used"
    return par(0.1, (0.0, 1.0), "-", meaning, source, "u_{min}")


def brake_gain() -> Any:
    """Field of the brake force over the brake pressure."""
    meaning = "brake force over brake pressure"
    return par(0.04, (1e-7, 10.0), "N/Pa", meaning, "S §3.1", "g_b", scale="log")
