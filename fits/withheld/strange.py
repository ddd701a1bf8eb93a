"""Unlisted effects: disturbances and other tire models that no list of effects has."""

import numpy as np

from fits.withheld.designs import Design
from fits.withheld.patch import World
from fits.withheld.strange_rig import NEEDS, RIG_KINDS

__all__ = ["FOREIGN", "SEALED", "UNLISTED", "suits"]


def _add(world: World, change) -> None:
    world.after.append(lambda w, force: force + w.mu * w.fz * change(w))


def ripple(world, size, g):
    wave, phase = g.uniform(0.04, 0.08), g.uniform(0, 6)
    _add(world, lambda w: size * np.sin(2 * np.pi * w.slip / wave + phase))


def periodic(world, size, g):
    period = np.ptp(world.time) / g.uniform(6, 14)
    phase = g.uniform(0, 6)
    _add(world, lambda w: size * np.sin(2 * np.pi * w.time / period + phase))


def bump(world, size, g):
    at, load = g.uniform(0.2, 0.8), float(g.choice(world.fz))

    def change(w):
        near = (np.abs(w.slip) / np.abs(w.slip).max() - at) / 0.08
        heavy = (w.fz - load) / 1200
        return 2 * size * np.exp(-(near**2 + heavy**2) / 2)

    _add(world, change)


def gated(world, size, g):
    """A step of the force above a slip and, if there are several loads, above a load."""
    gate = np.median(world.fz) * 1.01 if np.ptp(world.fz) > 0 else 0.0
    from_slip = g.uniform(0.3, 0.6) * np.abs(world.slip).max()
    _add(world, lambda w: size * (w.fz > gate) * (np.abs(w.slip) > from_slip) * np.sign(w.slip))


def magic_formula(world, _, g):
    """S(16) with load-dependent peak and stiffness."""
    shape, bend = g.uniform(1.3, 1.8), g.uniform(-1, 0.6)
    peak, stiff = g.uniform(-0.15, -0.05), g.uniform(0.2, 0.6)

    def replace(w, _):
        excess = w.fz / 4000 - 1
        top = w.mu * (1 + peak * excess) * w.fz
        slope = 2 * w.c * (1 + stiff * excess)
        bx = slope / (shape * top) * w.slip
        return top * np.sin(shape * np.arctan(bx - bend * (bx - np.arctan(bx))))

    world.after.append(replace)


def lugre(world, _, g):
    """S(18), steady, with the Stribeck curve g of S(17c) over the sliding speed."""
    ratio, knee = g.uniform(1.15, 1.5), g.uniform(2, 6)
    length = 0.2

    def replace(w, _):
        sliding = np.maximum(w.sliding_speed, 1e-6)
        slip = np.maximum(np.abs(w.slip), 1e-9)
        level = w.mu * (1 + (ratio - 1) * np.exp(-np.sqrt(sliding / knee)))
        # Slope at zero slip: F_z sigma0 L / 2 = 2 c at the nominal load.
        sigma0 = 4 * w.c / (4000.0 * length)
        z = sigma0 * length * slip / level
        return np.sign(w.slip) * w.fz * level * (1 + np.expm1(-z) / z)

    world.after.append(replace)


UNLISTED = {"ripple": ripple, "periodic": periodic, "bump": bump, "gated": gated, **RIG_KINDS}
SEALED = ("dead_zone", "joints", "amplifier_limit", "uneven_lag", "gated_cross")
"""Kinds that are never used in development."""

FOREIGN = {"magic_formula": magic_formula, "lugre": lugre}


def suits(kind: str, design: Design) -> bool:
    """Whether a kind of unlisted effect has an influence in a design."""
    return NEEDS.get(kind, frozenset()) <= design.properties
