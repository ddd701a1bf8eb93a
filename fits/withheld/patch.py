"""A tire contact patch, summed bristle by bristle, that effects can change.

This is the independent route for ``tirefit diagnose``: it shares no code with tirefit. A
:class:`World` holds the true inputs of every row and the properties of the patch;
an effect (``effects.py``) changes a world; :func:`forces` sums the bristles.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

__all__ = ["World", "forces", "lagged", "parabola", "plain_brush", "shifted"]

BRISTLES = 128
ROWS = 256  # at a time: larger tables spend more time on memory than on sums
HALF_LENGTH = 0.1  # m
FIXED_POINT_STEPS = 14
LAG_STEPS = 8  # integration steps of a lag between two samples


def parabola(xi: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Pressure density over xi (k,), leading edge +1; ``used`` is F/(mu F_z) (n, 1)."""
    return 0.75 * (1 - xi**2)


@dataclass
class World:
    """True inputs (n,) of every row and the properties of the patch in that row.

    ``force`` is the channel that depends on ``slip``: "fx" (sigma_x) or "fy"
    (tan alpha). ``stiffness`` is c_p a^2 [N]; ``mu_s`` is static friction, ``mu_k``
    sliding friction. ``carcass`` is (compliance [1/N], "slip" or "bow"), ``weakening`` the
    length over which friction falls from mu_s to mu_k behind the breakaway point (in
    half-lengths). ``fz`` is the measured load, ``load`` the load on the patch;
    ``inflation`` [Pa] and ``across`` [N], the other force, are columns. ``slip`` acts on
    the patch, ``sensed`` is the reading of a perfect sensor. Changes are functions of
    (world, values): ``after`` changes the force, ``late`` force and moment, ``logged`` the
    slip.
    """

    time: np.ndarray
    run: np.ndarray
    slip: np.ndarray
    fz: np.ndarray
    v: np.ndarray
    force: str
    c: float
    mu: float
    cross: np.ndarray | None = None
    gamma: np.ndarray | None = None
    temperature: np.ndarray | None = None
    moment: bool = False
    inflation: np.ndarray | None = None
    across: np.ndarray | None = None
    load: np.ndarray = field(default=None)
    sensed: np.ndarray = field(default=None)
    stiffness: np.ndarray = field(default=None)
    mu_s: np.ndarray = field(default=None)
    mu_k: np.ndarray = field(default=None)
    pressure: Callable = parabola
    weakening: float | None = None
    carcass: tuple[float, str] | None = None
    slides_across: bool = False  # whether ``cross`` is logged in full
    bites: bool = False  # whether ``cross`` uses part of the friction
    cross_stiffness: float = 1.0
    after: list = field(default_factory=list)
    late: list = field(default_factory=list)
    logged: list = field(default_factory=list)

    def __post_init__(self):
        ones = np.ones(len(self.slip))
        self.load = self.fz if self.load is None else self.load
        self.sensed = self.slip if self.sensed is None else self.sensed
        self.stiffness = self.c * ones if self.stiffness is None else self.stiffness
        self.mu_s = self.mu * ones if self.mu_s is None else self.mu_s
        self.mu_k = self.mu * ones if self.mu_k is None else self.mu_k

    def scale_friction(self, factor: np.ndarray) -> None:
        self.mu_s, self.mu_k = self.mu_s * factor, self.mu_k * factor

    @property
    def sliding_speed(self) -> np.ndarray:
        """Speed of the sliding bristles over the road [m/s], >= 0."""
        if self.force == "fy":
            return self.v * np.abs(self.slip) / np.sqrt(1 + self.slip**2)
        return self.v * np.abs(self.slip) / (1 + self.slip)

    @property
    def loading(self) -> np.ndarray:
        """Rate of |slip| [1/s], within runs."""
        rate = np.zeros(len(self.slip))
        for run in np.unique(self.run):
            rows = np.flatnonzero(self.run == run)
            if len(rows) > 1:
                rate[rows] = np.gradient(np.abs(self.slip[rows]), self.time[rows])
        return rate


def _sum(world: World, slip: np.ndarray, used: np.ndarray, bow: np.ndarray):
    """Force [N] and moment [N m] of the bristles at the magnitude of the slip (n,) >= 0."""
    step = 2 / BRISTLES
    xi = 1 - step * (np.arange(BRISTLES) + 0.5)
    density = np.atleast_2d(world.pressure(xi, used[:, None]))
    density = density / (density.sum(axis=1, keepdims=True) * step)
    density = np.broadcast_to(density, (len(slip), BRISTLES))
    force, moment = np.empty(len(slip)), np.empty(len(slip))
    for first in range(0, len(slip), ROWS):
        rows = slice(first, first + ROWS)
        stress = _stress(world, rows, xi, density[rows], slip[rows], bow[rows])
        force[rows], moment[rows] = stress.sum(axis=1), HALF_LENGTH * (stress @ xi)
    return force, moment


def _stress(world: World, rows: slice, xi, density, slip, bow) -> np.ndarray:
    """Force of every bristle of these rows [N], (rows, BRISTLES)."""
    step = 2 / BRISTLES
    demand = world.stiffness[rows, None] * (slip[:, None] * (1 - xi) - bow[:, None] * (1 - xi**2))
    carried = world.load[rows, None] * density
    excess = demand - world.mu_s[rows, None] * carried
    sliding = excess > 0
    first = np.where(sliding.any(axis=1), sliding.argmax(axis=1), BRISTLES)
    at, before = np.minimum(first, BRISTLES - 1), np.maximum(first - 1, 0)
    each = np.arange(len(slip))
    low, high = excess[each, before], excess[each, at]
    share = np.where(high > low, -low / np.where(high > low, high - low, 1), 0)
    breakaway = np.where(first == 0, 1.0, xi[before] - step * np.clip(share, 0, 1))
    breakaway = np.where(first == BRISTLES, -1.0, breakaway)
    sticking = np.clip((xi + step / 2 - breakaway[:, None]) / step, 0, 1)
    friction = world.mu_k[rows, None]
    if world.weakening:
        slid = np.maximum(breakaway[:, None] - xi, 0) / world.weakening
        friction = friction + (world.mu_s - world.mu_k)[rows, None] * np.exp(-slid)
    return step * (sticking * demand + (1 - sticking) * friction * carried)


def _steady(world: World) -> tuple[np.ndarray, np.ndarray]:
    """Signed force and moment (n,) along ``slip``, before the changes of ``after``."""
    along, across = world.slip, np.zeros(len(world.slip))
    if world.bites:
        across = world.cross_stiffness * world.cross
    size = np.hypot(along, across)
    direction = np.divide(along, size, out=np.sign(along), where=size > 0)
    none = np.zeros(len(size))
    force, moment = _sum(world, size, none, none)
    implicit = world.carcass or world.pressure.__name__.startswith("shifting")
    for _ in range(FIXED_POINT_STEPS if implicit else 0):
        used = direction * force / (world.mu_s * world.load)
        slip, bow = size, none
        if world.carcass:
            compliance, kind = world.carcass
            if kind == "slip":
                slip = np.maximum(size - compliance * force, 0)
            else:  # same loss of force as "slip" while all bristles stick: 2 = 4/3 * 3/2
                bow = 1.5 * np.minimum(compliance * force, 0.6 * size)
        new, moment = _sum(world, slip, used, bow)
        force = 0.5 * (force + new)
    return direction * force, direction * moment


def forces(world: World) -> dict[str, np.ndarray]:
    """The noise-free forces (n,) of a world: fx, or fy and optionally mz."""
    force, moment = _steady(world)
    for change in world.after:
        force = change(world, force)
    for change in world.late:
        force, moment = change(world, force), change(world, moment)
    out = {world.force: force}
    if world.moment:
        out["mz"] = moment
    return out


def plain_brush(slip, fz, c, mu) -> tuple[np.ndarray, np.ndarray]:
    """Force [N] and moment [N m] of the parabolic brush in closed form, S(12).

    The moment is negative for positive slip: the force acts behind the centre.
    """
    top = mu * fz
    u = np.minimum(np.abs(slip) * c / (1.5 * top), 1)
    sign = np.sign(slip)
    return sign * top * (1 - (1 - u) ** 3), -sign * HALF_LENGTH * top * u * (1 - u) ** 3


def shifted(world: World, values: np.ndarray, delay: float) -> np.ndarray:
    """``values`` (n,) delayed by ``delay`` [s], run by run."""
    out = values.copy()
    for run in np.unique(world.run):
        rows = world.run == run
        out[rows] = np.interp(world.time[rows] - delay, world.time[rows], values[rows])
    return out


def lagged(world: World, values: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Solves dy/dt = rate (values - y) run by run, from rest at the first value.

    ``rate`` (n,) [1/s]: speed over relaxation length, or 1/time constant. Implicit
    trapezoidal steps, LAG_STEPS of them between samples.
    """
    out = values.copy()
    for run in np.unique(world.run):
        rows = np.flatnonzero(world.run == run)
        time = world.time[rows]
        fine = np.interp(
            np.arange((len(rows) - 1) * LAG_STEPS + 1) / LAG_STEPS, np.arange(len(rows)), time
        )
        drive = np.interp(fine, time, values[rows]).tolist()
        half = (np.interp(fine, time, rate[rows])[1:] * np.diff(fine) / 2).tolist()
        state, states = drive[0], [drive[0]]
        for k, a in enumerate(half):
            state = (state * (1 - a) + a * (drive[k] + drive[k + 1])) / (1 + a)
            states.append(state)
        out[rows] = states[::LAG_STEPS]
    return out
