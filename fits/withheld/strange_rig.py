"""More unlisted effects: disturbances by rigs, roads and cars.

Each takes (world, size, generator) and changes the world; ``size`` is 0.02 to 0.08 of
the friction force, of either sign. The docstring gives an example from practice.
"""

import numpy as np

from fits.withheld.patch import World, lagged

__all__ = ["NEEDS", "RIG_KINDS"]

SHORTEST = 9  # samples per wave: a shorter one could not be separated from noise


def _add(world: World, change) -> None:
    world.after.append(lambda w, force: force + w.mu * w.fz * change(w))


def _distance(world: World) -> np.ndarray:
    """Distance rolled [m], without the pauses between runs."""
    steps = np.diff(world.time, prepend=world.time[0])
    return np.cumsum(world.v * np.minimum(steps, 5 * np.median(steps)))


def _by_run(world: World, values: np.ndarray, change) -> np.ndarray:
    out = values.copy()
    for run in np.unique(world.run):
        rows = np.flatnonzero(world.run == run)
        out[rows] = change(values[rows])
    return out


def after_turn(world, size, g):
    """Hysteresis that decays with the slip since the direction changed: the rubber of a
    tread block creeps back before it deforms the other way."""
    width = g.uniform(0.08, 0.2) * np.ptp(world.slip)

    def faded(slip):
        step = np.diff(slip, prepend=slip[0])
        out, travelled = np.zeros(len(slip)), np.inf
        for k in range(1, len(slip)):
            turned = step[k] * step[k - 1] < 0
            travelled = 0.0 if turned else travelled + abs(step[k])
            out[k] = np.sign(step[k]) * np.exp(-travelled / width)
        return out

    shape = _by_run(world, world.slip, faded)
    _add(world, lambda w: 2 * size * shape)


def uneven_lag(world, size, g):
    """A force that builds up slowly and drops quickly, or the reverse: a brake's hydraulics,
    a friction clutch, a belt that is driven in one direction only."""
    time = g.uniform(0.6, 1.2) * abs(size)  # s
    late = bool(g.integers(2))

    def change(w, force):
        growing = np.gradient(np.abs(force)) > 0
        return lagged(w, force, 1 / np.where(growing == late, 4 * time, 0.2 * time))

    world.late.append(change)


def tread_blocks(world, size, g):
    """Ripple over the distance rolled: tread blocks that enter the patch, the joint of a
    belt, a drum out of round."""
    way = _distance(world)
    per_wave = g.uniform(SHORTEST, 3 * SHORTEST)
    length, phase = per_wave * np.median(np.diff(way)), g.uniform(0, 6)
    _add(world, lambda w: size * np.sin(2 * np.pi * way / length + phase))


def chatter(world, size, g):
    """Stick-slip above a slip: squeal and judder, a saw tooth at the frequency of the
    suspension or the spindle, as sampled."""
    above = g.uniform(0.35, 0.6) * np.abs(world.slip).max()
    step = np.median(np.diff(world.time))
    period = g.uniform(SHORTEST, 2 * SHORTEST) * step
    tooth = 2 * (world.time / period % 1) - 1
    _add(world, lambda w: 1.5 * size * tooth * (np.abs(w.slip) > above))


def resonance(world, size, g):
    """A change of the mean force at one speed, where the rig or the axle is in resonance:
    the hub of a wheel bench, the first mode of a drum."""
    speed = g.choice(np.unique(world.v))
    at = g.uniform(0.1, 0.5) * np.abs(world.slip).max()
    near = np.exp(-(((world.v / speed - 1) / 0.15) ** 2) / 2)
    _add(world, lambda w: 1.5 * size * near * np.exp(-(((np.abs(w.slip) - at) / at) ** 2)))


def gated_cross(world, size, g):
    """Cross-coupling above a speed only: a control loop of the rig that switches, or a
    downforce that depends on the other axis."""
    speeds = np.unique(world.v)
    beyond = world.v >= speeds[-1 if len(speeds) < 3 else g.integers(1, len(speeds))]
    _add(world, lambda w: 1.5 * size * beyond * w.across / (0.5 * w.mu * w.fz))


def quantised(world, size, _):
    """Slip in steps: a wheel encoder with few teeth, a logger with few bits."""
    step = 0.5 * abs(size)
    world.logged.append(lambda w, slip: step * np.round(slip / step))


def amplifier_limit(world, size, _):
    """The largest forces are clipped: a bridge amplifier or a logger at its limit."""

    def cut(w, force):
        top = np.abs(force).max() * (1 - 4 * abs(size))
        return np.clip(force, -top, top)

    world.after.append(cut)


def dead_zone(world, size, _):
    """Play: a worn ball joint or a slack belt takes the first part of the slip."""
    play = 0.15 * abs(size)
    world.slip = np.sign(world.slip) * np.maximum(np.abs(world.slip) - play, 0)


def joints(world, size, g):
    """Patches of another surface at equal distances: joints of concrete slabs, tar, the
    overlap of a safety-walk belt."""
    way = _distance(world)
    length = g.uniform(12, 40) * np.median(np.diff(way))
    world.scale_friction(1 + 2.5 * size * (way / length % 1 < g.uniform(0.15, 0.35)))


RIG_KINDS = {
    "after_turn": after_turn,
    "tread_blocks": tread_blocks,
    "chatter": chatter,
    "resonance": resonance,
    "quantised": quantised,
    "uneven_lag": uneven_lag,
    "gated_cross": gated_cross,
    "amplifier_limit": amplifier_limit,
    "dead_zone": dead_zone,
    "joints": joints,
}

NEEDS = {
    "after_turn": frozenset({"sweeps"}),
    "uneven_lag": frozenset({"sweeps"}),
    "chatter": frozenset({"sweeps"}),
    "resonance": frozenset({"speeds"}),
    "gated_cross": frozenset({"speeds"}),
    "joints": frozenset({"knee"}),
    "amplifier_limit": frozenset({"loads", "knee"}),
}
"""Properties of a design (``Design.properties``) that a kind needs to have an influence."""
