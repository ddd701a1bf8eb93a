r"""Any pressure density, given as a function or a table.

The patch is described by the angle :math:`\varphi`, :math:`\xi = -\cos\varphi`, in which a
density with vertical ends, such as the elliptic one, is smooth. Panels are halved until a
Chebyshev series resolves the density on each; its integrals are series as well. The
breakaway point is a root in the panel that must contain it.
"""

import csv
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial import chebyshev

from tirefit.models.pressure import AbstractPressure
from tirefit.results import InputProblem, UsageError

_TERMS = 16
_NODES = np.cos(np.pi * (np.arange(_TERMS) + 0.5) / _TERMS)
_TO_SERIES = np.linalg.inv(chebyshev.chebvander(_NODES, _TERMS - 1))
_NARROWEST = 1e-12
_MOST_PANELS = 2000
_ROUNDING = 1e-13  # share of the load that a panel may leave unresolved

_LEADING = np.pi - 1e-5
"""Angle above which the whole patch counts as sliding (all but 5e-11 of it)."""


class Tabulated(AbstractPressure):
    """A numerical pressure law, made by :meth:`from_function` or :meth:`from_table`.

    A brush with it becomes a model to fit under a name of your choice::

        law = Tabulated.from_csv("patch.csv")
        tirefit.MODELS["mine"] = Brush(pressure=law)
        tirefit.fit(data, "mine")

    ``edges`` (k + 1,) of the panels in the angle; ``series`` (k, terms) of the density,
    ``load`` and ``moments`` (k, terms + 1) of its integrals; ``ratios`` (k + 1,) the
    demand ratio at which the bristle on each edge breaks away. None is a parameter.
    """

    edges: Float[Array | np.ndarray, " k1"]
    series: Float[Array | np.ndarray, "k t"]
    load: Float[Array | np.ndarray, "k t1"]
    moments: Float[Array | np.ndarray, "k t1"]
    ratios: Float[Array | np.ndarray, " k1"]

    @classmethod
    def from_function(
        cls, density: Callable[[np.ndarray], np.ndarray], kinks: Sequence[float] | np.ndarray = ()
    ) -> "Tabulated":
        """The law of a density over xi = x/a, +1 the leading edge.

        Args:
            density: NumPy function of an array of xi in [-1, 1]; any positive scale.
            kinks: xi at which its slope or value jumps; without them it is slower.

        Raises:
            UsageError: the density is negative, not finite or nowhere positive, or one
                breakaway point does not describe its patch.
        """
        return _law(cls, density, np.arccos(-np.asarray(kinks, float)), "")

    @classmethod
    def from_table(cls, xi, density, file: str = "") -> "Tabulated":
        """The law of a density that is linear between points, (n,) each.

        Args:
            xi: x/a from -1, the trailing edge, to 1, the leading edge; increasing.
            density: pressure there, any positive scale.
            file: where they came from, for messages.

        Raises:
            UsageError: as :meth:`from_function`; points not rising from -1 to 1.
        """
        xi, density = np.asarray(xi, float), np.asarray(density, float)
        _check_points(xi, density, file)
        kinks = np.arccos(-xi[1:-1])
        return _law(cls, lambda at: np.interp(at, xi, density), kinks, file)

    @classmethod
    def from_csv(cls, path: str | Path) -> "Tabulated":
        """:meth:`from_table` of a file whose header names ``xi`` and ``density``.

        Raises:
            UsageError: no such file or column, a value that is not a number, or what
                :meth:`from_table` refuses; with the row.
        """
        return cls.from_table(*_read(Path(path)), file=str(path))

    def density(self, u):
        return _density(self.edges, self.series, u)

    def cdf(self, u):
        return _integral(self.edges, self.load, self.series, u, 0)

    def moment(self, u):
        return _integral(self.edges, self.moments, self.series, u, 1)

    def breakaway(self, rho):
        return _each(self._breakaway, rho)

    def _breakaway(self, rho):
        sticking, sliding = rho <= self.ratios[0], rho >= self.ratios[-1]
        partly = ~(sticking | sliding)
        inside = (self.ratios[0] + jnp.minimum(self.ratios[-1], 1.0)) / 2
        rho = jnp.where(partly, rho, inside)
        panel = jnp.searchsorted(self.ratios, rho, side="right") - 1
        panel = jnp.clip(panel, 0, len(self.series) - 1)
        edges = jnp.asarray(self.edges)
        low, high = edges[panel], edges[panel + 1]
        series = jnp.asarray(self.series)[panel]

        def excess(angle):
            """Available friction over the demand of the bristle."""
            local = (2 * angle - low - high) / (high - low)
            return _sum(series, local) - rho * (1 + jnp.cos(angle))

        def solve(function, start):
            # By rounding, a root at an edge may be just outside.
            margin = 1e-6 * (high - low)
            last = jnp.minimum(high, _LEADING) + margin
            return _increasing_root(function, start, low - margin, last)

        def divide(linear, value):
            slope = linear(jnp.ones_like(value))
            rising = slope > 1e-30
            return jnp.where(rising, value / jnp.where(rising, slope, 1.0), 0.0)

        angle = jax.lax.custom_root(excess, (low + high) / 2, solve, divide)
        u = 2 * jnp.sin(angle / 2) ** 2
        return jnp.where(partly, u, jnp.where(sliding, 2.0, 0.0))


def _increasing_root(function, start, low, high):
    """Root between low and high by Newton's method, with bisection if it leaves them."""

    def unsettled(state):
        _, _, at, step, count = state
        # The error after a Newton step is of the order of the square of the step.
        return (count < 60) & (jnp.abs(step) > jnp.sqrt(jnp.finfo(at.dtype).eps) * at)

    def improve(state):
        low, high, at, _, count = state
        value, slope = jax.jvp(function, (at,), (jnp.ones_like(at),))
        low, high = jnp.where(value < 0, at, low), jnp.where(value < 0, high, at)
        newton = at - value / jnp.where(slope > 0, slope, 1.0)
        inside = (slope > 0) & (newton >= low) & (newton <= high)
        new = jnp.where(inside, newton, (low + high) / 2)
        return low, high, new, new - at, count + 1

    state = (low, high, start, high - low, 0)
    return jax.lax.while_loop(unsettled, improve, state)[2]


def _sum(series, local):
    """Chebyshev series (t,) at a local coordinate in [-1, 1], by Clenshaw."""
    later, last = 0.0, 0.0
    for coefficient in series[:0:-1]:
        later, last = 2 * local * later - last + coefficient, later
    return local * later - last + series[0]


def _at(edges, series, angle):
    edges, series = jnp.asarray(edges), jnp.asarray(series)
    panel = jnp.clip(jnp.searchsorted(edges, angle) - 1, 0, len(series) - 1)
    low, high = edges[panel], edges[panel + 1]
    return _sum(series[panel], (2 * angle - low - high) / (high - low))


def _angle(u):
    """Angle of u, with slope zero instead of infinity at both ends."""
    behind, ahead = jnp.maximum(u, 1e-30), jnp.maximum(2 - u, 1e-30)
    return 2 * jnp.arctan2(jnp.sqrt(behind), jnp.sqrt(ahead))


def _each(function, u):
    """Apply a function of one number to u of any shape."""
    u = jnp.asarray(u)
    return jax.vmap(function)(u.ravel()).reshape(u.shape) if u.ndim else function(u)


def _density(edges, series, u):
    return _each(lambda one: _at(edges, series, _angle(one)), u)


@jax.custom_jvp
def _integral(edges, integral, series, u, power):
    return _each(lambda one: _at(edges, integral, _angle(one)), u)


@_integral.defjvp
def _integral_slope(primals, tangents):
    # Through the angle the slope would be zero times infinity at both ends.
    edges, _, series, u, power = primals
    slope = _density(edges, series, u) * jnp.where(power == 1, u - 1, 1.0)
    return _integral(*primals), slope * tangents[3]


class _Panel(NamedTuple):
    low: float
    high: float
    angles: np.ndarray
    values: np.ndarray
    series: np.ndarray


def _panels(density, edges: np.ndarray, file: str) -> list[_Panel]:
    """Panels between the edges, halved until the density is resolved on each."""
    panels = []
    waiting = list(zip(edges[:-1], edges[1:], strict=True))[::-1]
    while waiting:
        low, high = waiting.pop()
        half = (high - low) / 2
        angles = low + half * (1 + _NODES)
        values = _valid(density(-np.cos(angles)), angles, file)
        series = _TO_SERIES @ values
        tail = np.abs(series[-3:]).max() * half * np.sin(angles).max()
        if tail <= _ROUNDING * np.abs(values).max() or half < _NARROWEST:
            panels.append(_Panel(low, high, angles, values, series))
        elif len(panels) + len(waiting) > _MOST_PANELS:
            reason = "the pressure density jumps or bends at too many places"
            raise UsageError(reason, "give a table of it, or smooth it", file)
        else:
            waiting += [(low + half, high), (low, low + half)]
    return panels


def _valid(values, angles, file: str) -> np.ndarray:
    """Values of a density, (n,); negative or non-finite values are refused."""
    values = np.broadcast_to(np.asarray(values, float), angles.shape)
    for wrong, what in (
        (~np.isfinite(values), "is not finite"),
        (values < -1e-12 * np.abs(values).max(), "is negative"),
    ):
        if wrong.any():
            xi = -np.cos(angles[wrong][0])
            reason = f"the pressure density {what} at xi = {xi:.4g}"
            remedy = "give a finite density >= 0 over all xi from -1 to 1"
            raise UsageError(reason, remedy, file)
    return values


def _check_one_breakaway(panels: list[_Panel], file: str) -> None:
    """Check that all bristles behind a sliding one slide, else raise UsageError."""
    angles = np.concatenate([np.sort(panel.angles) for panel in panels])
    values = np.concatenate([panel.values[::-1] for panel in panels])
    need = 1 + np.cos(angles)
    angles, values, need = (x[need > 1e-12] for x in (angles, values, need))
    ratio = values / need
    best = np.maximum.accumulate(ratio)
    # Rounding errors of the density matter if the demand is small.
    falls = best - ratio > 1e-9 * best + 1e-14 * values.max() / need
    if falls.any():
        xi = -np.cos(angles[falls][0])
        raise UsageError(
            f"the pressure density over (1 - xi) falls at xi = {xi:.4g}: bristles"
            " nearer to the leading edge slide first, and one breakaway point"
            " does not describe the patch (as for d < -1/3 in S(24))",
            "let the density fall less early or less steeply towards xi = 1",
            file,
        )


def _law(cls, density, kinks: np.ndarray, file: str) -> Tabulated:
    edges = np.unique(np.concatenate([np.linspace(0, np.pi, 9), kinks]))
    panels = _panels(density, edges, file)
    loads: list[np.ndarray] = []
    moments: list[np.ndarray] = []
    load, moment = 0.0, 0.0
    for panel in panels:
        per_angle = panel.values * np.sin(panel.angles)
        half = (panel.high - panel.low) / 2
        for share, integrals, start in (
            (per_angle, loads, load),
            (-np.cos(panel.angles) * per_angle, moments, moment),
        ):
            integrals.append(chebyshev.chebint(_TO_SERIES @ share, scl=half, lbnd=-1))
            integrals[-1][0] += start
        load, moment = (chebyshev.chebval(1.0, x[-1]) for x in (loads, moments))
    if not load > 0:
        reason = "the pressure density is nowhere positive"
        raise UsageError(reason, "give one that carries a load", file)
    _check_one_breakaway(panels, file)
    edges = np.array([panel.low for panel in panels] + [np.pi])
    series = np.array([panel.series for panel in panels])
    return cls(
        edges,
        series / load,
        np.array(loads) / load,
        np.array(moments) / load,
        _ratios(edges, series) / load,
    )


def _ratios(edges: np.ndarray, series: np.ndarray) -> np.ndarray:
    """Density over demand at the edges (k + 1,), with its limit at the last one."""
    at = np.minimum(edges, _LEADING)
    panel = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, len(series) - 1)
    low, high = edges[panel], edges[panel + 1]
    local = (2 * at - low - high) / (high - low)
    held = [chebyshev.chebval(*pair) for pair in zip(local, series[panel], strict=True)]
    return np.maximum.accumulate(np.maximum(held, 0) / (1 + np.cos(at)))


def _check_points(xi: np.ndarray, density: np.ndarray, file: str) -> None:
    problems = []

    def add(reason, remedy, wrong=None):
        # The header is line 1 of a file.
        row = None if wrong is None or not file else int(np.argmax(wrong)) + 2
        problems.append(InputProblem(reason, remedy, file, row))

    if xi.ndim != 1 or xi.shape != density.shape or len(xi) < 2:
        reason = f"xi {xi.shape} and density {density.shape} are not two columns"
        raise UsageError(reason, "give two columns of at least two rows", file)
    bad = ~(np.isfinite(xi) & np.isfinite(density))
    if bad.any():
        add("xi or density is not finite", "give a number in every row", bad)
    if (density < 0).any():
        add("the density is negative", "a pressure is >= 0", density < 0)
    backward = np.append(False, ~(np.diff(xi) > 0))
    if backward.any():
        remedy = "order the rows from the trailing edge -1 to the leading edge 1"
        add("xi does not increase", remedy, backward)
    if not (abs(xi[0] + 1) < 1e-9 and abs(xi[-1] - 1) < 1e-9):
        remedy = "divide the position by the contact half-length; +1 is the front"
        add(f"xi goes from {xi[0]:g} to {xi[-1]:g}, not from -1 to 1", remedy)
    UsageError.raise_for(problems)


def _read(path: Path) -> tuple[list[float], list[float]]:
    """Columns xi and density of a CSV."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file, skipinitialspace=True))
    except (OSError, UnicodeDecodeError) as error:
        reason = f"cannot read it: {error}"
        raise UsageError(reason, "check the path", str(path)) from None
    columns: dict[str, list[float]] = {"xi": [], "density": []}
    problems = []
    for row, record in enumerate(rows, start=2):
        for name, column in columns.items():
            try:
                column.append(float(record[name]))
            except (KeyError, TypeError, ValueError):
                reason = f"{record.get(name)!r} is not a number"
                remedy = "give numbers under the header xi,density"
                problems.append(InputProblem(reason, remedy, str(path), row, name))
    UsageError.raise_for(problems)
    return columns["xi"], columns["density"]
