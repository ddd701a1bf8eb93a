r"""Simulate a wheel with a saw-tooth brake torque, S section 5.1.

A wheel of inertia J rolls at the speed v of a vehicle. The torque T of its brake causes a
slip, and the slip a force of the road:

.. math:: J \dot\Omega = R F_x(\sigma, F_z) - T, \quad
    \sigma = (v - \Omega R)/(\Omega R)

which diffrax integrates. In each tooth the torque rises linearly to ``amplitude`` times the torque
at the friction peak, then falls at once. The tire is the Magic Formula of the source, in steady
state, or a transient LuGre tire (:mod:`tirefit.sim.lugre`). Noise is added to slip and force.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, ClassVar, cast

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.optimize import brentq

from tirefit.arrays import Numbers
from tirefit.data.write import csv_text
from tirefit.display import Record
from tirefit.files import json_safe
from tirefit.models import LuGre, MagicFormula
from tirefit.online.lugre_observer import peak_share
from tirefit.results import UsageError
from tirefit.sim.lugre import Bristles, Contact, bristle_forces, bristle_rate, distributed
from tirefit.sim.settings import LOAD, PEAK, STIFFNESS, Braking
from tirefit.slip import LOCKED

_SHAPE = 1.22
BRAKE_GAIN = 0.04
"""Brake force over brake pressure [N/Pa]: about 5 MPa for the wheel of S section 5."""


def source_tire(peak: float = PEAK) -> MagicFormula:
    """The tire of S section 5, a Magic Formula S(40); its coefficients are not printed.

    D is the peak and B C D F_z = C_x. C and E are the pair whose peak is at the smallest
    slip, among those with 60 % of the peak at a slip kappa of 4 % (S section 5.4).

    Args:
        peak: peak force over load D [-]; the stiffness does not depend on it.
    """
    x = 0.04 * STIFFNESS / (_SHAPE * PEAK * LOAD)
    bent = np.tan(np.arcsin(0.6) / _SHAPE)
    curvature = (x - bent) / (x - np.arctan(x))
    factor = STIFFNESS / (_SHAPE * peak * LOAD)
    return MagicFormula(B=factor, C=_SHAPE, D=peak, E=float(curvature))


@dataclass(frozen=True)
class SimulatedLog(Record):
    """A simulated log: measured and true values in canonical columns (n,)."""

    text_by: ClassVar[str] = "tirefit.report.records:log_text"
    plot_by: ClassVar[str] = "tirefit.report.records:log_figure"

    columns: Mapping[str, np.ndarray]
    truth: Mapping[str, np.ndarray] = field(repr=False)

    def to_dict(self) -> dict[str, Any]:
        """The columns as lists."""
        return json_safe({"columns": self.columns, "truth": self.truth})

    def files(self, name: str = "log") -> dict[str, str]:
        """``NAME.csv``, and the true values without noise, ``NAME.truth.tsv``."""
        name = name or "log"
        truth = csv_text(self.truth, "\t")  # *.csv, a pattern of logs, does not match it
        return {f"{name}.csv": csv_text(self.columns), f"{name}.truth.tsv": truth}


SLOWEST = 0.01
"""Wheel speed over that of free rolling below which a wheel is locked: a brake can hold
a wheel but cannot turn it backwards."""


PATCH = distributed(1)  # four bristles: S(18) to 1e-4 of the load
STEADY = Bristles(np.zeros(0), np.zeros(0), np.zeros((0, 0)))
"""No bristles: the force of a tire in steady state follows the slip without lag."""


@cache
def lugre_tire(peak: float, v: float) -> LuGre:
    """The LuGre tire with a given peak: g is replaced by theta g, S section 3.4.

    Args:
        peak: largest steady force over the load [-] at the speed v [m/s].
    """
    tire = LuGre()
    theta = brentq(lambda theta: float(peak_share(tire, theta, v)) - peak, 0.005, 4.0, xtol=1e-15)
    return cast(LuGre, tire.scaled(theta))


def braked_wheel(
    numbers: tuple[float, ...], tires: tuple[Any, Any], bristles: Bristles, time: np.ndarray,
    teeth: int, max_steps: int = 2**22,
) -> tuple[np.ndarray, ...]:  # fmt: skip
    """Wheel speed [rad/s], force [N] and mean deflection [m] at the times (n,).

    Args:
        numbers: torque at the end of a tooth [N m], its period [s], radius [m], inertia
            [kg m2], speed [m/s], load [N], time of the change of friction [s], interval of
            sampling [s].
        tires: before and after the change, two :class:`LuGre` or two steady tires.
        bristles: :data:`PATCH` for LuGre tires; :data:`STEADY` for steady tires.
        time: increasing instants [s]; ``teeth``: number of saw-teeth.
        max_steps: limit of integration steps.

    Raises:
        UsageError: the braking needs more steps.
    """
    traced = jax.tree.map(lambda x: jnp.asarray(x, float), (numbers, tires))
    *moved, followed = _integrate(traced, bristles, jnp.asarray(time), teeth, max_steps)
    if not followed:
        raise UsageError(
            f"the braking needs more than {max_steps} steps", "shorten it or raise the inertia"
        )
    return tuple(np.asarray(part) for part in moved)


@eqx.filter_jit
def _integrate(
    traced: Any, bristles: Bristles, time: Array, teeth: int, max_steps: int
) -> tuple[Array, Array, Array, Array]:
    numbers, tires = traced
    full, period, radius, inertia, v, fz, change, interval = numbers

    def parts(t: Numbers, y: Any) -> tuple[Array, Array, Array]:
        """Wheel speed over that of free rolling, force, rate of the bristles."""
        turning, z = jnp.clip(y[0], SLOWEST), y[1]
        tire = jax.tree.map(lambda a, b: jnp.where(t < change, a, b), *tires)
        if not len(bristles.place):
            return turning, tire.pure(1 - turning, fz), z
        now = Contact(jnp.stack([v - v * turning, 0.0]), v * turning, fz)
        force = jnp.asarray(bristle_forces(tire, bristles, z, now).fx)
        return turning, force, bristle_rate(tire, bristles, z, now)

    def rate(t: Numbers, y: Any, args: Any) -> tuple[Array, Array]:
        del args
        turning, force, bent = parts(t, y)
        torque = full * (t % period) / period
        # A brake holds a standing wheel; it does not turn it backwards.
        holds = (turning <= SLOWEST) & (torque > radius * force)
        spun = jnp.where(holds, 0.0, (radius * force - torque) * radius / inertia / v)
        return spun, bent

    jumps = jnp.append(period * jnp.arange(1, teeth + 1), change)
    controller = diffrax.ClipStepSizeController(
        diffrax.PIDController(rtol=1e-7, atol=1e-10, dtmax=interval),
        step_ts=time,
        jump_ts=jnp.sort(jnp.where(jnp.isfinite(jumps), jumps, time[-1] + 1.0)),
    )
    rest = jnp.ones(()), jnp.zeros((len(bristles.weight), 2))
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rate), diffrax.Tsit5(), time[0], time[-1], None, rest,
        saveat=diffrax.SaveAt(ts=time), stepsize_controller=controller,
        max_steps=max_steps, throw=False,
    )  # fmt: skip

    def seen(t: Array, y: Any) -> tuple[Array, Array, Array]:
        turning, force, _ = parts(t, y)
        return turning * v / radius, force, jnp.asarray(bristles.weight) @ y[1][:, 0]

    return *jax.vmap(seen)(time, solution.ys), diffrax.is_successful(solution.result)


def simulate_braking(how: Braking | None = None) -> SimulatedLog:
    """Simulate a log of braking with saw-tooth torque.

    Returns:
        The measured columns time, sigma_x, fx, fz, v, omega, torque, brake_pressure; the
        true columns are these without noise, ``mu`` (the peak), ``cpa2`` (half the slope
        at zero slip) and, for LuGre, ``deflection``, the bristles' mean z [m].
    """
    how = Braking() if how is None else how
    UsageError.raise_for(how.problems())
    n = round(how.teeth * how.period * how.rate)
    time = np.arange(n) / how.rate
    full = how.amplitude * how.radius * how.friction * how.load
    change, after = (np.inf, how.friction) if how.drop is None else how.drop
    mu = np.where(time < change, how.friction, after)
    numbers = full, how.period, how.radius, how.inertia, how.speed, how.load, change, 1 / how.rate
    is_lugre, ends = how.tire == "lugre", (mu[0], mu[-1])
    tires = [lugre_tire(peak, how.speed) if is_lugre else source_tire(peak) for peak in ends]
    bristles = PATCH if is_lugre else STEADY
    omega, fx, bent = braked_wheel(numbers, (tires[0], tires[1]), bristles, time, how.teeth)
    slope = STIFFNESS / LOAD
    if isinstance(tire := tires[0], LuGre):
        # Slope of the force at zero slip over the load [-]; it depends on the speed.
        slope = tire.sigma0 * tire.length / 2 + (tire.sigma1 + tire.sigma2) * how.speed
    torque = full * (time % how.period) / how.period
    free = how.speed / how.radius
    stands = omega <= 1.001 * SLOWEST * free
    sigma = np.where(stands, LOCKED, free / omega - 1)
    truth = {
        "time": time, "sigma_x": sigma, "fx": fx, "fz": np.full(n, how.load),
        "v": np.full(n, how.speed), "torque": torque,
        "brake_pressure": torque / how.radius / BRAKE_GAIN,
        "omega": np.where(stands, 0.0, omega),
    }  # fmt: skip
    random = np.random.default_rng(how.seed)
    seen = sigma + np.sqrt(how.slip_variance) * random.standard_normal(n)
    seen = np.where(stands, LOCKED, seen)
    noise = np.sqrt(how.force_variance) * how.load * random.standard_normal(n)
    # The wheel speed from which the measured slip would be derived.
    measured = {
        "sigma_x": seen,
        "fx": fx + noise,
        "omega": np.where(stands, 0.0, free / (1 + seen)),
    }
    columns = truth | measured
    truth |= {"mu": mu, "cpa2": np.full(n, slope * how.load / 2)}
    return SimulatedLog(columns, truth | ({"deflection": bent} if is_lugre else {}))
