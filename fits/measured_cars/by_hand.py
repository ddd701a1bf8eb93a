"""A car fitted and predicted by hand, with NumPy and SciPy; it shares no code with tirefit.

A single track on two brushes S(12) with a steering delay and offset; for logs of poses also
a steering ratio and an error of the heading. The friction may rise with the logarithm of the
sliding speed. Windows of :data:`WINDOW` seconds run freely from their measured states; least
squares of sideways speed and yaw rate over their rms.
"""

import csv
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import butter, filtfilt

from fits.formulas import brush

RATE = 100.0  # Hz
PARTS = 2  # integration steps of a sample
WINDOW, EVERY = 1.0, 0.25  # s: length of a fitted window; between two predictions
HORIZONS = (0.25, 0.5, 1.0, 2.0, 5.0)  # s
GAP, EDGE = 0.015, 0.3  # s: larger steps of time are gaps; left out beside them
SLOWEST = 0.02  # m/s, least sliding speed
LEAD = 40  # samples of steering before a window
KINDS = ("linear", "brush", "rising")
"""Linear tires; brushes; brushes whose friction rises with ln of the sliding speed."""


@dataclass(frozen=True)
class Log:
    """Unbroken stretches, each a dictionary of columns (n,): v_x, v_y [m/s], r [rad/s] of the
    centre of gravity, heading [rad], x, y [m], and the road wheel angle delta [rad]."""

    stretches: tuple[dict[str, np.ndarray], ...]


@dataclass(frozen=True)
class Windows:
    """Windows (w, k) of all stretches; ``delta`` (w, LEAD + k); NaN beyond the end."""

    of: dict[str, np.ndarray]


def _smooth(values: np.ndarray, cutoff: float, order: int) -> np.ndarray:
    return filtfilt(*butter(order, cutoff / (RATE / 2)), values)


def _moved(log: dict[str, np.ndarray], car: dict, ahead: float, left: float):
    """Columns of the centre of gravity, [ahead, left] of the tracked point, at 100 Hz."""
    names, how = car["columns"], (car["filter"]["cutoff"], car["filter"]["order"])
    time = log[names["time"]]
    grid = np.arange(time[0], time[-1], 1 / RATE)
    at = {key: np.interp(grid, time, log[name]) for key, name in names.items() if name in log}
    wheel = np.interp(at["steering"], car["steering"]["command"], car["steering"]["angle"])
    found = {"delta": _smooth(wheel, *how)}
    if "yaw" in at:
        yaw = at["yaw"]
        x = _smooth(at["x"] + ahead * np.cos(yaw) - left * np.sin(yaw), *how)
        y = _smooth(at["y"] + ahead * np.sin(yaw) + left * np.cos(yaw), *how)
        yaw = _smooth(yaw, *how)
        east, north = np.gradient(x) * RATE, np.gradient(y) * RATE
        cos, sin = np.cos(yaw), np.sin(yaw)
        found |= {"v_x": east * cos + north * sin, "v_y": north * cos - east * sin}
        found |= {"r": np.gradient(yaw) * RATE, "heading": yaw, "x": x, "y": y}
    else:
        v_x, v_y, r = (_smooth(at[k], *how) for k in ("v_x", "v_y", "yaw_rate"))
        v_y = v_y + ahead * r
        heading = np.cumsum(r) / RATE
        east = v_x * np.cos(heading) - v_y * np.sin(heading)
        north = v_x * np.sin(heading) + v_y * np.cos(heading)
        found |= {"v_x": v_x, "v_y": v_y, "r": r, "heading": heading}
        found |= {"x": np.cumsum(east) / RATE, "y": np.cumsum(north) / RATE}
    keep = car["keep"]
    good = found["v_x"] > keep["v_min"]
    good &= np.abs(found["v_x"] * found["r"]) < keep.get("a_y_max", np.inf)
    if "active" in keep:
        good &= np.interp(grid, time, log[keep["active"]]) == keep["active_value"]
    good[: round(EDGE * RATE)] = good[-round(EDGE * RATE) :] = False
    return found, good


def read_log(path: Path, car: dict) -> Log:
    """The stretches of a log in which the car drives, by the ``vehicle.toml`` in ``car``."""
    with open(path) as file:
        header, *rows = csv.reader(file)
    log = dict(zip(header, np.array(rows, float).T, strict=True))
    if (yaw := car["columns"].get("yaw")) is not None:
        log[yaw] = np.unwrap(log[yaw])
    time = log[car["columns"]["time"]]
    rising = np.concatenate([[True], np.diff(time) > 0])
    log = {key: values[rising] for key, values in log.items()}
    time = time[rising]
    l_r, (point, aside) = car["l_r"], car["tracked_point"]
    gap = 5 * GAP if yaw is not None else GAP
    stretches = []
    for part in np.split(np.arange(len(time)), np.flatnonzero(np.diff(time) > gap) + 1):
        if time[part[-1]] - time[part[0]] < 2 * EDGE + WINDOW:
            continue
        found, good = _moved({k: v[part] for k, v in log.items()}, car, l_r - point, -aside)
        edges = np.flatnonzero(np.diff(good.astype(int), prepend=0, append=0))
        for first, last in edges.reshape(-1, 2):
            stretches.append({k: v[first:last] for k, v in found.items()})
    return Log(tuple(stretches))


def windows(logs: Sequence[Log], length: float, every: float, shortest: float) -> Windows:
    """Windows of ``length`` [s] that start every ``every`` s and last ``shortest`` at least."""
    count, least = round(length * RATE) + 1, round(shortest * RATE) + 1
    found: dict[str, list] = {}
    for stretch in (one for log in logs for one in log.stretches):
        n = len(stretch["v_x"])
        for first in range(LEAD, n - least + 1, round(every * RATE)):
            rows = np.arange(first, first + count)
            there = rows < n
            for key, values in stretch.items():
                if key == "delta":
                    own = values[np.minimum(np.arange(first - LEAD, first + count), n - 1)]
                else:
                    own = np.where(there, values[np.minimum(rows, n - 1)], np.nan)
                found.setdefault(key, []).append(own)
    return Windows({key: np.array(values) for key, values in found.items()})


NAMES = ("c_front", "c_rear", "mu_front", "mu_rear", "delay", "offset", "ratio", "zero", "rise")
STARTS = {"c_front": 50.0, "c_rear": 50.0, "mu_front": 0.7, "mu_rear": 0.7, "delay": 0.05}
STARTS |= {"offset": 0.0, "ratio": 1.0, "zero": 0.0, "rise": 0.0}
LIMITS = {"c_front": (1.0, 5000.0), "c_rear": (1.0, 5000.0), "mu_front": (0.05, 5.0)}
LIMITS |= {"mu_rear": (0.05, 5.0), "delay": (0.0, 0.35), "offset": (-0.2, 0.2)}
LIMITS |= {"ratio": (0.5, 2.0), "zero": (-0.1, 0.1), "rise": (-0.5, 1.0)}


def free(kind: str, poses: bool) -> list[str]:
    """Names of the fitted parameters."""
    left_out = {"linear": {"mu_front", "mu_rear", "rise"}, "brush": {"rise"}}.get(kind, set())
    return [k for k in NAMES if k not in left_out and (poses or k not in ("ratio", "zero"))]


def predicted(values: dict[str, float], kind: str, car: dict, at: Windows) -> dict:
    """States (w, k) of all windows: v_y, r, heading, x, y."""
    m, j, l_f, l_r = car["mass"], car["yaw_inertia"], car["l_f"], car["l_r"]
    loads = m * 9.80665 * np.array([l_r, l_f]) / (l_f + l_r)
    v_x = np.nan_to_num(at.of["v_x"], nan=1.0)
    count = v_x.shape[1]
    late = np.arange(count) + LEAD - values["delay"] * RATE
    low = np.floor(late).astype(int)
    share = late - low
    delta = at.of["delta"]
    wheel = (1 - share) * delta[:, low] + share * delta[:, np.minimum(low + 1, delta.shape[1] - 1)]
    wheel = values["ratio"] * wheel + values["offset"]

    def force(slip: np.ndarray, axle: int, speed: np.ndarray) -> np.ndarray:
        c = values[("c_front", "c_rear")[axle]]
        if kind == "linear":
            return -2 * c * slip
        mu, size = values[("mu_front", "mu_rear")[axle]], np.abs(slip)
        if kind == "rising":
            sliding = np.maximum(speed * size, SLOWEST)
            mu = mu * np.maximum(1 + values["rise"] * np.log(sliding), 0.05)
        return -np.sign(slip) * brush(size, loads[axle], 0.0, c, mu)

    def slope(state: np.ndarray, speed: np.ndarray, angle: np.ndarray) -> np.ndarray:
        v_y, r, heading = state[:3]
        ahead = np.arctan2(v_y + l_f * r, speed) - angle
        front = force(np.tan(np.clip(ahead, -1.5, 1.5)), 0, speed)
        rear = force((v_y - l_r * r) / speed, 1, speed)
        cos, sin = np.cos(heading), np.sin(heading)
        front = front * np.cos(angle)
        return np.array(
            [
                (front + rear) / m - speed * r,
                (l_f * front - l_r * rear) / j,
                r,
                speed * cos - v_y * sin,
                speed * sin + v_y * cos,
            ]
        )

    zero = values["zero"]  # logged heading less the car's
    first = {k: at.of[k][:, 0] for k in ("v_y", "r", "heading", "x", "y")}
    state = np.array([first["v_y"] + zero * v_x[:, 0], *list(first.values())[1:]])
    state[2] -= zero
    found, step = [state], 1 / RATE / PARTS
    for k in range(count - 1):
        for part in range(PARTS):
            inside = [(part + q) / PARTS for q in (0, 1)]
            speed = [(1 - q) * v_x[:, k] + q * v_x[:, k + 1] for q in inside]
            angle = [(1 - q) * wheel[:, k] + q * wheel[:, k + 1] for q in inside]
            begin = slope(state, speed[0], angle[0])
            end = slope(state + step * begin, speed[1], angle[1])
            state = np.clip(state + step / 2 * (begin + end), -1e3, 1e3)
        found.append(state)
    v_y, r, heading, x, y = np.moveaxis(np.array(found), 0, 2)
    return {"v_y": v_y - zero * v_x, "r": r, "heading": heading + zero, "x": x, "y": y}


def fitted(kind: str, car: dict, at: Windows) -> dict[str, float]:
    """Parameters by least squares over windows."""
    names = free(kind, "ratio" in car)
    scale = {key: np.nanstd(at.of[key]) for key in ("v_y", "r")}

    def missed(p: np.ndarray) -> np.ndarray:
        states = predicted(STARTS | dict(zip(names, p, strict=True)), kind, car, at)
        each = [(states[key] - at.of[key])[:, 1:] / scale[key] for key in scale]
        return np.clip(np.nan_to_num(np.array(each)), -20, 20).ravel()

    start = np.array([STARTS[k] for k in names])
    low, high = np.array([LIMITS[k] for k in names]).T
    size = np.abs(start) + 0.05
    found = least_squares(
        missed, start, bounds=(low, high), x_scale=size, loss="soft_l1", max_nfev=40
    )
    return STARTS | dict(zip(names, found.x.tolist(), strict=True))


def errors(states: dict, at: Windows) -> dict[str, list[float | None]]:
    """Rms of the yaw rate [rad/s] and of the lateral position [m] at the horizons."""
    heading = at.of["heading"]
    east, north = states["x"] - at.of["x"], states["y"] - at.of["y"]
    each = {
        "yaw_rate": states["r"] - at.of["r"],
        "lateral": np.cos(heading) * north - np.sin(heading) * east,
    }
    found = {}
    for name, values in each.items():
        columns = [values[:, round(h * RATE)] for h in HORIZONS]
        columns = [c[np.isfinite(c)] for c in columns]
        found[name] = [float(np.sqrt(np.mean(c**2))) if len(c) else None for c in columns]
    return found


def read_car(toml: Path, poses: bool) -> dict:
    """The content of ``vehicle.toml``; ``ratio`` if the steering ratio is to be fitted."""
    car = tomllib.loads(toml.read_text())
    return car | ({"ratio": True} if poses else {})


def by_hand(logs: Sequence[Path], others: Sequence[Path], toml: Path, poses: bool) -> dict:
    """Kind -> parameters, and errors on the logs left out; ``starts`` by horizon."""
    car = read_car(toml, poses)
    own, rest = ([read_log(path, car) for path in paths] for paths in (logs, others))
    cut = windows(own, WINDOW, WINDOW, WINDOW)
    ahead = windows(rest, HORIZONS[-1], EVERY, HORIZONS[0])
    count = np.isfinite(ahead.of["v_x"]).sum(axis=0)
    found: dict = {"starts": [int(count[round(h * RATE)]) for h in HORIZONS]}
    for kind in KINDS:
        values = fitted(kind, car, cut)
        found[kind] = {"parameters": values, **errors(predicted(values, kind, car, ahead), ahead)}
    return found
