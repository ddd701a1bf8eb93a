"""Random unlisted effects: a random function of a random quantity changes a parameter.

A fixed list of unlisted effects would soon be known to the developer. Here quantity,
parameter and shape are drawn. The shape has kinks, steps, waves or a local bump that no
listed formula has; a monotonic shape is used only with quantities on which no textbook
makes that parameter depend.
"""

from collections.abc import Callable

import numpy as np

from fits.withheld.patch import World

__all__ = ["PARAMETERS", "QUANTITIES", "SHAPES", "procedural", "varying"]


def _spread(values: np.ndarray) -> np.ndarray:
    """The values scaled to 0 to 1 over the rows."""
    return (values - values.min()) / max(np.ptp(values), 1e-12)


def _distance(world: World) -> np.ndarray:
    steps = np.diff(world.time, prepend=world.time[0])
    return np.cumsum(world.v * np.minimum(steps, 5 * np.median(steps)))


def _share(world: World) -> np.ndarray:
    """Friction used by a rigid brush, 0 to 1."""
    full = 1.5 * world.mu * world.fz / world.c
    return 1 - (1 - np.minimum(np.abs(world.slip) / full, 1)) ** 3


QUANTITIES: dict[str, Callable[[World], np.ndarray]] = {
    "slip": lambda w: np.abs(w.slip),
    "signed slip": lambda w: w.slip,
    "used friction": _share,
    "load": lambda w: w.fz,
    "speed": lambda w: w.v,
    "time": lambda w: w.time,
    "distance": _distance,
}
"""Quantities on which the change may depend, if they vary in the design."""


def _smooth(u, g):
    """A sum of three waves."""
    wave = g.uniform(0.5, 2.5, 3)
    phase, weight = g.uniform(0, 2 * np.pi, 3), g.normal(size=3)
    return np.sin(2 * np.pi * u[:, None] * wave + phase) @ weight


def _kinked(u, g):
    knots = np.sort(np.concatenate([[0, 1], g.uniform(0.15, 0.85, 2)]))
    return np.interp(u, knots, np.cumsum(g.choice([-1, 1]) * np.array([0, 1, -1.6, 1])))


def _threshold(u, g):
    return np.where(u > g.uniform(0.3, 0.7), 1.0, 0.0)


def _periodic(u, g):
    return np.sin(2 * np.pi * u * g.uniform(3, 12) + g.uniform(0, 6))


def _local(u, g):
    return np.exp(-(((u - g.uniform(0.2, 0.8)) / g.uniform(0.04, 0.12)) ** 2) / 2)


SHAPES: dict[str, Callable] = {
    "smooth": _smooth,
    "kinked": _kinked,
    "threshold": _threshold,
    "periodic": _periodic,
    "local": _local,
}
"""Functions of (values from 0 to 1, generator) that give a shape of any scale."""


def _stiffness(world, change):
    world.stiffness = world.stiffness * np.maximum(1 + 0.35 * change, 0.2)


def _friction(world, change):
    world.scale_friction(np.maximum(1 + 0.15 * change, 0.2))


def _force(world, change):
    world.after.append(lambda w, force: force + 0.05 * w.mu * w.fz * change)


def _slip(world, change):
    world.slip = world.slip + 0.006 * change


PARAMETERS: dict[str, Callable] = {
    "stiffness": _stiffness,
    "friction": _friction,
    "force": _force,
    "slip": _slip,
}
"""Functions of (world, change) that apply a change; 1 is 35 % of the stiffness, 15 % of
the friction, 5 % of the largest force, 0.006 of the slip."""

# Textbook dependences (parameter, quantity): a threshold or a smooth bend is a form of a
# listed effect there, and only shapes that rise and fall are unlisted.
_KNOWN = {
    ("friction", "load"), ("stiffness", "load"), ("friction", "speed"),
    ("friction", "time"), ("stiffness", "time"), ("friction", "signed slip"),
    ("force", "slip"), ("force", "used friction"), ("slip", "used friction"),
    ("friction", "slip"), ("friction", "used friction"), ("stiffness", "slip"),
    ("stiffness", "used friction"), ("slip", "slip"), ("force", "signed slip"),
    ("slip", "signed slip"), ("friction", "distance"), ("stiffness", "distance"),
    ("force", "load"), ("slip", "load"), ("force", "time"), ("slip", "time"),
}  # fmt: skip
_UP_AND_DOWN = ("kinked", "periodic", "local")

# A local change in the record is a different road for a while: a form of friction_step.
_STRETCHES = {("friction", "time"), ("friction", "distance")}


def _strange_shapes(parameter: str, quantity: str) -> list[str]:
    """Shapes with which no textbook makes the parameter depend on the quantity."""
    dependence = parameter, quantity
    shapes = _UP_AND_DOWN if dependence in _KNOWN else SHAPES
    known = {"local"} if dependence in _STRETCHES else set()
    return [shape for shape in shapes if shape not in known]


def varying(world: World) -> list[str]:
    """Quantities that take more than eight values."""
    return [name for name, q in QUANTITIES.items() if len(np.unique(q(world))) > 8]


def procedural(world: World, size: float, g, varies: list[str] | None = None) -> str:
    """Applies a random unlisted effect to the world and returns its description.

    Args:
        size: of the change, in the units of :data:`PARAMETERS`.
        varies: quantities to choose from; those that vary by default.
    """
    varies = varies or varying(world)
    quantity = str(g.choice(varies))
    parameter = str(g.choice(list(PARAMETERS)))
    shape = str(g.choice(_strange_shapes(parameter, quantity)))
    change = SHAPES[shape](_spread(QUANTITIES[quantity](world)), g)
    change = change - np.median(change)
    change = change / max(np.abs(change).max(), 1e-9)
    second = ""
    several = [name for name in varies if name != quantity]
    if several and g.uniform() < 0.3:
        second = str(g.choice(several))
        gate = _spread(QUANTITIES[second](world)) > g.uniform(0.3, 0.6)
        change = change * gate
    if parameter == "force" and quantity in ("slip", "used friction"):
        change = change * np.sign(world.slip)
    PARAMETERS[parameter](world, size * change)
    return f"{parameter} by {shape} of {quantity}" + (second and f", gated by {second}")
