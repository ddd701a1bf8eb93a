"""What is known of a vehicle beforehand: priors of effects that hold its own motion.

A force that was derived from the motion shares its channels with the slip: whatever
contains yaw rate or acceleration may imitate anything, on held-out data too. Such an
effect keeps to the errors that a vehicle may have: millimetres, milliseconds.
"""

import numpy as np
from scipy.constants import g as GRAVITY

_POSITION = 0.03
"""Error of the place of the tracked point, as a share of the arm of the axle: 1 mm on a
car of 1:10, 4 cm on a car."""

_CLOCK = 0.005  # s
"""Error of the time between two channels of one log."""

_INERTIA = 0.3
"""Error of a yaw inertia that was estimated, as a share of it."""

_HEIGHT = 0.4
"""Height of the centre of gravity over the arm of an axle: cars have 0.3 to 0.6."""

_FAR = 6.0
"""Bounds in standard deviations."""


def _narrowed(prior, scale: float):
    """The prior, no wider than this scale."""
    scale = min(prior.scale, scale)
    low, high = max(prior.low, -_FAR * scale), min(prior.high, _FAR * scale)
    return prior._replace(scale=scale, low=low, high=high)


def position_error(prepared, rig) -> float | None:
    """Standard error [m] of the tracked point; None where nothing is known."""
    if "position" in rig.vehicle:
        return rig.vehicle["position"]
    return None if prepared.derived is None else _POSITION * prepared.derived.arm


def clock_error(prepared, rig) -> float | None:
    """Standard error [s] of the time between slip and force."""
    if "clock" in rig.vehicle:
        return rig.vehicle["clock"]
    return None if prepared.derived is None else _CLOCK


def _inertia_error(rig) -> float:
    """Standard error of the yaw inertia as a share of it."""
    return rig.vehicle.get("yaw_inertia", _INERTIA)


def of_a_known_position(prior, prepared, rig):
    """A distance along the vehicle, measured with a rule."""
    error = position_error(prepared, rig)
    return prior if error is None else _narrowed(prior, error)


def of_a_known_clock(prior, prepared, rig):
    """A delay between channels of one log."""
    error = clock_error(prepared, rig)
    return prior if error is None else _narrowed(prior, error)


def of_a_known_inertia(prior, prepared, rig):
    """An error of the yaw inertia over the wheelbase."""
    if prepared.derived is None:
        return prior
    scale = _inertia_error(rig) * prepared.derived.inertia
    return prior._replace(scale=scale, low=-_FAR * scale, high=_FAR * scale)


def of_a_known_height(prior, prepared, rig):
    """A load that moves by m h a_x / wheelbase over the range of a_x."""
    if "a_x" not in prepared.data:
        return prior
    span = float(np.ptp(prepared.column("a_x"))) / GRAVITY
    return _narrowed(prior, _HEIGHT * span)


def said_of_motion(base, rig) -> tuple[str, ...]:
    """What follows for the reader of a force that was derived from the motion; nothing
    of one that was measured.

    Args:
        base: the base fit (:class:`tirefit.diagnosis.evidence.base.Base`).
        rig: what is known.
    """
    rows, derived = base.rows, base.rows.derived
    if derived is None:
        return ()
    observed = rows.observed["fy"]
    missed = observed - base.forces(base.as_given, base.amplitudes())["fy"]
    said = (
        f"fy was derived from a_y ({derived.mass:.4g} kg of it) and yaw_acceleration:"
        " it shares its channels with the slip, and so does held-out data"
    )
    if "yaw_rate" in rows.has and derived.mass is not None:
        on_a_path = derived.mass * rows.column("v") * rows.column("yaw_rate")
        said += (
            "; no tire at all, mass x v x yaw_rate, misses it by"
            f" {_rms(observed + on_a_path):.3g} N rms, the base fit by"
            f" {_rms(missed):.3g} N"
        )
    # Of a derived force both are known.
    position, clock = position_error(rows, rig) or 0.0, clock_error(rows, rig) or 0.0
    known = (
        f"effects with yaw rate or acceleration keep to what is known of a vehicle:"
        f" {1e3 * position:.2g} mm, {1e3 * clock:.2g} ms,"
        f" {100 * _inertia_error(rig):.0f} % of the yaw inertia ([vehicle] of rig.toml"
        " states other standard errors)"
    )
    return (said, known)


def _rms(values) -> float:
    return float(np.sqrt(np.mean(values**2)))
