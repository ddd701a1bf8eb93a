"""What is known of a vehicle beforehand: priors of effects that hold its own motion.

A force that was derived from the motion shares its channels with the slip: whatever
contains yaw rate or acceleration may imitate anything, on held-out data too. Such an
effect keeps to the errors of a measured quantity where the file states it, as
``tirefit derive`` writes what vehicle.toml states, and to those of a guess elsewhere.
"""

from typing import NamedTuple

import numpy as np
from scipy.constants import g as GRAVITY

from tirefit.diagnosis.rows.covariates import wheelbase

_HEIGHT = 0.4
"""Height of the centre of gravity over the arm of an axle: cars have 0.3 to 0.6."""

_FAR = 6.0
"""Bounds in standard deviations."""


class _Quantity(NamedTuple):
    """A quantity of the vehicle by its key in vehicle.toml, and its standard error
    where that states it and where nobody does."""

    key: str
    stated: float
    guessed: float
    words: str


_QUANTITIES = {
    # Shares of the arm of an axle (1 mm on a car of 1:10, 4 cm on a car) and of the
    # wheelbase.
    "position": _Quantity("tracked_point", 0.03, 0.1, "the tracked point to {:.2g} m"),
    "clock": _Quantity("clock", 0.005, 0.1, "the clocks of the channels to {:.2g} s"),
    # Shares: the inertia of most vehicle files is estimated.
    "yaw_inertia": _Quantity(
        "yaw_inertia", 0.3, 1.0, "the yaw inertia to {:.2g} of it"
    ),
}
"""Key of ``[vehicle]`` of rig.toml, a standard error -> the quantity that it is of."""


def _error(key: str, prepared, rig) -> tuple[float | None, bool]:
    """Standard error [m, s, share], and whether it or the quantity is stated; None of a
    measured force of which nobody says anything."""
    of, derived, constants = (
        _QUANTITIES[key], prepared.derived, prepared.data.source.constants,
    )  # fmt: skip
    if key in rig.vehicle:
        return rig.vehicle[key], True
    if derived is None:
        return None, False
    stated = of.key in constants
    error = of.stated if stated else of.guessed
    if key == "clock" and stated:
        error = constants[of.key]
    if key == "position":
        error *= derived.arm if stated else wheelbase(prepared.data, derived)
    return error, stated


def _of_scale(prior, scale: float):
    return prior._replace(scale=scale, low=-_FAR * scale, high=_FAR * scale)


def _narrowed(prior, scale: float):
    """The prior, no wider than this scale."""
    own = _of_scale(prior, min(prior.scale, scale))
    return own._replace(low=max(prior.low, own.low), high=min(prior.high, own.high))


def _of_quantity(key: str, prior, prepared, rig):
    error, stated = _error(key, prepared, rig)
    if error is None:
        return prior
    return _narrowed(prior, error) if stated else _of_scale(prior, error)


def of_a_known_position(prior, prepared, rig):
    """A distance along the vehicle, measured with a rule where it is stated."""
    return _of_quantity("position", prior, prepared, rig)


def of_a_known_clock(prior, prepared, rig):
    """A delay between channels of one log."""
    return _of_quantity("clock", prior, prepared, rig)


def of_a_known_inertia(prior, prepared, rig):
    """An error of the yaw inertia over the wheelbase."""
    if prepared.derived is None:
        return prior
    share, _ = _error("yaw_inertia", prepared, rig)
    return _of_scale(prior, share * prepared.derived.inertia)


def of_a_known_height(prior, prepared, rig):
    """A load that moves by m h a_x / wheelbase over the range of a_x."""
    if "a_x" not in prepared.data:
        return prior
    span = float(np.ptp(prepared.column("a_x"))) / GRAVITY
    return _narrowed(prior, _HEIGHT * span)


def of_a_known_force(prior, prepared, rig):
    """A share of the friction that a force across takes: its error, twice for its
    square, is one of the share."""
    name = "fx_std" if prepared.mode == "y" else "fy_std"
    if name not in prepared.data:
        return prior
    size = _rms(np.asarray(prepared.covariates.across))
    error = 2 * prior.center * _rms(prepared.column(name)) / max(size, 1e-300)
    return prior._replace(scale=float(np.hypot(prior.scale, error)))


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
    known: dict[bool, list[str]] = {True: [], False: []}
    for key, of in _QUANTITIES.items():
        error, stated = _error(key, rows, rig)
        guess = "" if stated else f" ({of.key} is not stated: measure it)"
        known[stated].append(of.words.format(error) + guess)
    priors = (
        "effects with yaw rate or acceleration keep to what is known of a vehicle:"
        f" {', '.join(known[True] + known[False])}; [vehicle] of rig.toml states other"
        " standard errors"
    )
    return (said, priors, *_found(rows.data.source.constants))


def _found(constants) -> tuple[str, ...]:
    """What ``tirefit derive`` found in the same logs, beside the effect that it may be
    named as."""
    found = []
    if "alpha_zero" in constants:
        zero = constants["alpha_zero"]
        found.append(f"alpha is {zero:+.4f} rad where fy = 0 (slip_offset)")
    if "found_point" in constants:
        place, stated = constants["found_point"], constants.get("tracked_point")
        against = "" if stated is None else f", stated {stated:.3g} m"
        found.append(
            f"the tracked point is {place:.3g} ± {constants['found_point_std']:.1g} m"
            f" ahead of the rear axle{against} (tracked_point)"
        )
    for key, late in constants.items():
        if key.startswith("late_") and not key.endswith("_std"):
            channel, how = key.removeprefix("late_"), "late" if late > 0 else "early"
            effect = f"{channel}_delay" if channel == "steering" else "channel_delay"
            found.append(
                f"{channel} is {abs(late):.2g} ± {constants[f'{key}_std']:.1g} s {how}"
                f" ({effect})"
            )
    if not found:
        return ()
    said = "; ".join(found)
    return (
        f"tirefit derive found in the same logs, without a tire model: {said}. An"
        " effect in brackets that is not named is within its error, or shows as another"
        " effect",
    )


def _rms(values) -> float:
    return float(np.sqrt(np.mean(values**2)))
