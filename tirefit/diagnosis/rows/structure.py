"""What a simulator lacks, from its forces alone: they have no noise, so a structure that
explains them does so to their last digits."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares, minimize_scalar

from tirefit.data.table import CANONICAL
from tirefit.diagnosis.engine import NONZERO
from tirefit.diagnosis.rows.prepared import Prepared

_EXPLAINED = 0.005
"""Largest rms error of a structure over the simulated force (rms)."""

_RATHER = 0.1
"""Scatter of a simulated force about a curve, over that without the own delay, lag or load of
a structure, below which the simulator has that structure."""

_PARTLY = 0.8
"""The same, below which it may have a delay or lag that the rows are too far apart to show."""

_AT_TOP, _BELOW_TOP = 0.999, 0.9
"""Force over its largest above which it is clipped, and below which it is surely not."""

_FEWEST = 3  # rows on either side of a corner

_STEPS = 0.2  # distinct forces per distinct slip, below which a simulator has steps

_NEAR_LIMIT, _NEARLY_ALL = 0.95, 0.8
"""Force over its largest that counts as sliding, and share of rows that slide, above which a
simulator always slides."""

_FAR_BELOW = 0.6  # its limit over the measured force, below which its friction is too low

_LOADS = 0.05  # standard deviation over mean of a load that varies

_ROWS_PER_DELAY = 4.0
"""Rows in an own delay or time constant that always show it."""

_LOG_DELAYS = np.linspace(np.log(0.005), np.log(0.5), 25)
"""Logarithms of the own delays and time constants that are tried [s]."""


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
    found: list[Structure] = []
    for channel in prepared.channels:
        if channel in ("fx", "fy"):
            name = "alpha" if channel == "fy" else "sigma_x"
            slip, force = prepared.column(name), prepared.column(f"{channel}_sim")
            found += _structures(prepared, channel, name, slip, force)
    return tuple(found)


def _structures(
    prepared: Prepared, channel: str, name: str, slip: np.ndarray, force: np.ndarray
) -> Iterator[Structure]:
    load, (unit, *_) = prepared.column("fz"), CANONICAL[name]
    per = "" if unit == "-" else f"/{unit}"
    size = max(_rms(force), NONZERO)
    used = np.max(np.abs(force) / np.maximum(load, NONZERO))
    what = "slip angle" if name == "alpha" else "slip"
    varies = np.std(load) > _LOADS * np.mean(load)
    for scale, of_load in ((np.ones_like(load), ""), (load, " and the load")):
        slope, offset = np.polynomial.polynomial.polyfit(slip, force / scale, 1)[::-1]
        if _rms(force - scale * (slope * slip + offset)) < _EXPLAINED * size:
            steep = slope * np.mean(scale)
            yield Structure(
                "no_saturation",
                channel,
                f"it is proportional to the {what}{of_load} ({steep:.4g} N{per}), so it has no"
                f" friction limit: here it uses up to {used:.2f} F_z",
                "give the tire a friction limit: fit a brush to the measured rows"
                " (tirefit fit), and export it to the simulator",
                float(steep),
            )
            return
        if (clipped := _clipped(slip, force, scale)) is not None:
            limit, slope = clipped
            of_what = f"{limit:.4g} of the load" if of_load else f"{limit:.4g} N"
            yield Structure(
                "clipped",
                channel,
                f"it is proportional to the {what} up to a limit of {of_what}, with a sharp corner",
                "give the tire a smooth transition to sliding: fit a brush to the measured rows",
                float(slope * np.mean(scale)),
            )
            return
    measured = prepared.column(channel)
    if (slides := _always_sliding(channel, what, force / load, measured / load)) is not None:
        yield slides
        return
    values = len(np.unique(np.round(force, 9)))
    if values < _STEPS * len(np.unique(slip)):
        yield Structure(
            "steps",
            channel,
            f"it has only {values} different values",
            "interpolate the simulator's table instead of taking the nearest entry",
        )
        return
    per_load, plain = _scatter(slip, force / load), _scatter(slip, force)
    if varies and plain < _RATHER * per_load * np.mean(load):
        yield Structure(
            "no_load",
            channel,
            "it does not depend on the load",
            "give the simulator the load of each row, and a tire that depends on it",
        )
    yield from _own_time(prepared, channel, slip, force / load)


def _always_sliding(
    channel: str, what: str, share: np.ndarray, measured: np.ndarray
) -> Structure | None:
    """A force over the load that is at its limit in nearly all rows; None for another."""
    limit, reached = (np.quantile(np.abs(x), _AT_TOP) for x in (share, measured))
    if np.mean(np.abs(share) > _NEAR_LIMIT * limit) < _NEARLY_ALL:
        return None
    remedy = f"check the unit of its {what}: degrees where radians are expected, or per cent;"
    remedy += " if it is right, lower the stiffness"
    return Structure(
        "always_sliding",
        channel,
        f"it is at its limit of {limit:.2f} F_z in nearly all rows; the measured force"
        f" reaches {reached:.2f} F_z",
        "raise its friction" if limit < _FAR_BELOW * reached else remedy,
    )


def _clipped(slip: np.ndarray, force: np.ndarray, scale: np.ndarray) -> tuple[float, float] | None:
    """Limit and slope, over ``scale``, of a force that is proportional to the slip up to the
    limit; None for another."""
    share = force / scale
    top = float(np.max(np.abs(share)))
    if np.sum(np.abs(share) > _AT_TOP * top) < _FEWEST:
        return None

    def missed(values: np.ndarray) -> np.ndarray:
        slope, offset = values
        return np.clip(slope * slip + offset, -top, top) - share

    inner = np.abs(share) < _BELOW_TOP * top
    if inner.sum() < _FEWEST:
        return None
    start = np.polynomial.polynomial.polyfit(slip[inner], share[inner], 1)[::-1]
    found = least_squares(missed, start)
    if _rms(missed(found.x)) > _EXPLAINED * _rms(share):
        return None
    return top, float(found.x[0])


def _own_time(
    prepared: Prepared, channel: str, slip: np.ndarray, share: np.ndarray
) -> Iterator[Structure]:
    """A delay or a time constant by which the force follows the slip."""
    if "time" not in prepared.data:
        return
    time, run = prepared.column("time"), prepared.run
    tried = []
    for kind, moved in (("own_delay", _delayed), ("own_lag", _lagged), ("own_lag", _ramped)):

        def left(log: float, moved: Callable[..., Any] = moved) -> float:
            return _scatter(moved(slip, time, run, np.exp(log)), share)

        near = min(_LOG_DELAYS, key=left)
        step = _LOG_DELAYS[1] - _LOG_DELAYS[0]
        found = minimize_scalar(left, bounds=(near - step, near + step), method="bounded")
        tried.append((found.fun, kind, float(np.exp(found.x))))
    least, kind, constant = min(tried)
    plain = _scatter(slip, share)
    steps = np.concatenate([np.diff(time[rows]) for rows in _runs(run, time)])
    if not len(steps):
        return
    apart = float(np.median(steps))
    if least < _RATHER * plain:
        late = f"{1000 * constant:.0f} ms"
        how = f"{late} late" if kind == "own_delay" else f"with a time constant of about {late}"
        yield Structure(
            kind,
            channel,
            f"it follows the slip {how}",
            "take this delay out of the simulator, unless the car has it too"
            " (see channel delay and relaxation length among the effects)",
        )
    elif (
        least < _PARTLY * plain
        and plain > _EXPLAINED * _rms(share)
        and constant < _ROWS_PER_DELAY * apart
    ):
        yield Structure(
            "own_time",
            channel,
            "it may follow the slip with a delay or a lag, which rows"
            f" {1000 * apart:.0f} ms apart are too far apart to show",
            "give more rows per second: all of the log and of the simulator",
        )


def _runs(run: np.ndarray, time: np.ndarray) -> Iterator[np.ndarray]:
    for number in np.unique(run):
        rows = np.flatnonzero(run == number)
        yield rows[np.argsort(time[rows], kind="stable")]


def _delayed(slip: np.ndarray, time: np.ndarray, run: np.ndarray, delay: float) -> np.ndarray:
    moved = np.array(slip, float)
    for rows in _runs(run, time):
        moved[rows] = np.interp(time[rows] - delay, time[rows], slip[rows])
    return moved


def _lagged(
    slip: np.ndarray, time: np.ndarray, run: np.ndarray, constant: float, ramp: bool = False
) -> np.ndarray:
    """The slip after a first-order lag: from row to row constant, or on a ``ramp``."""
    moved = np.array(slip, float)
    for rows in _runs(run, time):
        step, rise = np.diff(time[rows]), np.diff(slip[rows])
        decay = np.exp(-step / constant)
        added = (1 - decay) * slip[rows[1:]]
        if ramp:
            added += rise * (decay - (1 - decay) * constant / np.maximum(step, NONZERO))
        for before, row, keep, more in zip(rows[:-1], rows[1:], decay, added, strict=True):
            moved[row] = keep * moved[before] + more
    return moved


_ramped = partial(_lagged, ramp=True)


def _scatter(slip: np.ndarray, force: np.ndarray) -> float:
    """Rms scatter of a force about a curve over the slip: each value against the line
    through its two neighbours."""
    order = np.argsort(slip, kind="stable")
    x, y = slip[order], force[order]
    wide = np.maximum(x[2:] - x[:-2], NONZERO)
    share = np.where(x[2:] > x[:-2], (x[1:-1] - x[:-2]) / wide, 0.5)
    return _rms(y[1:-1] - (1 - share) * y[:-2] - share * y[2:])


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
