"""The windows of several logs, and the quantities at their samples on which effects depend."""

from typing import NamedTuple

import jax
import numpy as np

from tirefit.data.motion import Motion
from tirefit.data.vehicle import POSE, Vehicle
from tirefit.diagnosis.effects.state import peak_ratio, slope_at_rest
from tirefit.fitting.source import GivenTire
from tirefit.models import TireInputs
from tirefit.vehicle.effects import Samples
from tirefit.vehicle.shooting import Data

_MOST_SAMPLES = 4000
"""Largest number of samples of all windows, evenly spread."""

LEAST_WINDOWS = 8
"""Smallest number of windows of a diagnosis."""

_VARIES = 0.02
"""Smallest spread of the forward acceleration over g, and of the speed over its mean, that
shows effects of these."""


class Cut(NamedTuple):
    """Windows (w, k) of all logs: :class:`Data`, :class:`Samples` of effects, and the
    log (w,) of each."""

    data: Data
    rows: Samples
    log: np.ndarray


def joined_windows(found, vehicle: Vehicle, tires) -> tuple[Cut, set[str]]:
    """The windows of all logs, and the needs of effects that they meet."""
    data, rows, log = [], [], []
    passed = 0.0
    for number, each in enumerate(found.values()):
        motion, (windows, own) = each.motion, each.windows
        data.append(windows)
        rows.append(samples_of(motion, own, vehicle, tires, passed))
        log.append(np.full(len(own), number))
        passed += float(motion.time[-1] - motion.time[0])
    whole = jax.tree.map(lambda *part: np.concatenate(part), *data)
    joint = jax.tree.map(lambda *part: np.concatenate(part), *rows)
    speed = joint.speed / np.mean(joint.speed)
    joint = joint._replace(speed=speed, time=joint.time / passed - 0.5)
    has = {"heading"} if vehicle.columns.motion == POSE else {"rates"}
    has |= {"acceleration"} if np.std(joint.along) > _VARIES else set()
    has |= {"speeds"} if np.std(speed) > _VARIES else set()
    cut = Cut(whole, joint, np.concatenate(log))
    most = max(_MOST_SAMPLES // speed.shape[1], LEAST_WINDOWS)
    if len(cut.log) > most:
        kept = np.linspace(0, len(cut.log) - 1, most).round().astype(int)
        cut = jax.tree.map(lambda part: part[kept], cut)
    return cut, has


def samples_of(motion: Motion, own, vehicle: Vehicle, tires, passed: float = 0.0) -> Samples:
    """The quantities on which effects depend, at the rows (w, k) of a log. ``across`` and ``turn``
    are zero until they are set from a fit; ``passed`` [s] is the duration of the previous logs."""
    g, count = vehicle.gravity, len(own)
    weight, wheelbase = vehicle.mass * g, vehicle.l_f + vehicle.l_r
    loads = weight * vehicle.l_r / wheelbase, weight * vehicle.l_f / wheelbase
    v_x = motion.v_x[own]
    sliding = [
        _sliding(one, load, float(v_x.mean())) for one, load in zip(tires, loads, strict=True)
    ]
    heading = motion.heading if vehicle.columns.motion == POSE else 0 * motion.time
    return Samples(
        speed=v_x,
        along=motion.a_x[own] / g,
        across=0 * v_x,
        turn=0 * v_x,
        time=passed + motion.time[own] - motion.time[0],
        heading=heading[own],
        weight=np.full(count, weight),
        wheelbase=np.full(count, wheelbase),
        sliding=np.tile(sliding, (count, 1)),
    )


def _sliding(axle: GivenTire, load: float, speed: float) -> float:
    """Slip above which a brush with slope and peak of the tire slides."""
    at_rest = TireInputs(fz=load, v=speed)
    slope = slope_at_rest(axle.tire, at_rest, "y")
    return float(3 * peak_ratio(axle.tire, load, speed) * load / slope)
