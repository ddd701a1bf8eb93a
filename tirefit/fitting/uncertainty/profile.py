"""Profile likelihood of each parameter, maximized over the others."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from tirefit.fitting.problem.likelihood import FitProblem
from tirefit.fitting.solve.inference import REACH, minima


class Profile(NamedTuple):
    """Profile of one element of z, and its 95 % interval."""

    z: np.ndarray  # (m,) points
    deviance: np.ndarray  # (m,)
    low: float
    high: float
    open_low: bool  # the data do not limit it before the bound
    open_high: bool  # the same above


class Side:
    """One side of a profile: searches the distance at which the deviance, whose root is
    nearly linear, reaches the level."""

    def __init__(self, center: float, sign: int, std: float, level: float):
        self.center, self.sign, self.goal = center, sign, np.sqrt(level)
        self.reach = max(REACH - sign * center, 1e-3)
        self.distances, self.roots = [0.0], [0.0]
        self.std = min(std, self.reach / 3)
        self.done = False

    def next_distance(self) -> float:
        count = len(self.distances) - 1
        if count < 2:
            return min((0.8, 1.5)[count] * self.std, self.reach)
        if self.done:
            # One point beyond the interval, for the figure.
            return min(1.3 * self.end, self.reach)
        above = [d for d, r in zip(self.distances, self.roots, strict=True) if r > self.goal]
        if above:
            outer = min(above)
            inner = max(d for d in self.distances if d < outer)
            # Next to a bound the root is far from linear and interpolation creeps along
            # one end, so every other step is in the middle.
            last, before = (root > self.goal for root in self.roots[:-3:-1])
            if last == before:
                return (inner + outer) / 2
            return float(np.interp(self.goal, *self._rising()))
        farthest, root = self.distances[-1], max(self.roots[-1], 1e-3)
        return float(min(farthest * np.clip(1.02 * self.goal / root, 1.2, 4.0), self.reach))

    def _rising(self) -> tuple[np.ndarray, np.ndarray]:
        order = np.argsort(self.distances)
        distances = np.array(self.distances)[order]
        return np.maximum.accumulate(np.array(self.roots)[order]), distances

    def add(self, distance: float, deviance: float) -> None:
        self.distances.append(distance)
        self.roots.append(float(np.sqrt(max(deviance, 0.0))))
        close = abs(self.roots[-1] - self.goal) < 3e-3 * self.goal
        exhausted = distance >= self.reach and self.roots[-1] <= self.goal
        self.done = self.done or close or exhausted

    def doubts(self, distance: float, deviance: float) -> bool:
        """Whether a point beyond the level is higher than extrapolated from the points
        before it (their root is nearly linear): another minimum, or no convergence."""
        inner = [
            (d, r)
            for d, r in zip(self.distances, self.roots, strict=True)
            if 0 < d < distance and r < self.goal
        ]
        root = np.sqrt(max(deviance, 0.0))
        if not inner or root < self.goal:
            return False
        before, lower = max(inner)
        return bool(root > _JUMP * lower * distance / before)

    @property
    def open(self) -> bool:
        return max(self.roots) < self.goal * (1 - 3e-3)

    @property
    def end(self) -> float:
        """Distance of the crossing, or the reach if there is none."""
        if self.open:
            return self.reach
        roots, distances = self._rising()
        return float(np.interp(self.goal, roots, distances))


_ROUNDS = 16

_JUMP = 2.0
"""Factor above a linear root at which a point of a profile is searched again."""


def profile_all(
    problem: FitProblem, z: Float[np.ndarray, " p"], cov: Float[np.ndarray, "p p"], level: float
) -> list[Profile]:
    """Profile likelihood of every element of z, all sides searched together."""
    std, size = np.sqrt(np.diag(cov)), len(z)
    sides = [Side(z[i], s, std[i], level) for i in range(size) for s in (-1, 1)]
    index = np.repeat(np.arange(size), 2)
    signs = np.tile([-1, 1], size)
    # How the other elements follow: first by the covariance, then as last found.
    follow = signs[:, None] * (cov[:, index] / np.diag(cov)[index]).T
    # The first round is at distance zero and gives the deviance of the best fit.
    base, distance = None, np.zeros(len(sides))
    # The outermost point below the level on every side.
    inner = np.repeat(z[None], len(sides), axis=0)
    for _ in range(_ROUNDS):
        finished = all(side.done for side in sides)
        starts = np.clip(z + follow * distance[:, None], -REACH, REACH)
        values = np.clip(z[index] + signs * distance, -REACH, REACH)
        ends = minima(problem, starts, index, values)
        if base is None:
            base = float(np.min(ends.deviance))
        else:
            rise = np.nan_to_num(ends.deviance - base, nan=1e9, posinf=1e9)
            every = zip(sides, distance, rise, strict=True)
            doubtful = np.flatnonzero([side.doubts(d, value) for side, d, value in every])
            if len(doubtful):  # these are searched again from the previous point
                again = minima(problem, inner[doubtful], index[doubtful], values[doubtful])
                lower = again.deviance < base + rise[doubtful]
                ends = jax.tree.map(np.copy, ends)
                for whole, part in zip(ends, again, strict=True):
                    whole[doubtful[lower]] = part[lower]
                rise = np.nan_to_num(ends.deviance - base, nan=1e9, posinf=1e9)
            follow = (np.asarray(ends.z) - z) / np.maximum(distance, 1e-9)[:, None]
            inner = np.where((rise < level)[:, None], np.asarray(ends.z), inner)
            for side, d, value in zip(sides, distance, rise, strict=True):
                side.add(d, value)
        if finished:
            break
        distance = np.array([side.next_distance() for side in sides])
    return [_joined(z[i], sides[2 * i], sides[2 * i + 1]) for i in range(size)]


def _joined(center: float, low: Side, high: Side) -> Profile:
    distances = np.concatenate([-np.array(low.distances), np.array(high.distances[1:])])
    roots = np.concatenate([low.roots, high.roots[1:]])
    order = np.argsort(distances)
    return Profile(
        center + distances[order],
        roots[order] ** 2,
        center - low.end,
        center + high.end,
        low.open,
        high.open,
    )
