"""The motion of a vehicle as the diagnosis sees it, and forces that follow from it."""

from typing import NamedTuple

import numpy as np

from tirefit.data.table import TireData

GRAVITY = 9.80665  # m/s^2

_EXACT = 1e-3
"""What a force that was derived from two accelerations misses them by, at most, as a
share of its spread: no transducer agrees with another so well."""

_TURNS = 1e-3
"""Standard deviation of an angle [rad] that counts as varying."""

_ROUND = 0.5
"""Standard deviations of the sine and the cosine of the headings, added, from which a
log points several ways; all of them alike give 1.4."""


class Derived(NamedTuple):
    """A force that was derived from the motion of the vehicle.

    ``mass`` [kg] is what it has of the lateral acceleration, ``inertia`` [kg m] of the
    yaw acceleration (the yaw inertia over the wheelbase), ``steered`` whether it stands
    across road wheels that steer.
    """

    mass: float
    inertia: float
    steered: bool

    @property
    def arm(self) -> float:
        """Length [m] of the vehicle: about the arm of the axle."""
        return self.inertia / self.mass


def derived_from(data: TireData, channel: str) -> Derived | None:
    """How a lateral force follows from the accelerations of the file, if it does.

    A force that was measured has a noise of its own; one that was derived is
    -(mass a_y + inertia r') to the last digit written.
    """
    needed = ("a_y", "yaw_acceleration")
    if channel != "fy" or any(name not in data for name in needed):
        return None
    motion = np.stack([data.usable(name) for name in needed], axis=1)
    if np.linalg.matrix_rank(motion - motion.mean(axis=0)) < motion.shape[1]:
        return None
    force, across = data.usable(channel), []
    if "steering" in data:
        angle = data.usable("steering")
        across.append(force * np.cos(angle))
        if "fx" in data:  # of an axle that drives
            across.append(across[0] + data.usable("fx") * np.sin(angle))
    best = None
    for ahead in (force, *across):
        share = np.linalg.lstsq(motion, ahead)[0]
        missed = float(np.std(ahead - motion @ share) / np.std(ahead))
        if missed < _EXACT and (best is None or missed < best[0]):
            mass, inertia = np.abs(share)
            best = missed, Derived(float(mass), float(inertia), ahead is not force)
    return None if best is None else best[1]


_RADIUS = 0.15
"""Radius of a wheel over the wheelbase: 0.11 of cars, 0.15 to 0.19 of models."""


def wheel_radius(data: TireData, derived: Derived | None) -> float:
    """Radius of the wheel [m] as a derived file states it, else by its wheelbase; zero
    where neither is known."""
    stated = data.source.constants
    if "wheel_radius" in stated:
        return stated["wheel_radius"]
    return _RADIUS * wheelbase(data, derived) if derived else 0.0


def wheelbase(data: TireData, derived: Derived) -> float:
    """Of the vehicle [m]: stated, or about twice the arm of an axle."""
    return data.source.constants.get("wheelbase", 2 * derived.arm)


def motion_of(data: TireData) -> dict[str, np.ndarray]:
    """Covariates that the columns of the motion give, zero where one lacks: (n,)."""

    def column(name):
        return data.usable(name) if name in data else np.zeros(data.n)

    return {
        "swing": column("yaw_acceleration"),
        "heading": column("heading"),
        "lean": column("a_y") / GRAVITY,
        "steering": column("steering"),
    }


def seen_in_motion(data: TireData, derived: Derived | None) -> dict[str, bool]:
    """Which needs of the effects of a vehicle these data meet."""

    def varies(name, least=0.0):
        return name in data and bool(np.std(data.usable(name)) > least)

    turned = data.usable("heading") if "heading" in data else np.zeros(data.n)
    spread = np.std(np.cos(turned)) + np.std(np.sin(turned))
    return {
        "derived force": derived is not None,
        "yaw_acceleration": varies("yaw_acceleration"),
        "heading": bool(spread > _ROUND),
        "a_y": varies("a_y"),
        "steering": varies("steering", _TURNS) and (derived is None or derived.steered),
    }
