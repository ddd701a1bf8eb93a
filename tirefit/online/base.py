"""Base of online estimators: records with ``init``, ``update``, ``wait``, ``estimate``, ``open``.

An update uses one sample and has a constant cost, so the same record runs over a log
(:mod:`tirefit.online.run`, one scan) and on a vehicle, sample by sample. Every sample
that it receives is usable: for missing, locked, standing or unordered samples the runner
only lets time pass. A further method is a file with such a record, and a line in
:data:`tirefit.online.methods.METHODS`.
"""

import enum
from collections.abc import Callable, Mapping
from functools import partial
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
key): noise of ``std`` in a sample is std / sqrt(count) here. ``dt``: time [s] since the last
update, infinite before the first."""
Updated = tuple[Any, Int[Array, ""], Number]
"""A state, the code of the flag of its sample, and the error of prediction over its std."""


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


LONGEST = 0.5  # time [s] without samples after which a state of motion is initialised again


class Estimate(NamedTuple):
    """The estimate after one sample (in a scan: after each)."""

    value: Float[Array | np.ndarray, "*n p"]  # SI units, NaN without an estimate
    std: Float[Array | np.ndarray, "*n p"]  # standard deviation of each
    flag: Int[Array | np.ndarray, "*n"] | int = 0  # code of a :class:`Flag`
    surprise: Float[Array | np.ndarray, "*n"] | float = np.nan  # error of prediction / its std
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

    average: float = par(10.0, (1.0, 1e4), "-", "samples averaged before a step")

    def init(self) -> Any:
        """The state before the first sample."""
        raise NotImplementedError

    def update(self, state: Any, sample: Sample) -> Updated:
        """The state after a usable sample, the sample's flag (0 for none) and its surprise."""
        raise NotImplementedError

    def wait(self, state: Any, dt: Number, steps: Number) -> Any:
        """The state ``dt`` [s] after the previous row; ``steps`` samples were lost.

        It is called at every row, before an update if there is one.
        """
        return state

    def estimate(self, state: Any) -> Estimate:
        """Estimates of a state, their standard deviations, and the flag of the state."""
        raise NotImplementedError

    def open(self, state: Any) -> Any:
        """The state after a detected change: the past has less weight."""
        return state

    def step(self, state: Any, sample: Sample) -> tuple[Any, Estimate]:
        """The state and the estimate after a usable sample."""
        after, flag, surprise = self.update(state, sample)
        made = self.estimate(after)
        flag, surprise = jnp.maximum(made.flag, flag), jnp.asarray(surprise, float)
        return after, made._replace(flag=flag, surprise=surprise)


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

    def update(self, state: Single, sample: Sample) -> Updated:
        made, usable, flag = self.from_sample(sample)
        return choose(usable, made, state), flag, jnp.asarray(jnp.nan)

    def estimate(self, state: Single) -> Estimate:
        return Estimate(*state)


def choose(condition: Bool[Array, ""], yes: Tree, no: Tree) -> Tree:
    """Either of two pytrees of equal structure, leaf by leaf."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)


def floats(*values: Scalar) -> Float[Array, " n"]:
    """Numbers, settings or scalar arrays as one array."""
    return jnp.stack([jnp.asarray(value, float) for value in values])


def widest(covariance: Float[Array, "n n"], prior: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """The larger of the variances (n,) in a covariance and a prior, without correlation."""
    return jnp.diag(jnp.maximum(jnp.diag(covariance), jnp.diag(prior)))


def kalman_update(
    x: Float[Array, " n"], covariance: Float[Array, "n n"], slope: Float[Array, "m n"],
    error: Float[Array, " m"], noise: Float[Array, "m m"],
) -> tuple[Float[Array, " n"], Float[Array, "n n"], Float[Array, "m m"]]:  # fmt: skip
    """A state (n,) and its covariance after a measurement (m,), in Joseph's form; the
    covariance (m, m) of the error.

    Args:
        slope: (m, n) of the measurement over the state.
        error: (m,) measured - predicted; noise: (m, m) its covariance for a known state.
    """
    spread = slope @ covariance @ slope.T + noise
    gain = jnp.linalg.solve(spread, slope @ covariance).T
    kept = jnp.eye(len(x)) - gain @ slope
    return x + gain @ error, kept @ covariance @ kept.T + gain @ noise @ gain.T, spread


def kalman_predict(
    ahead: Callable[[Array], Array], x: Float[Array, " n"], covariance: Float[Array, "n n"],
    noise: Float[Array, "n n"],
) -> tuple[Float[Array, " n"], Float[Array, "n n"]]:  # fmt: skip
    """A state (n,) and its covariance after a step ``ahead`` of the state, with its noise."""
    slope = jax.jacfwd(ahead)(x)
    return ahead(x), slope @ covariance @ slope.T + noise


def braking(sample: Sample) -> tuple[Number, Number]:
    """Physical slip [-] and force [N] along it of a sample, as if it braked: both are odd."""
    side = jnp.where(sample["sigma_x"] < 0, -1.0, 1.0)
    return side * sample["sigma_x"], side * sample["fx"]


# Fields that several methods have; the noise is that of S section 5.1, the excitation of 5.3.
nominal_stiffness: Callable[[], Any] = partial(
    par, 2.5e5, (1e-2, 1e9), "N", "expected c_p a^2; 9.26 times the load if not given", scale="log"
)
nominal_friction: Callable[..., Any] = partial(
    par, bounds=(0.01, 5.0), unit="-", meaning="expected friction"
)
force_noise: Callable[..., Any] = partial(
    par, bounds=(1e-5, 1.0), unit="-", meaning="std of the force over the load", scale="log"
)
slip_noise: Callable[[], Any] = partial(par, 0.00447, (0.0, 1.0), "-", "std of the slip")
excitation: Callable[[], Any] = partial(
    par, 0.1, (0.0, 1.0), "-", "smallest expected force over load of a sample that is used"
)
brake_gain: Callable[[], Any] = partial(
    par, 0.04, (1e-7, 10.0), "N/Pa", "brake force over brake pressure", scale="log"
)
