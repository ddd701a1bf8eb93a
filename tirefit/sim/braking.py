r"""Simulate a wheel with a saw-tooth brake torque, S section 5.1.

A wheel of inertia J rolls at the speed v of a vehicle. The torque T of its brake causes a
slip, and the slip a force of the road:

.. math:: J \dot\Omega = R F_x(\sigma, F_z) - T, \quad
    \sigma = (v - \Omega R)/(\Omega R)

which diffrax integrates. In each tooth the torque rises linearly to ``amplitude`` times
the torque at the friction peak, then falls at once. The tire is the Magic Formula of the
source, or a transient LuGre tire (:mod:`tirefit.sim.wheel`). Noise is added to slip and
force afterwards, so the true values are known.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from tirefit.data.write import csv_text
from tirefit.display import Record
from tirefit.files import json_safe
from tirefit.models import LuGre, MagicFormula
from tirefit.sim.settings import LOAD, PEAK, STIFFNESS, TIRES, Braking
from tirefit.sim.wheel import PATCH, SLOWEST, STEADY, WheelNumbers, braked_wheel, lugre_tire
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


def simulate_braking(how: Braking | None = None) -> SimulatedLog:
    """Simulate a log of braking with saw-tooth torque.

    Returns:
        The measured columns time, sigma_x, fx, fz, v, omega, torque, brake_pressure; the
        true columns are these without noise, ``mu`` (the peak), ``cpa2`` (half the slope
        at zero slip) and, for LuGre, ``deflection``, the bristles' mean z [m].

    Raises:
        ValueError: a tire that is not one of :data:`TIRES`.
    """
    how = Braking() if how is None else how
    if how.tire not in TIRES:
        raise ValueError(f"there is no tire {how.tire!r}; choose one of {', '.join(TIRES)}")
    n = round(how.teeth * how.period * how.rate)
    time = np.arange(n) / how.rate
    full = how.amplitude * how.radius * how.friction * how.load
    mu = np.full(n, how.friction)
    if how.drop is not None:
        mu = np.where(time < how.drop[0], how.friction, how.drop[1])
    change = np.inf if how.drop is None else how.drop[0]
    numbers = WheelNumbers(
        full, how.period, how.radius, how.inertia, how.speed, how.load, change, 1 / how.rate
    )
    ends, extra = (mu[0], mu[-1]), {}
    if how.tire == "lugre":
        soft = tuple(lugre_tire(peak, how.speed) for peak in ends)
        omega, fx, bent = braked_wheel(numbers, soft, PATCH, time, how.teeth)
        slope, extra = _slope_at_rest(soft[0], how.speed), {"deflection": bent}
    else:
        stiff = tuple(map(source_tire, ends))
        omega, fx, _ = braked_wheel(numbers, stiff, STEADY, time, how.teeth)
        slope = STIFFNESS / LOAD
    torque = full * (time % how.period) / how.period
    steady = {
        "fz": np.full(n, how.load),
        "v": np.full(n, how.speed),
        "torque": torque,
        "brake_pressure": torque / how.radius / BRAKE_GAIN,
    }
    free = how.speed / how.radius
    stands = omega <= 1.001 * SLOWEST * free
    sigma = np.where(stands, LOCKED, free / omega - 1)
    truth = {
        "time": time,
        "sigma_x": sigma,
        "fx": fx,
        **steady,
        "omega": np.where(stands, 0.0, omega),
    }
    random = np.random.default_rng(how.seed)
    seen = sigma + np.sqrt(how.slip_variance) * random.standard_normal(n)
    seen = np.where(stands, LOCKED, seen)
    noise = np.sqrt(how.force_variance) * how.load * random.standard_normal(n)
    # The wheel speed from which the measured slip would be derived.
    columns = truth | {
        "sigma_x": seen,
        "fx": fx + noise,
        "omega": np.where(stands, 0.0, free / (1 + seen)),
    }
    known = {"mu": mu, "cpa2": np.full(n, slope * how.load / 2), **extra}
    return SimulatedLog(columns, truth | known)


def _slope_at_rest(tire: LuGre, v: float) -> float:
    """Slope of the force at zero slip over the load [-]; it depends on the speed."""
    return tire.sigma0 * tire.length / 2 + (tire.sigma1 + tire.sigma2) * v
