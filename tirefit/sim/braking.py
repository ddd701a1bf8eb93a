r"""A wheel that is braked in saw-teeth, S section 5.1.

A wheel of inertia J rolls at the speed v of a vehicle; the torque T of its brake is
turned into a force of the road by the slip that it makes:

.. math:: J \dot\Omega = R F_x(\sigma, F_z) - T, \quad
    \sigma = (v - \Omega R)/(\Omega R)

which diffrax integrates. The torque rises linearly over each tooth to a share of what
the road could hold, and falls at once. The tire is the Magic Formula of the source, or
a LuGre tire whose bristles follow in time (:mod:`tirefit.sim.lugre_wheel`); noise comes
on slip and force afterwards, so that the truth is known.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from tirefit.models import MagicFormula
from tirefit.sim.lugre_wheel import PATCH, WheelNumbers, lugre_tire, lugre_wheel
from tirefit.slip import LOCKED

__all__ = [
    "BRAKE_GAIN",
    "LOAD",
    "PEAK",
    "STIFFNESS",
    "TIRES",
    "Braking",
    "SimulatedLog",
    "simulate_braking",
    "source_tire",
]

_SLOWEST = 0.01
"""Wheel speed over that of free rolling below which a wheel is locked: the brake, which
only holds, cannot turn it backwards."""


PEAK, STIFFNESS, LOAD = 0.98, 5e5, 27e3
"""D [-], C_x [N] and F_z [N] of S section 5; the load is not printed, but follows."""
_SHAPE = 1.22
BRAKE_GAIN = 0.04
"""Brake force over brake pressure [N/Pa]: some 5 MPa brake the wheel of S section 5."""
TIRES = ("magic-formula", "lugre")
"""Tires of the wheel: that of S section 5, and LuGre with its bristles in time."""


def source_tire(peak: float = PEAK) -> MagicFormula:
    """The tire of S section 5, a Magic Formula S(40); its coefficients are not printed.

    D is the peak and B C D F_z = C_x; of the pairs (C, E) with 60 % of the peak at a
    slip kappa of 4 %, as S section 5.4 has it, the one whose peak comes first.

    Args:
        peak: peak force over load D [-]; another friction changes the peak, not the
            stiffness.
    """
    x = 0.04 * STIFFNESS / (_SHAPE * PEAK * LOAD)
    bent = np.tan(np.arcsin(0.6) / _SHAPE)
    curvature = (x - bent) / (x - np.arctan(x))
    factor = STIFFNESS / (_SHAPE * peak * LOAD)
    return MagicFormula(B=factor, C=_SHAPE, D=peak, E=float(curvature))


@dataclass(frozen=True)
class Braking:
    """How a wheel is braked and measured; the values are those of S section 5.1, and
    where it says nothing those of a truck wheel sampled as a brake controller does.

    Attributes:
        amplitude: largest torque over R D F_z, the share of the first tire's peak.
        teeth: number of saw-teeth.
        period: of one [s].
        rate: samples a second.
        v: speed [m/s] of the vehicle, constant.
        fz: load [N], constant.
        friction: D of the tire, its largest steady force over the load.
        tire: one of :data:`TIRES`.
        drop: (time [s], friction from then on), or None.
        radius: effective rolling radius R [m].
        inertia: J [kg m2] of the wheel.
        slip_variance: of the noise on the slip sigma.
        force_variance: of the noise on the force, over F_z^2.
        seed: of the noise.
    """

    amplitude: float = 0.75
    teeth: int = 5
    period: float = 2.0
    rate: float = 100.0
    v: float = 20.0
    fz: float = LOAD
    friction: float = PEAK
    tire: str = "magic-formula"
    drop: tuple[float, float] | None = None
    radius: float = 0.5
    inertia: float = 15.0
    slip_variance: float = 0.2e-4
    force_variance: float = 0.2e-2
    seed: int = 0


@dataclass(frozen=True)
class SimulatedLog:
    """What would have been measured, and the truth; canonical columns (n,)."""

    columns: Mapping[str, np.ndarray]
    truth: Mapping[str, np.ndarray] = field(repr=False)


def simulate_braking(how: Braking | None = None) -> SimulatedLog:
    """A log of braking with saw-tooth torque.

    Returns:
        measured columns time, sigma_x, fx, fz, v, omega, torque, brake_pressure; the
        truth has those without noise, ``mu`` (the peak) and ``cpa2`` (half the slope at
        rest), of a LuGre tire also ``deflection``, the bristles' mean z [m].

    Raises:
        ValueError: a tire that is not one of :data:`TIRES`.
    """
    how = Braking() if how is None else how
    if how.tire not in TIRES:
        raise ValueError(f"there is no tire {how.tire!r}; choose of {', '.join(TIRES)}")
    n = round(how.teeth * how.period * how.rate)
    time = np.arange(n) / how.rate
    full = how.amplitude * how.radius * how.friction * how.fz
    mu = np.full(n, how.friction)
    if how.drop is not None:
        mu = np.where(time < how.drop[0], how.friction, how.drop[1])
    change = np.inf if how.drop is None else how.drop[0]
    wheel = _source_wheel if how.tire == "magic-formula" else _lugre_wheel
    moved = wheel(how, (mu[0], mu[-1]), full, change, time)
    torque = full * (time % how.period) / how.period
    steady = {
        "fz": np.full(n, how.fz), "v": np.full(n, how.v), "torque": torque,
        "brake_pressure": torque / how.radius / BRAKE_GAIN,
    }  # fmt: skip
    free = how.v / how.radius
    stands = moved["omega"] <= 1.001 * _SLOWEST * free
    sigma = np.where(stands, LOCKED, free / moved["omega"] - 1)
    truth = {
        "time": time, "sigma_x": sigma, "fx": moved["fx"], **steady,
        "omega": np.where(stands, 0.0, moved["omega"]),
    }  # fmt: skip
    random = np.random.default_rng(how.seed)
    seen = sigma + np.sqrt(how.slip_variance) * random.standard_normal(n)
    seen = np.where(stands, LOCKED, seen)
    noise = np.sqrt(how.force_variance) * how.fz * random.standard_normal(n)
    # The wheel speed that a measured slip is derived from.
    columns = truth | {
        "sigma_x": seen, "fx": moved["fx"] + noise,
        "omega": np.where(stands, 0.0, free / (1 + seen)),
    }  # fmt: skip
    known = {name: moved[name] for name in ("cpa2", "deflection") if name in moved}
    return SimulatedLog(columns, truth | {"mu": mu} | known)


def _source_wheel(how: Braking, friction, full: float, change: float, time):
    """Columns omega, fx and cpa2 of the wheel on the Magic Formula of S section 5."""
    tires = [source_tire(peak) for peak in friction]
    omega = np.asarray(_wheel(how, tires, full, change, time))
    kappa = 1 - omega * how.radius / how.v
    before, after = (np.asarray(tire.pure(kappa, how.fz)) for tire in tires)
    fx = np.where(time < change, before, after)
    cpa2 = np.full(len(time), STIFFNESS / LOAD * how.fz / 2)
    return {"omega": omega, "fx": fx, "cpa2": cpa2}


def _lugre_wheel(how: Braking, friction, full: float, change: float, time):
    """The same and the deflection on a LuGre tire; its slope at rest depends on v."""
    tires = lugre_tire(friction[0], how.v), lugre_tire(friction[1], how.v)
    numbers = WheelNumbers(
        full, how.period, how.radius, how.inertia, how.v, how.fz, change, 1 / how.rate
    )
    omega, fx, deflection = lugre_wheel(numbers, tires, PATCH, time, how.teeth)
    tire = tires[0]
    slope = tire.sigma0 * tire.length / 2 + (tire.sigma1 + tire.sigma2) * how.v
    cpa2 = np.full(len(time), slope * how.fz / 2)
    return {"omega": omega, "fx": fx, "cpa2": cpa2, "deflection": deflection}


def _wheel(how: Braking, tires, full: float, change: float, time):
    """Wheel speed (n,) [rad/s] at the times, on the tires before and after a change."""
    free = how.v / how.radius
    numbers = jax.tree.map(
        lambda x: jnp.asarray(x, float),
        (
            full, how.period, how.radius, how.inertia, how.v, how.fz, change,
            1 / how.rate, tires,
        ),
    )  # fmt: skip
    return free * _integrate(numbers, jnp.asarray(time), how.teeth)


@eqx.filter_jit
def _integrate(numbers, time, teeth: int):
    full, period, radius, inertia, v, fz, change, interval, (before, after) = numbers

    def rate(t, turning, args):
        del args
        kappa = 1 - turning
        force = jnp.where(t < change, before.pure(kappa, fz), after.pure(kappa, fz))
        torque = full * (t % period) / period
        # A brake holds a wheel that stands; it does not turn it.
        holds = (turning <= _SLOWEST) & (torque > radius * force)
        return jnp.where(holds, 0.0, (radius * force - torque) * radius / inertia / v)

    jumps = jnp.append(period * jnp.arange(1, teeth + 1), change)
    controller = diffrax.ClipStepSizeController(
        diffrax.PIDController(rtol=1e-7, atol=1e-9, dtmax=interval), step_ts=time,
        jump_ts=jnp.sort(jnp.where(jnp.isfinite(jumps), jumps, time[-1] + 1.0)),
    )  # fmt: skip
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rate), diffrax.Tsit5(), time[0], time[-1], None,
        jnp.ones(()), saveat=diffrax.SaveAt(ts=time), stepsize_controller=controller,
        max_steps=2**20,
    )  # fmt: skip
    return jnp.clip(solution.ys, _SLOWEST)
