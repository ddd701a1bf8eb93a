"""What a simulator lacks, from its forces alone: they have no noise, so a structure that
explains them does so to their last digits."""

from collections.abc import Callable, Iterator
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares, minimize_scalar

from tirefit.data.table import CANONICAL, TireData
from tirefit.diagnosis.engine import NONZERO
from tirefit.diagnosis.rows.noise import in_order
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.diagnosis.rows.rig import LEAST_ROWS
from tirefit.params import Values

_EXPLAINED = 0.005
"""Largest rms error of a structure over the simulated force (rms)."""

_RATHER = 0.1
"""Scatter of a simulated force about a curve, over that without the own delay, lag or load of
a structure, below which the simulator has that structure."""

_AT_TOP = 0.999
"""Force over its largest above which it is clipped."""

_NO_SLIP = 0.5  # scatter about a curve over the slip, over its size, of a force that has none

_CONSTANTS = np.linspace(np.log(0.005), np.log(0.5), 25)
"""Logarithms of the delays and time constants [s] that are tried."""

_MOST_ROWS = 6000
"""Largest number of consecutive rows in which a delay is looked for."""

UNLIKE = ("no_saturation", "clipped", "steps", "no_slip")
"""Structures that no tire model of the library has: its parameters would mislead."""


class OwnTime(NamedTuple):
    """A "delay", or a "lag" of a slip that is constant from row to row, or that is a "ramp", of the
    slip of a column: its ``constant`` [s], or [m] if it is a distance (``moving``)."""

    column: str
    kind: str
    moving: bool
    constant: float


class Structure(NamedTuple):
    """A structure of a simulator's force ``channel``: its id, what it means, a remedy, and, if
    known, its slope over the slip at zero slip and the mean load, and how it is late."""

    id: str
    channel: str
    means: str
    remedy: str
    slope: float | None = None
    late: OwnTime | None = None


def structures_of(prepared: Prepared) -> tuple[Structure, ...]:
    """The structures of the simulated forces over their own slip, most important first."""
    return tuple(
        structure
        for channel in prepared.channels
        if channel in ("fx", "fy")
        for structure in _structures(prepared, channel, "alpha" if channel == "fy" else "sigma_x")
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
            if abs(offset) > _EXPLAINED * rms(force / scale):
                means += f"; it is zero at a {what} of {-offset / slope:.3g}"
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
    levels = np.unique(np.round(force, 9))
    values, apart = len(levels), np.diff(levels)
    # Multiples of one unit are rounded forces, which a tire follows.
    units = apart / max(np.min(apart, initial=np.inf), 1e-9)
    rounded = values > 2 and rms(units - np.round(units)) < _EXPLAINED
    if values < 0.2 * len(np.unique(slip)) and not rounded:  # each force at five slips and more
        remedy = "interpolate the simulator's table instead of taking the nearest entry"
        yield Structure("steps", channel, f"it has only {values} different values", remedy)
        return
    per_load, plain = _scatter(slip, force / load), _scatter(slip, force)
    varies = np.std(load) > 0.05 * np.mean(load)
    if varies and plain < _RATHER * per_load * np.mean(load):
        remedy = "give the simulator the load of each row, and a tire that depends on it"
        yield Structure("no_load", channel, "it does not depend on the load", remedy)
    if "time" in prepared.data:
        yield from _own_time(prepared, channel, name)


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
    line = least_squares(missed, start).x  # slope, and force at no slip
    return None if rms(missed(line)) > _EXPLAINED * rms(share) else (top, float(line[0]))


def _own_time(prepared: Prepared, channel: str, name: str) -> Iterator[Structure]:
    """A delay, a time constant or a length by which the force follows the slip of this column;
    or that the force does not follow the slip."""
    data = prepared.data  # all rows: those of a thinned file are farther apart
    slip, share = data.usable(name), data.usable(f"{channel}_sim") / data.usable("fz")
    stretches, apart = _stretches(data)
    speed, tried = np.abs(data.usable("v")) if "v" in data else np.zeros(1), []
    varies = np.ptp(speed) > 0.1 * np.mean(speed)  # else a length is a time
    for kind, moving in product(("delay", "lag", "ramp"), (False, True)):
        if moving and (kind == "delay" or not varies):
            continue
        pace = float(np.median(speed)) if moving else 1.0

        def late(
            log: float, kind: str = kind, moving: bool = moving, pace: float = pace
        ) -> OwnTime:
            return OwnTime(name, kind, moving, float(np.exp(log)) * pace)

        def left(log: float, late: Callable[..., OwnTime] = late) -> float:
            """Scatter of the force about a curve over the late slip, over that without."""
            moved = _behind(slip, stretches, late(log))
            known = np.isfinite(moved)
            if known.sum() < LEAST_ROWS:
                return 1.0
            with_slip = max(_scatter(slip[known], share[known]), NONZERO)
            return _scatter(moved[known], share[known]) / with_slip

        near, step = min(_CONSTANTS, key=left), _CONSTANTS[1] - _CONSTANTS[0]
        best = minimize_scalar(left, bounds=(near - step, near + step), method="bounded")
        tried.append((float(best.fun), late(best.x), pace))
    least, own, pace = min(tried)
    constant, plain = own.constant, _scatter(slip, share) / max(rms(share), NONZERO)
    id, how = "own_delay", f"{1000 * constant:.0f} ms late"
    if own.moving:
        id, how = "own_relaxation", f"over a relaxation length of about {constant:.2g} m"
    elif own.kind != "delay":
        id, how = "own_lag", f"with a time constant of about {1000 * constant:.0f} ms"
    if least < _RATHER:
        remedy = "take this delay out of the simulator, unless the car has it too"
        remedy += " (see channel delay and relaxation length among the effects)"
        yield Structure(id, channel, f"it follows the slip {how}", remedy, late=own)
    # Four rows in a delay always show it; with fewer, a part of the scatter may be due to it.
    elif least < 0.8 and plain > _EXPLAINED and constant < 4.0 * apart * pace:
        means = f"it may follow the slip {how}, which rows {1000 * apart:.0f} ms apart are too"
        means += " far apart to show with certainty"
        remedy = "give more rows per second: all of the log and of the simulator"
        yield Structure("own_time", channel, means, remedy)
    elif plain > _NO_SLIP:
        means = "it does not follow the slip: at equal slip and load it differs by"
        means += f" {100 * plain:.0f} % of its size (rms)"
        remedy = "check that its rows are those of the measurement, in their order; if they are,"
        remedy += " as in a kinematic model, give the simulator a tire: fit a brush to the"
        yield Structure("no_slip", channel, means, remedy + " measured rows (tirefit fit)")


def _stretches(data: TireData) -> tuple[list[tuple[Any, Any, Any]], float]:
    """Rows of the same run that follow each other without a pause, their times [s] and the
    distance travelled [m] since the first of them, of :data:`_MOST_ROWS` at most; and the usual
    distance of the rows in time [s]."""
    time, run = data.usable("time"), data.run[data.used]
    speed = np.abs(data.usable("v")) if "v" in data else np.zeros(len(time))
    runs, stretches, count = in_order(time, run), [], 0
    apart = float(np.median(np.concatenate([[0.0], *(np.diff(time[rows]) for rows in runs)])[1:]))
    for rows in runs:
        pauses = np.flatnonzero(np.diff(time[rows]) > 1.5 * apart) + 1
        for part in np.split(rows, pauses):
            part = part[: _MOST_ROWS - count]
            if len(part) >= 4:  # a cubic needs four
                count += len(part)
                way = np.cumsum(np.append(0.0, np.diff(time[part]) * speed[part[1:]]))
                stretches.append((part, time[part] - time[part[0]], way))
    return stretches, apart


def slip_behind(data: TireData, late: OwnTime) -> np.ndarray:
    """The slip (n,) of the used rows that a late simulator follows; NaN where the rows do not show
    it, as at the begin of a run."""
    return _behind(data.usable(late.column), _stretches(data)[0], late)


def _behind(slip: np.ndarray, stretches: list[tuple[Any, Any, Any]], late: OwnTime) -> np.ndarray:
    """:func:`slip_behind` of slips (n,) in these stretches."""
    moved, reach = np.full(len(slip), np.nan), 1.0 if late.kind == "delay" else 4.0
    for rows, time, way in stretches:
        at = way if late.moving else time
        known = at > late.constant * reach  # what was before the first row is not known
        moved[rows[known]] = _late(slip[rows], at, late.constant, late.kind)[known]
    return moved


def _late(slip: np.ndarray, at: np.ndarray, constant: float, kind: str) -> np.ndarray:
    """The slip after a "delay" or a first-order lag by this constant in the unit of ``at``: a
    "lag" of a slip that is constant from row to row, or that is a "ramp"."""
    if kind == "delay":
        return CubicSpline(at, slip)(at - constant)
    step, moved = np.maximum(np.diff(at), NONZERO), np.array(slip)
    decay = np.exp(-step / constant)
    added = (1 - decay) * slip[1:]
    if kind == "ramp":
        added += np.diff(slip) * (decay - (1 - decay) * constant / step)
    for row, (keep, more) in enumerate(zip(decay, added, strict=True)):
        moved[row + 1] = keep * moved[row] + more
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
