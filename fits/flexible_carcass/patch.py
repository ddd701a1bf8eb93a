"""Numeric solution of the patch on a flexible carcass: the independent route of this case
and of ``tests/models/test_carcass.py``.

Independent of ``tirefit``: physical coordinates, z [m] behind the leading edge. A
bristle that sticks carries c_p (slip z - w) per length, one that slides mu q_z; the
carcass deflection w obeys S(15) corrected, S w'' = -p_y, or EI w'''' = p_y, or has the
shape of a parabola of height F_y / K_c.

``free_boundary``: collocation, with sliding behind a free point.
``bristle_by_bristle``: the complementarity problem on a grid, without an assumption on
which bristles slide.
``slopes_at_rest``: closed forms for a patch that sticks everywhere.
"""

from typing import NamedTuple

import numpy as np
from numpy.polynomial import Chebyshev
from scipy.linalg import solveh_banded
from scipy.optimize import brentq

ORDER = {"thread": 2, "beam": 4}
NODES, WEIGHTS = np.polynomial.legendre.leggauss(40)
NODES, WEIGHTS = (1 + NODES) / 2, WEIGHTS / 2
TERMS = 24
_POINTS = (1 - np.cos(np.pi * (np.arange(TERMS) + 0.5) / TERMS)) / 2
_BASIS = [Chebyshev.basis(k, [0, 1]) for k in range(TERMS)]


class Tire(NamedTuple):
    """c_p [N/m^2], mu F_z [N], a [m], S, EI or K_c, and the pressure density of xi."""

    kind: str
    stiffness: float
    limit: float
    half: float
    carcass: float
    density: object

    def held(self, z):
        """Largest force per length [N/m] by friction."""
        xi = np.clip(1 - z / self.half, -1, 1)
        return self.limit / self.half * self.density(xi)


def _slid_nodes(start, end):
    """Nodes and weights on [start, end]; square roots at the rear end are smooth."""
    return end - (end - start) * NODES**2, 2 * (end - start) * NODES * WEIGHTS


def _integrals(order, t):
    """(order + 1, len(t), TERMS): the basis at t in [0, 1], integrated 0, 1, ... times
    from 0, last the basis itself."""
    levels = [
        np.array([p.integ(m, lbnd=0)(t) if m else p(t) for p in _BASIS]).T for m in range(order + 1)
    ]
    return np.array(levels[::-1])


_INSIDE = {kind: _integrals(n, _POINTS) for kind, n in ORDER.items()}
_AT_EDGE = {kind: _integrals(n, np.ones(1))[:, 0] for kind, n in ORDER.items()}
_AT_NODES = {kind: _integrals(n, NODES) for kind, n in ORDER.items()}


class Solution(NamedTuple):
    """A solution, and the numbers that show whether it is valid.

    ``force`` F_y [N]; ``moment`` M_z [N m]; ``stuck``: largest share of the friction
    used by a sticking bristle [-], 0 if none sticks; ``slid``: least excess of a sliding
    bristle's elastic force over the friction [N/m], infinite if none slides;
    ``lag``: the least growth of that excess towards the rear [N/m].
    """

    force: float
    moment: float
    stuck: float
    slid: float
    lag: float


def _stuck_part(tire: Tire, slip, edge):
    """Carcass pinned at both ends, bristles sticking over [0, edge]: the Chebyshev
    coefficients of its highest derivative there, the free slopes at z = 0 (w', and w'''
    of a beam), and w and its lower derivatives at the edge."""
    order, rest = ORDER[tire.kind], 2 * tire.half - edge
    sign = {2: -1, 4: 1}[order]
    scale = edge ** np.arange(order, -1, -1)
    inside = _INSIDE[tire.kind] * scale[:, None, None]
    at_edge = _AT_EDGE[tire.kind] * scale[:, None]
    z = edge * _POINTS
    # Columns of the free slopes: z, and z^3/6; rows: w and its derivatives at the edge.
    free = np.array([z, z**3 / 6])[: order // 2].T
    free_edge = np.array([[edge, edge**3 / 6], [1, edge**2 / 2], [0, edge], [0, 1]])[
        :order, : order // 2
    ]
    give = sign * tire.stiffness / tire.carcass
    rows = [np.hstack([inside[order] + give * inside[0], give * free])]
    right = [give * slip * z]
    nodes, weights = _slid_nodes(edge, 2 * tire.half)
    slid = sign / tire.carcass * weights * tire.held(nodes)
    edge_state = np.hstack([at_edge[:order], free_edge])
    for derivative in range(0, order, 2):
        steps = np.arange(order - derivative)
        powers = rest**steps / np.cumprod(np.maximum(steps, 1))
        rows.append(powers @ edge_state[derivative:])
        last = len(steps) - 1
        right.append([-(slid @ (2 * tire.half - nodes) ** last) / np.prod(np.maximum(steps, 1))])
    found = np.linalg.solve(np.vstack(rows), np.concatenate(right))
    return found[:TERMS], found[TERMS:], edge_state @ found


def _wanted_at_edge(tire, slip, edge):
    _, _, state = _stuck_part(tire, slip, edge)
    return tire.stiffness * (slip * edge - state[0]) - tire.held(edge)


def _largest_share(stress, held, edge, length):
    """Largest share of the friction used by sticking bristles; 0 if none sticks."""
    return np.abs(stress / held).max() if edge > 1e-6 * length else 0.0


def _least(lag, edge, length):
    """``slid`` and ``lag`` of a solution."""
    return (lag.min(), np.diff(lag).min()) if edge < length else (np.inf, np.inf)


def _edge(excess, length):
    """Place of the first sliding bristle; near an end of the patch if all or none slide."""
    low, high = 1e-6 * length, length
    if excess(low) >= 0 or excess(high) <= 0:
        return low if excess(low) >= 0 else high
    return brentq(excess, low, high, xtol=1e-15, rtol=1e-14)


def free_boundary(tire: Tire, slip) -> Solution:
    """The solution for thread and beam."""
    length, order = 2 * tire.half, ORDER[tire.kind]
    edge = _edge(lambda z: _wanted_at_edge(tire, slip, z), length)
    coefficients, slopes, state = _stuck_part(tire, slip, edge)
    z = edge * NODES
    w = edge**order * _AT_NODES[tire.kind][0] @ coefficients
    w = w + np.array([z, z**3 / 6])[: order // 2].T @ slopes
    stress = tire.stiffness * (slip * z - w)
    behind, weights = _slid_nodes(edge, length)
    held = tire.held(behind)
    force = edge * WEIGHTS @ stress + weights @ held
    moment = edge * WEIGHTS @ (stress * (tire.half - z)) + weights @ (held * (tire.half - behind))
    stuck = _largest_share(stress, tire.held(z), edge, length)
    lag = _lag(tire, slip, edge, state)
    return Solution(force, moment, stuck, *_least(lag, edge, length))


def _lag(tire, slip, edge, state, count=60):
    """Excess of the elastic force of sliding bristles per length [N/m], (count,)."""
    order, sign = ORDER[tire.kind], {"thread": -1, "beam": 1}[tire.kind]
    ends = np.linspace(edge, 2 * tire.half, count + 1)[1:]
    steps = np.arange(order)
    factorials = np.cumprod(np.maximum(steps, 1))
    span = (ends - edge)[:, None]
    nodes = edge + span * NODES
    kernel = (ends[:, None] - nodes) ** (order - 1) / factorials[-1]
    pushed = span * kernel * tire.held(nodes)
    w = span**steps / factorials @ state + sign / tire.carcass * (pushed @ WEIGHTS)
    return tire.stiffness * (slip * ends - w) - tire.held(ends)


def assumed_shape(tire: Tire, slip) -> Solution:
    """The solution for the parabola, whose height is proportional to the force."""
    length = 2 * tire.half

    def wanted(z, height):
        return tire.stiffness * (slip * z - height * (1 - (1 - z / tire.half) ** 2))

    def solve(height):
        edge = _edge(lambda z: wanted(z, height) - tire.held(z), length)
        ahead, behind = edge * NODES, _slid_nodes(edge, length)
        force = np.concatenate([wanted(ahead, height), tire.held(behind[0])])
        z = np.concatenate([ahead, behind[0]])
        weights = np.concatenate([edge * WEIGHTS, behind[1]])
        return edge, weights @ force, weights @ (force * (tire.half - z))

    # Above the largest friction, so that the signs also differ in full sliding.
    largest = 1.01 * tire.limit / tire.carcass
    height = brentq(lambda h: solve(h)[1] - tire.carcass * h, 0, largest, xtol=1e-16, rtol=1e-14)
    edge, force, moment = solve(height)
    ahead, behind = edge * NODES, np.linspace(edge, length, 61)[1:]
    lag = wanted(behind, height) - tire.held(behind)
    stuck = _largest_share(wanted(ahead, height), tire.held(ahead), edge, length)
    return Solution(force, moment, stuck, *_least(lag, edge, length))


def solved(tire: Tire, slip) -> Solution:
    return (assumed_shape if tire.kind == "parabola" else free_boundary)(tire, slip)


GRID = 160


def bristle_by_bristle(tire: Tire, slip):
    """(z, elastic force, friction) per length [N/m] of GRID bristles, each of which carries
    the smaller one. The deflection of thread and beam minimises a convex
    energy, so that there is one solution: damped Newton steps."""
    z = np.arange(1, GRID + 1) * 2 * tire.half / (GRID + 1)
    held, soft = tire.held(z), tire.stiffness
    if tire.kind == "parabola":
        bow = 1 - (1 - z / tire.half) ** 2

        def given(height):
            return np.clip(soft * (slip * z - height * bow), -held, held)

        largest = tire.limit / tire.carcass
        height = brentq(lambda h: z[0] * given(h).sum() - tire.carcass * h, 0, largest)
        return z, soft * (slip * z - height * bow), held
    full, bands = differences(tire.kind, z[0])
    full, bands = tire.carcass * full, tire.carcass * bands

    def energy(w):
        size = np.abs(soft * (slip * z - w))
        each = np.where(size < held, size**2 / 2, held * (size - held / 2)) / soft
        return w @ full @ w / 2 + each.sum()

    w = np.zeros(GRID)
    for _ in range(60):
        wanted = soft * (slip * z - w)
        slope = full @ w - np.clip(wanted, -held, held)
        curved = bands.copy()
        curved[-1] += soft * (np.abs(wanted) < held)
        step = solveh_banded(curved, slope)
        # A fourth difference loses nine digits.
        if np.abs(step).max() < 1e-7 * tire.limit / (soft * tire.half):
            return z, wanted, held
        size = 1.0
        while energy(w - size * step) > energy(w) - 1e-4 * size * (slope @ step):
            size /= 2
            if size < 1e-9:
                return z, wanted, held
        w = w - size * step
    raise AssertionError("the reference has not converged")


def differences(kind, spacing):
    """Second or fourth differences, ends pinned: full, and upper bands for LAPACK."""
    second = np.diag(np.full(GRID, 2.0)) - np.eye(GRID, k=1) - np.eye(GRID, k=-1)
    full = second / spacing**2
    full, width = (full, 1) if kind == "thread" else (full @ full, 2)
    bands = [np.r_[np.zeros(k), np.diagonal(full, k)] for k in range(width, -1, -1)]
    return full, np.array(bands)


def stress_at_rest(kind, flexibility, s):
    """p_y at s = z/a over c_p a sigma_y, every bristle sticking: closed forms.

    The thread has q'' = lambda q, the beam q'''' = -lambda q, with q = 0 at the leading
    and 2 at the trailing edge, and q'' = 0 at both for the beam.
    """
    if kind == "thread":
        k = np.sqrt(flexibility)
        return 2 * np.sinh(k * s) / np.sinh(2 * k)
    if kind == "parabola":
        return s - flexibility * 2 / (1 + 4 / 3 * flexibility) * s * (2 - s)
    b = (flexibility / 4) ** 0.25

    def pair(x):
        return np.sinh(x) * np.cos(x), np.cosh(x) * np.sin(x)

    (first, second), (end_1, end_2) = pair(b * s), pair(2 * b)
    # (sinh cos)'' = -2 b^2 cosh sin and (cosh sin)'' = 2 b^2 sinh cos.
    return 2 * (end_1 * first + end_2 * second) / (end_1**2 + end_2**2)


def slopes_at_rest(kind, flexibility):
    """Slopes of the force and of the moment about the centre, over 2 c_p a^2 and
    2 c_p a^3; of the rigid brush 1 and -1/3."""
    s = 2 * NODES
    stress = stress_at_rest(kind, flexibility, s)
    return WEIGHTS @ stress, WEIGHTS @ (stress * (1 - s))
