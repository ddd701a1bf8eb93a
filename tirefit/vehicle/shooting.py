"""Windows of logs, in each of which a car is predicted from its own start state, and least
squares over all windows with the start states eliminated."""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.data.motion import Motion, road_wheel
from tirefit.data.track import Track
from tirefit.data.vehicle import POSE, Vehicle
from tirefit.fitting import least_squares as law
from tirefit.fitting.least_squares import MAX_STEPS, Normal, NormalEquations, on_host
from tirefit.vehicle.windows import stretches

_LEAD = 0.3
"""Time [s] of steering before a window, for its delay."""
_SETTLED = 1e-8  # share of the squares that one more step would take off
_BLOCKS = 40
"""Largest number of blocks of windows of the sandwich, whose scores are independent."""

CHANNELS = {2: ("v_y", "yaw_rate"), 3: ("heading", "x", "y")}
"""Names of the logged channels of a log of rates, and of one of poses."""


class Data(NamedTuple):
    """Windows: speed (w, k), steering (w, l + k) with its lead, logged channels
    (w, k, c), NaN where they are not known, and start states (w, s)."""

    v_x: jax.Array
    steering: jax.Array
    logged: jax.Array
    start: jax.Array


def windows_of(track: Track, motion: Motion, vehicle: Vehicle, window: float):
    """:class:`Data` of a log, and the rows (w, k) of its motion; None without a window."""
    rate = vehicle.filter.sample_rate
    count, lead = round(window * rate) + 1, round(_LEAD * rate)
    logged, state, command = logged_channels(track, motion, vehicle)
    steering = road_wheel(replace(motion, command=command), vehicle)
    good = motion.settled & (motion.v_x > vehicle.v_min)
    good &= np.isfinite(np.column_stack([motion.v_x, logged, steering])).all(axis=1)
    starts = [
        k
        for first, last in stretches(good, motion.part)
        for k in range(first + lead, last - count + 1, count - 1)
    ]
    if not starts:
        return None
    rows = np.array(starts)[:, None] + np.arange(-lead, count)
    own = rows[:, lead:]
    cut = motion.v_x[own], steering[rows], logged[own], state[own[:, 0]]
    return Data(*map(jnp.asarray, cut)), own


def logged_channels(track: Track, motion: Motion, vehicle: Vehicle):
    """Values of the log for the centre of gravity, on the grid, unfiltered: channels
    (n, c), start states (n, s), and the steering command (n,)."""
    names = [channel.quantity for channel in track.channels]
    raw = {
        name: np.interp(motion.time, track.time, track.signals[:, k])
        for k, name in enumerate(names)
        if np.isfinite(track.signals[:, k]).all()
    }
    ahead, left = vehicle.cg_from_tracked
    command = raw.get("steering", motion.command)
    if vehicle.columns.motion == POSE:
        yaw = raw["yaw"]
        cos, sin = np.cos(yaw), np.sin(yaw)
        place = raw["x"] + ahead * cos - left * sin, raw["y"] + ahead * sin + left * cos
        logged = np.column_stack([yaw, *place])
        state = np.column_stack([motion.v_y, motion.yaw_rate, logged])
        return logged, state, command
    cos, sin = np.cos(vehicle.sideslip_offset), np.sin(vehicle.sideslip_offset)
    v_y = cos * raw["v_y"] + sin * raw["v_x"] + ahead * raw["yaw_rate"]
    logged = np.column_stack([v_y, raw["yaw_rate"]])
    return logged, np.column_stack([motion.v_y, motion.yaw_rate]), command


def linearised(missed, parts: int):
    """Residuals (w, k, c) and their derivatives by z (w, k, c, p) and by the start of
    the own window (w, k, c, s), compiled."""

    def one(z, start, window):
        def both(z, start):
            found = missed(z, start, window, parts)
            return found, found

        slopes, found = jax.jacfwd(both, (0, 1), has_aux=True)(z, start)
        return found, *slopes

    return jax.jit(jax.vmap(one, (None, 0, 0)))


def eliminated(missed, by_z, by_start, noise, damping=0.0):
    """The normal equations of z without the start states: score (w, p), information
    (w, p, p), and the terms of the step of each start: (w, s) and (w, s, p).

    A start state that the car forgets quickly is hardly determined; its steps are damped.
    """
    w = len(missed)
    weight = 1 / noise[None, None]
    r = (missed * weight).reshape(w, -1)
    a = (by_z * weight[..., None]).reshape(w, r.shape[1], -1)
    b = (by_start * weight[..., None]).reshape(w, r.shape[1], -1)
    own = jnp.einsum("wms,wmt->wst", b, b)
    trace = jnp.trace(own, axis1=1, axis2=2)[:, None, None]
    eye = jnp.eye(own.shape[1])[None]
    own = own + damping * own * eye + 1e-9 * trace * eye
    step = -jnp.linalg.solve(own, jnp.einsum("wms,wm->ws", b, r)[..., None])[..., 0]
    tied = -jnp.linalg.solve(own, jnp.einsum("wms,wmp->wsp", b, a))
    rest = a + jnp.einsum("wms,wsp->wmp", b, tied)
    score = jnp.einsum("wmp,wm->wp", rest, r)
    return score, jnp.einsum("wmp,wmq->wpq", rest, a), step, tied


eliminate = jax.jit(eliminated)


class _Windows:
    """Normal equations of z whose start states follow every step of z."""

    def __init__(self, run, z, starts, now, data, noise, pull):
        self.run, self.data, self.noise, self.pull = run, data, noise, np.asarray(pull)
        self.z, self.starts, self.now = np.asarray(z), starts, now
        self.cost, self.damping = np.inf, law.FIRST_DAMPING / law.EASE
        self.step, self.tied = 0.0, None

    def __call__(self, z) -> Normal:
        starts, now = self.starts, self.now
        if self.tied is not None:
            starts = starts + self.step + self.tied @ (z - self.z)
            now = self.run(z, starts, self.data)
        cost = self.squares(now[0]) + float(self.pull @ z**2)
        if cost < self.cost:
            self.z, self.starts, self.now, self.cost = z, starts, now, cost
            self.damping = max(self.damping * law.EASE, law.LEAST_DAMPING)
        else:
            self.damping /= law.EASE
        score, information, self.step, self.tied = eliminate(*self.now, self.noise, self.damping)
        missed, _, by_start = self.now
        after = missed + jnp.einsum("wkcs,ws->wkc", by_start, self.step)
        beside = self.squares(missed) - self.squares(after)
        normal = np.asarray(information.sum(axis=0)) + np.diag(self.pull)
        return Normal(cost, normal, np.asarray(score.sum(axis=0)) + self.pull * z, beside)

    def squares(self, missed) -> float:
        return float(jnp.sum((missed / self.noise[None, None]) ** 2))


def minimised(
    run, z, starts, now, data, noise, pull, bounds=(None, None), tolerance=_SETTLED, most=MAX_STEPS
):
    """Least squares in z within its bounds and in all start states; ``now`` is the result
    of ``run`` there. Returns the end values, and whether it converged in at most ``most``
    trials: a step would change the cost by less than ``tolerance`` of it."""
    at = _Windows(run, z, starts, now, data, noise, pull)
    solver, (lower, upper) = NormalEquations(tolerance), bounds
    end = on_host(at, z, solver, lower=lower, upper=upper, max_steps=most)
    return jnp.asarray(at.z), at.starts, at.now, end.converged


def sandwich(missed, by_z, by_start, noise, pull):
    """Covariance (p, p) of z from the scores of blocks of windows, and their number."""
    score, information, *_ = eliminate(missed, by_z, by_start, noise)
    inverse = np.linalg.inv(np.asarray(information.sum(axis=0)) + np.diag(pull))
    blocks = np.array_split(np.asarray(score), min(_BLOCKS, len(score)))
    sums = np.array([block.sum(axis=0) for block in blocks])
    count = len(blocks)
    middle = count / max(count - 1, 1) * sums.T @ sums
    return inverse @ (middle + np.diag(pull)) @ inverse, count
