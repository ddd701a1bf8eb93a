"""A figure for each effect of a car: without it, with it, and the difference.

A simulated car follows the same steering and speed without and with the effect, by the
program of `tirefit diagnose --vehicle`.
"""

import jax
import jax.numpy as jnp
import numpy as np
from effect_figures import picture

from tirefit.diagnosis.effects import atoms_of
from tirefit.models import Brush
from tirefit.report.diagnosis.words import name_of
from tirefit.vehicle.car import Car
from tirefit.vehicle.effects import CAR_EFFECTS, Samples
from tirefit.vehicle.model import Model
from tirefit.vehicle.shooting import Data
from tirefit.vehicle.subject import Windows
from tirefit.vehicle.windows import JoinedWindows

STEP, LENGTH, LEAD = 0.02, 8.0, 0.3
"""Time between samples, length of the drive, and of the steering before it [s]."""
GRAVITY = 9.81
CAR = Car(Brush(7.5e4, mu=0.9), Brush(8.5e4, mu=0.9), 1500.0, 2500.0, 1.2, 1.4, GRAVITY)
SLIDING = 0.12
"""Slip angle [rad] at which these tires slide, about."""
AIM, SIZES = 0.15, (0.3, 3.0)
"""Change of the motion (rms, over that of the motion) that a figure aims at, and the range of
its amplitude in standard deviations of the prior."""
LEAST = 0.03
"""Change of the yaw rate below which a figure shows the speed to the left instead."""
SHOWN = (("speed to the left", "m/s"), ("yaw rate", "rad/s"))


def _drive():
    """Windows of one drive that turns to both sides, speeds up and brakes."""
    time = np.arange(0, LENGTH + STEP / 2, STEP)
    early = np.arange(-LEAD, LENGTH + STEP / 2, STEP)
    speed = 17 + 5 * np.sin(0.8 * time)
    steer = 0.045 * np.sin(1.7 * early) * np.clip(1 + early / 4, 0, None) ** 0.5
    steer = steer * (early > 0) + 0.01 * (early > 0)
    atoms = atoms_of(CAR_EFFECTS)
    model = Model(atoms, tuple(a.effect.scale for a in atoms), 2)
    none = 0 * time
    rows = Samples(
        speed=speed / speed.mean(),
        along=np.gradient(speed, STEP) / GRAVITY,
        across=none,
        turn=none,
        time=time / LENGTH - 0.5,
        heading=none,
        weight=np.float64(float(CAR.mass) * GRAVITY),
        wheelbase=np.float64(float(CAR.l_f) + float(CAR.l_r)),
        sliding=np.full(2, SLIDING),
    )
    data = Data(speed, steer, np.zeros((len(time), 2)), np.zeros(2), std=np.ones(2))
    cut = JoinedWindows(
        *(jax.tree.map(lambda x: jnp.asarray(x)[None], x) for x in (data, rows)), np.zeros(1)
    )
    drive = Windows(model, CAR, cut, STEP, (), np.ones(2))
    for _ in range(2):  # acceleration, yaw rate and heading are those of the drive itself
        found = drive.linear(np.zeros(model.size), data.start[None])
        rows = drive.cut.rows._replace(
            across=found.lateral / GRAVITY,
            turn=found.states.yaw_rate / speed,
            heading=np.cumsum(found.states.yaw_rate, axis=1) * STEP,
        )
        drive = Windows(model, CAR, cut._replace(rows=rows), STEP, (), np.ones(2))
    return time, drive


def figures():
    """Effect id -> (PNG, amplitude that it shows), of every effect of a car."""
    jax.config.update("jax_enable_x64", True)
    time, drive = _drive()
    plain = _logged(drive)
    found = {}
    for k, atom in enumerate(drive.atoms):
        effect = atom.effect
        if effect.id not in found:
            once = max(_moved(plain, _logged(drive, k, 1.0)))
            size = min(float(np.clip(AIM / once, *SIZES)), effect.bounds[0][1] / effect.scale)
            changed = _logged(drive, k, size)
            found[effect.id] = (_draw(effect.id, time, plain, changed), size * effect.scale)
    return found


def _logged(drive, atom=None, size=0.0):
    """Channels of the log (2, k), with an effect of a size if one is named."""
    given = ((), ()) if atom is None else ([atom], [size])
    z = drive.coefficients((), *given)
    return drive.linear(z, np.zeros((1, 2))).missed[0].T


def _moved(plain, changed):
    """Change of each channel (rms), over that of the channel."""
    return np.sqrt(np.mean((changed - plain) ** 2, axis=1) / np.mean(plain**2, axis=1))


def _draw(effect, time, plain, changed):
    k = int(_moved(plain, changed)[1] > LEAST)
    label, unit = SHOWN[k]
    return picture(
        name_of(effect),
        [(time, one[k]) for one in (plain, changed)],
        ("time [s]", f"{label} [{unit}]"),
        [(time, changed[k] - plain[k], "")],
        ("time [s]", f"difference [{unit}]"),
        "-",
    )
