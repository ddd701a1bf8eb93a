"""Measures a world: noise, the columns of the file, the truth and the gap."""

import numpy as np

from fits.withheld.forms import slip_radius
from fits.withheld.library import Inputs, base_fit, mimic_free
from fits.withheld.patch import World, forces, plain_brush

__all__ = ["NOISE", "logged_slip", "measure"]

RADIUS = 0.3  # m, as stated in every rig.toml
NOISE = {"rig": (0.001, 0.01, 0.001), "seed": (0.2e-4**0.5, 0.2e-2**0.5, 0.004)}
"""Standard deviations: slip, force and moment [m] as shares of the load."""


def measure(world: World, noise: str, law: str, extras: set[str], g) -> tuple:
    """Columns of the file, the noise-free truth, and the numbers of the gap.

    ``law`` is the law of the noise (``disturbed``), ``extras`` are additional columns, ``g``
    is the random generator.
    """
    fz, name, n = world.fz, world.force, len(world.fz)
    slip_std, share, moment = NOISE[noise]
    clean = forces(world)
    logged = logged_slip(world)
    measured = logged + slip_std * g.normal(size=n)
    columns = {"time": world.time}
    columns |= {"sigma_x": measured} if name == "fx" else {"alpha": np.arctan(measured)}
    for channel, level in ((name, share), ("mz", moment)):
        if channel in clean:
            wrong = disturbed(law, n, clean[channel], g)
            columns[channel] = clean[channel] + level * fz * wrong
    columns |= {"fz": fz, "v": world.v}
    across = "fy" if name == "fx" else "fx"
    for key in sorted(extras):
        columns[across if key == "across" else key] = _extra(world, key, g)
    # The truth is taken at the measured slip, so that slip noise is no gap.
    plain = plain_brush(logged, fz, world.c, world.mu)
    moved = plain_brush(measured, fz, world.c, world.mu)
    truth = {name: clean[name] + moved[0] - plain[0]}
    if world.moment:
        truth["mz"] = clean["mz"] + moved[1] - plain[1]
    return columns, truth, _gap(world, clean, logged, noise, extras)


def logged_slip(world: World) -> np.ndarray:
    slip = world.sensed
    for change in world.logged:
        slip = change(world, slip)
    return slip


def _extra(world: World, column: str, g) -> np.ndarray:
    if column == "omega":  # with the stated radius; a wrong one changes the slip as well
        slip = world.sensed
        for change in world.logged:
            if slip_radius.__name__ in change.__qualname__:
                slip = change(world, slip)
        return world.v / (RADIUS * (1 + slip))
    if column == "alpha":
        cross = world.cross * (1 if world.slides_across else 0.05)
        return np.arctan(cross / (1 + world.sensed))  # S Table 1
    if column == "pressure":
        return world.inflation
    if column == "across":
        return world.across + 0.01 * world.fz * g.normal(size=len(world.time))
    if column == "temperature":
        return world.temperature + 0.3 * g.normal(size=len(world.time))
    return world.gamma


def _gap(world, clean, logged, noise, extras) -> dict:
    """Gap of the best plain brush: sqrt(lambda) in standard errors, rms [N], and rms
    in standard deviations of the noise (including that of the slip)."""
    slip_std, share, moment = NOISE[noise]
    x = Inputs(
        world.time,
        world.run,
        logged,
        world.fz,
        world.v,
        world.force,
        (slip_std, share * world.fz, moment * world.fz),
        cross=world.cross if "alpha" in extras else None,
        gamma=world.gamma if "gamma" in extras else None,
        temperature=world.temperature if "temperature" in extras else None,
        inflation=world.inflation if "pressure" in extras else None,
        across=world.across if "across" in extras else None,
        omega="omega" in extras,
        moment=world.moment,
    )
    parts = [clean[world.force], *([clean["mz"]] if world.moment else [])]
    best, misses, std = base_fit(x, np.concatenate(parts), world.c, world.mu)
    n = len(logged)
    return {
        "root_lambda": round(float(np.linalg.norm(misses)), 3),
        "gap_over_noise": round(float(np.sqrt(np.mean(misses**2))), 4),
        "gap_rms": round(float(np.sqrt(np.mean((misses * std)[:n] ** 2))), 3),
        "base_fit": [round(float(value), 4) for value in best],
        "free": lambda gone: mimic_free(x.without(gone), np.concatenate(parts)),
    }


def disturbed(law: str, n: int, force: np.ndarray, g) -> np.ndarray:
    """(n,) noise in units of its stated standard deviation."""
    white = g.normal(size=n)
    if law == "ar1":
        out = white.copy()
        for k in range(1, n):
            out[k] = 0.5 * out[k - 1] + np.sqrt(0.75) * white[k]
        return out
    if law == "outliers":
        return np.where(g.uniform(size=n) < 0.05, 8 * white, white)
    if law == "heteroscedastic":
        return white * (0.4 + 1.6 * np.abs(force) / np.abs(force).max())
    return 1.5 * white if law == "misstated" else white
