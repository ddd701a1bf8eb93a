"""Forms of the effects of sensors, rigs, vehicles and the tire's unmeasured temperature.

As in ``forms.py``: (world, amplitude, generator) -> None, the textbook form first.
"""

import numpy as np

from fits.withheld.forms import NOMINAL_LOAD
from fits.withheld.patch import World, plain_brush

__all__ = ["WORK_FORGOTTEN"]

WORK_FORGOTTEN = 0.25  # of the record
SPEED = 15.0  # m/s


def _elapsed(world: World) -> np.ndarray:
    span = world.time - world.time.min()
    return span / span.max()


# --- drifting zeros ---------------------------------------------------------


def slip_zero_creeps(world, a, _):
    world.logged.append(lambda w, slip: slip + a * (_elapsed(w) - 0.5))


def slip_zero_settles(world, a, _):
    world.logged.append(lambda w, slip: slip + 1.2 * a * (0.6 - np.exp(-3.5 * _elapsed(w))))


def slip_zero_turns(world, a, _):
    """Half a cosine: constant at both ends of the record."""
    world.logged.append(lambda w, slip: slip - a / 2 * np.cos(np.pi * _elapsed(w)))


def force_zero_creeps(world, a, _):
    world.after.append(lambda w, force: force + a * NOMINAL_LOAD * (_elapsed(w) - 0.5))


def force_zero_settles(world, a, _):
    world.after.append(
        lambda w, force: force + 1.2 * a * NOMINAL_LOAD * (0.6 - np.exp(-3.5 * _elapsed(w)))
    )


def force_zero_root(world, a, _):
    world.after.append(lambda w, force: force + a * NOMINAL_LOAD * (np.sqrt(_elapsed(w)) - 0.6))


# --- crosstalk --------------------------------------------------------------


def load_leaks(world, a, _):
    world.after.append(lambda w, force: force + a * w.fz)


def load_leaks_evenly(world, a, _):
    """Less than proportional: rolling resistance at the usual pressures of a rig."""
    world.after.append(lambda w, force: force + a * NOMINAL_LOAD**0.2 * w.fz**0.8)


def load_leaks_more(world, a, _):
    world.after.append(lambda w, force: force + a * w.fz**1.5 / NOMINAL_LOAD**0.5)


def load_zero(world, a, _):
    world.load = world.fz + a * NOMINAL_LOAD


def load_zero_bent(world, a, _):
    """The zero offset falls with the load."""
    world.load = world.fz + a * NOMINAL_LOAD * (1.3 - 0.3 * world.fz / NOMINAL_LOAD)


def load_zero_and_gain(world, a, _):
    world.load = 1.01 * world.fz + a * NOMINAL_LOAD


def across_leaks(world, a, _):
    world.after.append(lambda w, force: force + a * w.across)


def across_leaks_bent(world, a, _):
    """Grows faster than the force: the balance deflects."""
    most = np.abs(world.across).max()
    world.after.append(
        lambda w, force: force + a * w.across * (0.7 + 0.4 * np.abs(w.across) / most)
    )


def _ways(world: World) -> np.ndarray:
    """Sign of the rate of the slip, within runs."""
    return np.sign(world.loading) * np.sign(world.slip)


def dry_friction(world, a, _):
    world.after.append(lambda w, force: force + a * NOMINAL_LOAD * _ways(w))


def dry_friction_smooth(world, a, _):
    rate = world.loading * np.sign(world.slip)
    soft = np.tanh(rate / (0.5 * np.abs(rate).mean()))
    world.after.append(lambda w, force: force + 1.1 * a * NOMINAL_LOAD * soft)


def dry_friction_grows(world, a, _):
    """The friction of the guides grows with the force."""

    def change(w, force):
        pressed = 0.5 + np.abs(force) / np.abs(force).max()
        return force + a * NOMINAL_LOAD * pressed * _ways(w)

    world.after.append(change)


# --- the slip of a vehicle --------------------------------------------------


def slip_follows_load(world, a, _):
    world.logged.append(lambda w, slip: slip + a * (w.fz / NOMINAL_LOAD - 1))


def radius_under_load(world, a, _):
    """The slip is computed with the radius at the usual load."""
    world.logged.append(lambda w, slip: (1 + slip) * (1 + a * (w.fz / NOMINAL_LOAD - 1)) - 1)


def radius_root_of_load(world, a, _):
    world.logged.append(lambda w, slip: slip + 2 * a * (np.sqrt(w.fz / NOMINAL_LOAD) - 1))


def slip_follows_speed(world, a, _):
    world.logged.append(lambda w, slip: slip + a * (w.v / SPEED - 1))


def radius_by_spinning(world, a, _):
    """A belt that grows with the square of its speed."""
    world.logged.append(lambda w, slip: slip + 0.5 * a * ((w.v / SPEED) ** 2 - 1))


def radius_saturating(world, a, _):
    world.logged.append(lambda w, slip: slip + 2 * a * (np.tanh(w.v / (2 * SPEED)) - 0.46))


def speed_is_off(world, a, _):
    world.logged.append(lambda w, slip: slip + a / w.v)


def speed_is_off_of_wheel(world, a, _):
    """(v + a) / (omega R) - 1."""
    world.logged.append(lambda w, slip: (1 + slip) * (1 + a / w.v) - 1)


def speed_is_off_when_slow(world, a, _):
    world.logged.append(lambda w, slip: slip + 1.2 * a / np.hypot(w.v, 3.0))


def drag_of_bearings(world, a, _):
    world.after.append(lambda w, force: force + a * NOMINAL_LOAD * w.v / SPEED)


def drag_of_air(world, a, _):
    world.after.append(lambda w, force: force + 0.5 * a * NOMINAL_LOAD * (w.v / SPEED) ** 2)


def drag_of_both(world, a, _):
    world.after.append(lambda w, force: force + 0.7 * a * NOMINAL_LOAD * (w.v / SPEED) ** 1.5)


def _taken(world: World) -> np.ndarray:
    return np.abs(world.across) / (world.mu * world.fz)


def friction_ellipse(world, a, _):
    world.scale_friction(np.sqrt(1 - np.minimum(a * _taken(world) ** 2, 0.9)))


def friction_ellipse_of_force(world, a, _):
    """Also scales the whole force, as vehicle models do."""
    left = np.sqrt(1 - np.minimum(a * _taken(world) ** 2, 0.9))
    world.after.append(lambda w, force: force * (0.4 + 0.6 * left))
    world.scale_friction(0.5 + 0.5 * left)


def friction_superellipse(world, a, _):
    left = 1 - np.minimum(a * _taken(world) ** 2.5, 0.9)
    world.scale_friction(left ** (1 / 2.5))


# --- the tire's condition ---------------------------------------------------


def _inflated(world: World) -> np.ndarray:
    """Relative deviation of the inflation from its usual value, in units of a rig's range."""
    return (world.inflation / 2.2e5 - 1) / 0.4


def friction_inflated(world, a, _):
    world.scale_friction(1 + a * _inflated(world))


def friction_inflated_power(world, a, _):
    world.scale_friction((world.inflation / 2.2e5) ** (2.5 * a))


def friction_inflated_bell(world, a, _):
    p = _inflated(world)
    world.scale_friction(1 + a * (p - 0.4 * p**2))


def stiffness_inflated(world, a, _):
    world.stiffness = world.stiffness * (1 + a * _inflated(world))


def stiffness_inflated_power(world, a, _):
    world.stiffness = world.stiffness * (world.inflation / 2.2e5) ** (2.5 * a)


def stiffness_inflated_saturating(world, a, _):
    world.stiffness = world.stiffness * (1 + 0.9 * a * np.tanh(1.6 * _inflated(world)))


def _work(world: World, lasts: float | None) -> np.ndarray:
    """Accumulated work of sliding, scaled to a range of one; it decays over ``lasts``."""
    force = plain_brush(world.slip, world.fz, world.c, world.mu)[0]
    power = np.abs(force) * world.sliding_speed
    out, warmth, elapsed = np.zeros(len(power)), 0.0, _elapsed(world)
    for k in range(1, len(power)):
        step = elapsed[k] - elapsed[k - 1]
        fade = 1.0 if lasts is None else np.exp(-step / lasts)
        paused = world.run[k] != world.run[k - 1]
        warmth = fade * warmth + (0.0 if paused else step * power[k])
        out[k] = warmth
    return (out - out.mean()) / np.ptp(out)


def friction_worked(world, a, _):
    world.scale_friction(1 + a * _work(world, None))


def friction_worked_cooling(world, a, _):
    world.scale_friction(1 + a * _work(world, WORK_FORGOTTEN))


def friction_worked_exponential(world, a, _):
    world.scale_friction(np.exp(a * _work(world, 0.5 * WORK_FORGOTTEN)))


def stiffness_worked(world, a, _):
    world.stiffness = world.stiffness * (1 + a * _work(world, None))


def stiffness_worked_cooling(world, a, _):
    world.stiffness = world.stiffness * (1 + a * _work(world, WORK_FORGOTTEN))


def stiffness_worked_exponential(world, a, _):
    world.stiffness = world.stiffness * np.exp(a * _work(world, 0.5 * WORK_FORGOTTEN))


def stiffness_rolled(world, a, _):
    world.stiffness = world.stiffness * (world.v / SPEED) ** a


def stiffness_rolled_evenly(world, a, _):
    world.stiffness = world.stiffness * (1 + 0.8 * a * (world.v / SPEED - 1))


def stiffness_rolled_logarithm(world, a, _):
    world.stiffness = world.stiffness * (1 + a * np.log1p(world.v / 5) - 1.4 * a)
