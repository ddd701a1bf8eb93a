"""What a simulator lacks, from its forces alone: they have no noise, so a structure that
explains them does so to their last digits."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares, minimize_scalar

from tirefit.data.table import CANONICAL
from tirefit.diagnosis.engine import NONZERO
from tirefit.diagnosis.rows.noise import in_order
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.params import Values

_EXPLAINED = 0.005
"""Largest rms error of a structure over the simulated force (rms)."""

_RATHER = 0.1
"""Scatter of a simulated force about a curve, over that without the own delay, lag or load of
a structure, below which the simulator has that structure."""

_AT_TOP = 0.999
"""Force over its largest above which it is clipped."""

UNLIKE = ("no_saturation", "clipped", "steps")
"""Structures that no tire model of the library has: its parameters would mislead."""


class Structure(NamedTuple):
    """A structure of a simulator's force ``channel``: its id, what it means, a remedy, and its
    slope over the slip at zero slip and the mean load, if known."""

    id: str
    channel: str
    means: str
    remedy: str
    slope: float | None = None


def structures_of(prepared: Prepared) -> tuple[Structure, ...]:
    """The structures of the simulated forces over their own slip, most important first."""
    return tuple(
        one
        for channel in prepared.channels
        if channel in ("fx", "fy")
        for one in _structures(prepared, channel, "alpha" if channel == "fy" else "sigma_x")
    )


def _structures(prepared: Prepared, channel: str, name: str) -> Iterator[Structure]:
    """Those of one force over the slip of this column."""
    slip, force = prepared.column(name), prepared.column(f"{channel}_sim")
    load, measured = prepared.column("fz"), prepared.column(channel)
    per = "" if CANONICAL[name][0] == "-" else f"/{CANONICAL[name][0]}"
    what = "slip angle" if name == "alpha" else "slip"
    for scale, of_load in ((np.ones_like(load), ""), (load, " and the load")):
        slope, offset = np.polynomial.polynomial.polyfit(slip, force / scale, 1)[::-1]
        missed = rms(force - scale * (slope * slip + offset))
        if missed < _EXPLAINED * max(rms(force), NONZERO):
            steep = float(slope * np.mean(scale))
            used = np.max(np.abs(force) / np.maximum(load, NONZERO))
            means = f"it is proportional to the {what}{of_load} ({steep:.4g} N{per}), so it has no"
            means += f" friction limit: here it uses up to {used:.2f} F_z"
            remedy = "give the tire a friction limit: fit a brush to the measured rows"
            remedy += " (tirefit fit), and export it to the simulator"
            yield Structure("no_saturation", channel, means, remedy, steep)
            return
        if (clipped := _clipped(slip, force / scale)) is not None:
            unit = "of the load" if of_load else "N"
            means = f"it is proportional to the {what} up to a limit of {clipped[0]:.4g} {unit}"
            means += ", with a sharp corner"
            remedy = (
                "give the tire a smooth transition to sliding: fit a brush to the measured rows"
            )
            steep = float(clipped[1] * np.mean(scale))
            yield Structure("clipped", channel, means, remedy, steep)
            return
    limit, reached = (float(np.quantile(np.abs(x) / load, _AT_TOP)) for x in (force, measured))
    # At 95 % of its limit a force slides; a simulator of which 80 % of the rows do always slides.
    if np.mean(np.abs(force / load) > 0.95 * limit) >= 0.8:
        means = f"it is at its limit of {limit:.2f} F_z in nearly all rows; the measured force"
        means += f" reaches {reached:.2f} F_z"
        remedy = f"check the unit of its {what}: degrees where radians are expected, or per cent;"
        remedy += " if it is right, lower the stiffness"
        # A limit far below the measured force is too low; another one is reached too early.
        remedy = "raise its friction" if limit < 0.6 * reached else remedy
        yield Structure("always_sliding", channel, means, remedy)
        return
    values = len(np.unique(np.round(force, 9)))
    if values < 0.2 * len(np.unique(slip)):  # each force stands at five slips and more
        remedy = "interpolate the simulator's table instead of taking the nearest entry"
        yield Structure("steps", channel, f"it has only {values} different values", remedy)
        return
    per_load, plain = _scatter(slip, force / load), _scatter(slip, force)
    varies = np.std(load) > 0.05 * np.mean(load)
    if varies and plain < _RATHER * per_load * np.mean(load):
        remedy = "give the simulator the load of each row, and a tire that depends on it"
        yield Structure("no_load", channel, "it does not depend on the load", remedy)
    if "time" in prepared.data:
        yield from _own_time(prepared, channel, slip, force / load)


def _clipped(slip: np.ndarray, share: np.ndarray) -> tuple[float, float] | None:
    """Limit and slope of a force that is proportional to the slip up to the limit; None for
    another."""
    top = float(np.max(np.abs(share)))
    inner = np.abs(share) < 0.9 * top  # surely not clipped
    if min(np.sum(np.abs(share) > _AT_TOP * top), inner.sum()) < 3:  # rows beside the corner
        return None

    def missed(values: np.ndarray) -> np.ndarray:
        return np.clip(values[0] * slip + values[1], -top, top) - share

    start = np.polynomial.polynomial.polyfit(slip[inner], share[inner], 1)[::-1]
    found = least_squares(missed, start).x
    return None if rms(missed(found)) > _EXPLAINED * rms(share) else (top, float(found[0]))


def _own_time(
    prepared: Prepared, channel: str, slip: np.ndarray, share: np.ndarray
) -> Iterator[Structure]:
    """A delay or a time constant by which the force follows the slip."""
    time, tried = prepared.column("time"), []
    runs = in_order(time, prepared.run)
    steps = np.concatenate([np.diff(time[rows]) for rows in runs])
    if not len(steps):
        return
    logs = np.linspace(np.log(0.005), np.log(0.5), 25)  # of the constants that are tried [s]
    for kind in ("delay", "lag", "ramp"):

        def left(log: float, kind: str = kind) -> float:
            return _scatter(_late(slip, time, runs, np.exp(log), kind), share)

        near, step = min(logs, key=left), logs[1] - logs[0]
        found = minimize_scalar(left, bounds=(near - step, near + step), method="bounded")
        id = "own_delay" if kind == "delay" else "own_lag"
        tried.append((found.fun, id, float(np.exp(found.x))))
    least, id, constant = min(tried)
    plain, apart = _scatter(slip, share), float(np.median(steps))
    if least < _RATHER * plain:
        late = f"{1000 * constant:.0f} ms"
        how = f"{late} late" if id == "own_delay" else f"with a time constant of about {late}"
        remedy = "take this delay out of the simulator, unless the car has it too"
        remedy += " (see channel delay and relaxation length among the effects)"
        yield Structure(id, channel, f"it follows the slip {how}", remedy)
    # Four rows in a delay always show it; with fewer, a part of the scatter may be due to it.
    elif least < 0.8 * plain and plain > _EXPLAINED * rms(share) and constant < 4.0 * apart:
        means = "it may follow the slip with a delay or a lag, which rows"
        means += f" {1000 * apart:.0f} ms apart are too far apart to show"
        remedy = "give more rows per second: all of the log and of the simulator"
        yield Structure("own_time", channel, means, remedy)


def _late(
    slip: np.ndarray, time: np.ndarray, runs: list[np.ndarray], constant: float, kind: str
) -> np.ndarray:
    """The slip after a "delay" or a first-order lag by this time constant [s]: a "lag" of a slip
    that is constant from row to row, or that is a "ramp"."""
    moved = np.array(slip, float)
    for rows in runs:
        if kind == "delay":
            moved[rows] = np.interp(time[rows] - constant, time[rows], slip[rows])
            continue
        step, rise = np.diff(time[rows]), np.diff(slip[rows])
        decay = np.exp(-step / constant)
        added = (1 - decay) * slip[rows[1:]]
        if kind == "ramp":
            added += rise * (decay - (1 - decay) * constant / np.maximum(step, NONZERO))
        for before, row, keep, more in zip(rows[:-1], rows[1:], decay, added, strict=True):
            moved[row] = keep * moved[before] + more
    return moved


def _scatter(slip: np.ndarray, force: np.ndarray) -> float:
    """Rms scatter of a force about a curve over the slip: each value against the line
    through its two neighbours."""
    order = np.argsort(slip, kind="stable")
    x, y = slip[order], force[order]
    wide = np.maximum(x[2:] - x[:-2], NONZERO)
    share = np.where(x[2:] > x[:-2], (x[1:-1] - x[:-2]) / wide, 0.5)
    return rms(y[1:-1] - (1 - share) * y[:-2] - share * y[2:])


def rms(values: Values) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
