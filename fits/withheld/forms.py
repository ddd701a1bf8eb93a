"""Forms of the effects of tire and measurement.

Each takes (world, amplitude, generator) and changes the world; the textbook form of an
effect is the first that ``effects.py`` lists.
"""

import numpy as np

from fits.withheld.patch import lagged, shifted

__all__ = ["NOMINAL_LOAD", "slip_radius"]

NOMINAL_LOAD = 4000.0  # N


# --- pressure ---------------------------------------------------------------


def skewed(world, d, _):
    world.pressure = lambda xi, used: 0.75 * (1 - xi**2) * (1 + d * xi)


def skewed_beta(world, d, _):
    """Beta law of the same first moment, d/5."""
    e = 0.4 * d
    world.pressure = lambda xi, used: (1 + xi) ** (1 + e) * (1 - xi) ** (1 - e)


def skewed_warp(world, d, _):
    """A parabola whose peak is shifted from the centre to 0.4 d."""
    top = 0.4 * d

    def pressure(xi, used):
        ahead = (xi - top) / (1 - top)
        behind = (xi - top) / (1 + top)
        return 1 - np.where(xi > top, ahead, behind) ** 2

    world.pressure = pressure


def quartic_mix(world, w, _):
    w = min(w, 1.0)
    world.pressure = lambda xi, used: (1 - w) * 0.75 * (1 - xi**2) + w * 0.625 * (1 - xi**4)


def power_pressure(world, w, _):
    """1 - |xi|^q, q from 2 (w = 0) to 4 (w = 1)."""
    q = 2 * 2**w
    world.pressure = lambda xi, used: 1 - np.abs(xi) ** q


def sixth_order(world, w, _):
    w = 0.7 * min(w, 1.0)
    world.pressure = lambda xi, used: (1 - w) * 0.75 * (1 - xi**2) + w * 7 / 12 * (1 - xi**6)


def trapezoid(world, w, _):
    """Mixture of the parabola and a trapezoid with ramps of a quarter."""
    w = 0.7 * min(w, 1.0)
    world.pressure = lambda xi, used: (
        (1 - w) * 0.75 * (1 - xi**2) + w * np.minimum((1 - np.abs(xi)) / 0.25, 1) / 1.75
    )


def shift_by_force(world, d, _):
    def shifting(xi, used):
        return 0.75 * (1 - xi**2) * (1 + np.clip(d * used, -0.33, 0.9) * xi)

    world.pressure = shifting


def shift_by_load(world, d, _):
    by_load = np.clip(2 * d * (world.fz / NOMINAL_LOAD - 1), -0.33, 0.9)[:, None]
    world.pressure = lambda xi, used: 0.75 * (1 - xi**2) * (1 + by_load * xi)


# --- friction ---------------------------------------------------------------


def two_frictions(world, m, _):
    world.mu_k = world.mu_k * (1 - m)


def slip_weakening(world, m, _):
    two_frictions(world, m, _)
    world.weakening = 0.2


def slow_weakening(world, m, _):
    two_frictions(world, 1.3 * m, _)
    world.weakening = 0.5


def _by_speed(world, fall):
    world.scale_friction(np.maximum(1 - fall(world.sliding_speed) / world.mu, 0.1))


def speed_linear(world, n, _):
    _by_speed(world, lambda u: n * u)


def speed_saturating(world, n, _):
    _by_speed(world, lambda u: 1.3 * n * u / (1 + u / 10))


def speed_power(world, n, _):
    _by_speed(world, lambda u: 1.6 * n * u**0.8)


def speed_root(world, e, _):
    """S(37): v_st = 30 m/s, exponent 1/2, 1 - h = 2.5 e."""
    decay = np.exp(-np.sqrt(world.sliding_speed / 30))
    world.scale_friction(1 - 2.5 * e * (1 - decay))


def stribeck(world, e, _):
    world.scale_friction(1 - e * (1 - np.exp(-world.sliding_speed / 2)))


def stribeck_squared(world, e, _):
    world.scale_friction(1 - e * (1 - np.exp(-((world.sliding_speed / 2) ** 2))))


def speed_logarithm(world, e, _):
    world.scale_friction(1 - 0.6 * e * np.log1p(world.sliding_speed))


def _load(world):
    return world.fz / NOMINAL_LOAD


def stiffness_power(world, e, _):
    world.stiffness = world.stiffness * _load(world) ** e


def stiffness_affine(world, e, _):
    world.stiffness = world.stiffness * (1 + e * (_load(world) - 1))


def stiffness_saturating(world, e, _):
    top = 1 + 2 / e
    arc = np.sin(2 * np.arctan(_load(world) / top))
    world.stiffness = world.stiffness * ((1 - e) + e * arc / np.sin(2 * np.arctan(1 / top)))


def friction_power(world, e, _):
    world.scale_friction(_load(world) ** e)


def friction_affine(world, e, _):
    world.scale_friction(1 + e * (_load(world) - 1))


def friction_log_square(world, e, _):
    z = np.log(_load(world))
    world.scale_friction(1 + e * z + 0.3 * e * z**2)


# --- temperature and time ---------------------------------------------------


def _heat(world):
    return (world.temperature - 50) / 20


def friction_heat(world, a, _):
    world.scale_friction(1 + a * _heat(world))


def friction_heat_bell(world, a, _):
    """Friction with a maximum at a temperature off the centre."""
    top = np.sign(a) * 1.5
    world.scale_friction(1 - abs(a) / 3 * ((_heat(world) - top) ** 2 - top**2))


def friction_heat_exponential(world, a, _):
    world.scale_friction(np.exp(a * _heat(world)))


def stiffness_heat(world, a, _):
    world.stiffness = world.stiffness * (1 + a * _heat(world))


def stiffness_heat_exponential(world, a, _):
    world.stiffness = world.stiffness * np.exp(a * _heat(world))


def _elapsed(world):
    span = world.time - world.time.min()
    return span / span.max()


def friction_drift(world, a, _):
    world.scale_friction(1 + a * (_elapsed(world) - 0.5))


def friction_wear_in(world, a, _):
    world.scale_friction(1 + 1.2 * a * (1 - np.exp(-3 * _elapsed(world)) - 0.6))


def friction_root_of_time(world, a, _):
    world.scale_friction(1 + a * (np.sqrt(_elapsed(world)) - 0.5))


def stiffness_drift(world, a, _):
    world.stiffness = world.stiffness * (1 + a * (_elapsed(world) - 0.5))


def stiffness_settling(world, a, _):
    world.stiffness = world.stiffness * (1 + 1.2 * a * (1 - np.exp(-3 * _elapsed(world)) - 0.6))


def road_step(world, a, generator):
    world.scale_friction(1 + a * (_elapsed(world) > generator.uniform(0.25, 0.75)))


def road_blend(world, a, generator):
    at = generator.uniform(0.3, 0.7)
    world.scale_friction(1 + a * (1 + np.tanh((_elapsed(world) - at) / 0.02)) / 2)


def road_stretch(world, a, generator):
    """A different road for a third of the record."""
    at = generator.uniform(0.2, 0.45)
    inside = (_elapsed(world) > at) & (_elapsed(world) < at + 0.35)
    world.scale_friction(1 + a * inside)


# --- direction and sign -----------------------------------------------------


def hysteresis(world, a, _):
    world.scale_friction(1 + a * np.sign(world.loading))


def hysteresis_smooth(world, a, _):
    rate = world.loading
    world.scale_friction(1 + 1.2 * a * np.tanh(rate / (0.7 * np.abs(rate).mean())))


def hysteresis_polarised(world, a, _):
    """The difference grows with the used friction."""
    u = np.minimum(np.abs(world.slip) * world.c / (1.5 * world.mu * world.fz), 1)
    world.scale_friction(1 + 1.2 * a * u * np.sign(world.loading))


def sign_friction(world, a, _):
    world.scale_friction(1 + a / 2 * np.sign(world.slip))


def sign_friction_smooth(world, a, _):
    world.scale_friction(1 + a / 2 * np.tanh(world.slip / 0.02))


def sign_both(world, a, _):
    sign_friction(world, a, _)
    world.stiffness = world.stiffness * (1 + 0.3 * a * np.sign(world.slip))


# --- measurement ------------------------------------------------------------


def slip_zero(world, a, _):
    world.logged.append(lambda w, slip: slip + a)


def slip_radius(world, a, _):
    world.logged.append(lambda w, slip: slip + a * (1 + slip))


def force_zero(world, a, _):
    world.after.append(lambda w, force: force + a * NOMINAL_LOAD)


def force_tare(world, a, _):
    """The zero varies slowly by a fifth around its mean."""
    wander = 1 + 0.2 * np.cos(np.pi * (world.time / world.time.max()))
    world.after.append(lambda w, force: force + a * NOMINAL_LOAD * wander)


def practical_slip(world, a, _):
    world.logged.append(lambda w, slip: slip / (1 + slip))


def inverse_slip(world, a, _):
    """The conversion from kappa to sigma applied to a slip that already is sigma."""
    world.logged.append(lambda w, slip: slip / (1 - slip))


def mean_speed_slip(world, a, _):
    """Sliding speed over the mean of the road's and the wheel's speed."""
    world.logged.append(lambda w, slip: slip / (1 + slip / 2))


def delay(world, a, _):
    world.late.append(lambda w, force: shifted(w, force, a))


def delay_of_filter(world, a, _):
    """Two equal poles after the force, with the same total delay."""
    rate = np.full(len(world.slip), 2 / a)
    world.late.append(lambda w, force: lagged(w, lagged(w, force, rate), rate))


def slip_lag(world, a, _):
    world.slip = lagged(world, world.slip, world.v / a)


def force_lag(world, a, _):
    world.late.append(lambda w, force: lagged(w, force, w.v / a))


def shortening_lag(world, a, _):
    """The relaxation length falls with the sliding part of the patch."""
    u = np.minimum(np.abs(world.slip) * world.c / (1.5 * world.mu * world.fz), 1)
    world.late.append(lambda w, force: lagged(w, force, w.v / (1.4 * a * (1 - 0.8 * u))))


def _spin_up(world):
    speed = world.v / (1 + world.slip)
    out = np.zeros(len(speed))
    for run in np.unique(world.run):
        rows = np.flatnonzero(world.run == run)
        out[rows] = np.gradient(speed[rows], world.time[rows])
    return out


def inertia(world, a, _):
    """``a`` is J/r^2 [kg]: the logged torque over radius lacks J domega/dt / r."""
    world.after.append(lambda w, force: force - a * _spin_up(w))


def inertia_filtered(world, a, _):
    rate = np.full(len(world.slip), 1 / 0.03)
    world.after.append(lambda w, force: force - a * lagged(w, _spin_up(w), rate))


# --- other inputs and structure ---------------------------------------------


def _across(world, a):
    world.cross, world.slides_across = a / 0.05 * world.cross, True


def combined(world, a, _):
    _across(world, a)
    world.bites = True


def combined_stiff(world, a, _):
    combined(world, a, _)
    world.cross_stiffness = 1.3


def combined_ellipse(world, a, _):
    _across(world, a)
    used = 2 * world.c * np.abs(world.cross) / (world.mu * world.fz)
    used = np.minimum(used, 0.95)
    world.after.append(lambda w, force: force * np.sqrt(1 - 0.7 * used**2))


def camber_force(world, a, _):
    world.after.append(lambda w, force: force + a * w.gamma * w.fz)


def camber_angle(world, a, _):
    """Camber acts as an additional slip angle, and saturates with it."""
    world.slip = world.slip + a * world.gamma * world.fz / (2 * world.c)


def camber_half(world, a, _):
    world.after.append(
        lambda w, force: (
            force + a * w.gamma * w.fz * (1 + 0.5 * np.exp(-((w.slip / 0.06) ** 2))) / 1.2
        )
    )


def conicity(world, a, _):
    world.after.append(lambda w, force: force + a * w.fz)


def conicity_square(world, a, _):
    world.after.append(lambda w, force: force + a * w.fz**1.5 / NOMINAL_LOAD**0.5)


def carcass_bow(world, a, _):
    world.carcass = (a / (world.mu * NOMINAL_LOAD), "bow")


def carcass_slip(world, a, _):
    world.carcass = (a / (world.mu * NOMINAL_LOAD), "slip")
