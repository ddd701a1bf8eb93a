"""The best correction by hand, with SciPy and rows left out; it shares no code with tirefit.

A brush S(12) in NumPy, changed by the effects of :data:`EFFECTS`, is fitted by least
squares to the rows that are not left out. ``python -m fits.measured_changes.by_hand``
writes ``by_hand.json``: the rms of every single effect of a case, then of combinations.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from fits.formulas import brush
from fits.measured_changes.cases import CASES
from fits.measured_changes.logs import RATE, Table, table

FILE = Path(__file__).with_name("by_hand.json")
WAY = 0.05  # m, grid of the distance travelled, for the relaxation
SLOWEST = 0.02  # m/s, least sliding speed
FAR = 0.05  # m, largest error of the tracked point
FOLDS = 5
"""Number of folds of blocks of time, for fewer than three runs."""
ENOUGH = 0.99
"""A further effect must lower the rms left out at least to this share."""
MOST = 3  # effects in a combination


def _lag(values: np.ndarray, steps: float) -> np.ndarray:
    """A first-order lag, in steady state at the beginning."""
    keep = np.exp(-1 / max(steps, 1e-3))
    return lfilter([1 - keep], [1, -keep], values, zi=[keep * values[0]])[0]


def _late(rows: Table, name: str, delay: float) -> np.ndarray:
    """Change of a column by a delay [s]."""
    return (rows.late(name, delay) - rows.columns[name])[rows.kept]


def _slow(rows: Table, name: str, time: float) -> np.ndarray:
    """Change of a column by a first-order lag with a time constant [s]."""
    values = rows.columns[name]
    slow = np.concatenate([_lag(values[part], time * RATE) for part in rows.parts])
    return (slow - values)[rows.kept]


def _relaxed(rows: Table, length: float) -> np.ndarray:
    """Change of the slip angle by a first-order lag over a distance [m]."""
    slip, whole = rows.columns["alpha"], []
    for part in rows.parts:
        way = np.cumsum(rows.columns["v"][part]) / RATE
        grid = np.arange(way[0], way[-1] + WAY, WAY)
        lagged = _lag(np.interp(grid, way, slip[part]), length / WAY)
        whole.append(np.interp(way, grid, lagged))
    return (np.concatenate(whole) - slip)[rows.kept]


def _each(rows: Table, *values: float) -> np.ndarray:
    """One value for every run but the first, which has 0."""
    return np.array([0.0, *values])[rows.codes]


_STEERED = {
    "steering_delay": ("alpha", lambda r, u, t: -_late(r, "steering", t), 0.1, -0.1, 0.3),
    "steering_lag": ("alpha", lambda r, u, t: -_slow(r, "steering", t), 0.05, 0.001, 0.5),
    "steering_gain": ("alpha", lambda r, u, a: a * r["steering"], 0, -0.6, 0.6),
}
_OF_RUNS = {
    "slip_offset_run": ("shift", lambda r, u, *a: _each(r, *a), 0, -0.2, 0.2),
    "friction_run": ("friction", lambda r, u, *a: _each(r, *a), 0, -0.8, 2),
    "stiffness_run": ("stiffness", lambda r, u, *a: _each(r, *a), 0, -0.8, 2),
}
_OF_ALL = {
    "slip_offset": ("shift", lambda r, u, a: a, 0, -0.2, 0.2),
    "force_offset": ("force", lambda r, u, a: a, 0, -20, 20),
    "speed_zero": ("shift", lambda r, u, a: a / r["v"], 0, -0.3, 0.3),
    "friction_speed_linear": ("friction", lambda r, u, n: n * u, 0, -1, 5),
    "friction_ln_speed": ("friction", lambda r, u, n: n * np.log(u), 0, -0.5, 0.5),
    "drive_force": ("across", lambda r, u: r["push"] / 2, None, None, None),
    "drive_share": ("across", lambda r, u, k: k * r["push"], 0.5, 0, 1.5),
    "channel_delay": ("alpha", lambda r, u, t: _late(r, "alpha", t), 0.02, -0.2, 0.3),
    "relaxation_length": ("alpha", lambda r, u, x: _relaxed(r, x), 0.05, 0, 2),
    "yaw_inertia": ("force", lambda r, u, j: j * r["yaw_acceleration"], 0, -2, 2),
    "tracked_point": ("shift", lambda r, u, x: x * r["turn"], 0, -FAR, FAR),
}
_OF_CASES = {
    "yaw_delay": ("shift", lambda r, u, t: t * r["yaw_rate"], 0, -0.05, 0.05),
    "load_transfer": ("friction", lambda r, u, k: k * r["a_x"], 0, -0.2, 0.2),
}
_TRIED = {"f": ("yaw_delay",), "j": ("load_transfer",)}
"""Letter of a case -> effects that are tried only for it."""
EFFECTS = _OF_ALL | _STEERED | _OF_RUNS | _OF_CASES
"""Name -> (quantity; function of (rows, sliding speed [m/s], parameter) that gives its
change; start, lowest and highest value of the parameter, None without one). Names are
those of tirefit if it has the effect."""
FACTORS = ("stiffness", "friction")
"""Quantities multiplied by 1 + the change; the change is added to all others."""


def _count(name: str, rows: Table) -> int:
    """Number of parameters of an effect."""
    return int(rows.codes.max() if name in _OF_RUNS else EFFECTS[name][2] is not None)


def predicted(values, effects: Sequence[str], rows: Table) -> np.ndarray:
    """Lateral force [N] at the kept rows; first values: stiffness [N], friction."""
    state = {"alpha": rows["alpha"], "shift": 0.0, "force": 0.0, "across": 0.0}
    state |= {"stiffness": values[0], "friction": values[1]}
    at = 2
    for name in effects:
        field, change = EFFECTS[name][:2]
        own = values[at : at + _count(name, rows)]
        at += len(own)
        sliding = rows["v"] * np.abs(np.tan(state["alpha"]) + state["shift"])
        by = change(rows, np.maximum(sliding, SLOWEST), *own)
        if field in FACTORS:
            state[field] = state[field] * np.maximum(1 + by, 0.05)
        else:
            state[field] = state[field] + by
    slip = np.tan(state["alpha"]) + state["shift"]
    used = state["friction"] ** 2 - (state["across"] / rows["fz"]) ** 2
    friction = np.sqrt(np.maximum(used, 0.01))
    size = brush(np.abs(slip), rows["fz"], 0.0, state["stiffness"], friction)
    return np.sign(slip) * size + state["force"]


def fitted(effects: Sequence[str], rows: Table, use=slice(None), start=None):
    """Values of all parameters, fitted to the kept rows ``use``."""
    limits = [(40.0, 1.0, 1e5), (0.7, 0.05, 5.0)]
    for name in effects:
        limits += [EFFECTS[name][2:]] * _count(name, rows)
    usual, low, high = np.array(limits, float).T
    found = least_squares(
        lambda p: (predicted(p, effects, rows) - rows["fy"])[use],
        usual if start is None else start,
        bounds=(low, high),
        x_scale=np.abs(usual) + 0.05,
        ftol=1e-6,
        max_nfev=30,
    )
    return found.x


def rms(values, effects: Sequence[str], rows: Table) -> float:
    """rms [N] of observed minus predicted force at the kept rows."""
    missed = rows["fy"] - predicted(values, effects, rows)
    return float(np.sqrt(np.mean(missed**2)))


def folds(rows: Table, in_time: bool = False) -> tuple[str, list[np.ndarray]]:
    """The kind of folds in words, and the mask (bool) of each fold."""
    count = rows.codes.max() + 1
    if count >= 3 and not in_time:
        return f"{count} runs, each left out in turn", [rows.codes == k for k in range(count)]
    block = np.empty(len(rows.codes), int)
    for k in range(count):
        own = np.flatnonzero(rows.codes == k)
        block[own] = np.arange(len(own)) * 2 * FOLDS // len(own) % FOLDS
    return f"{FOLDS} sets of blocks of time", [block == k for k in range(FOLDS)]


def rms_left_out(effects: Sequence[str], rows: Table, parts) -> float:
    """rms [N] of observed minus predicted force on rows left out, over all folds."""
    start, missed = fitted(effects, rows), np.zeros(len(parts[0]))
    for out in parts:
        values = fitted(effects, rows, ~out, start)
        missed[out] = (rows["fy"] - predicted(values, effects, rows))[out]
    return float(np.sqrt(np.mean(missed**2)))


def best(rows: Table, parts, library: Sequence[str]) -> dict[str, float]:
    """Set of effects (joined by +) -> rms left out: no effect, each alone, then the best
    set with each other effect, while one lowers the rms to :data:`ENOUGH`."""
    found, chosen = {"": rms_left_out((), rows, parts)}, ()
    while len(chosen) < MOST and library:
        last = found["+".join(chosen)]
        sets = {name: (*chosen, name) for name in library}
        tried = {name: rms_left_out(sets[name], rows, parts) for name in library}
        found |= {"+".join(sets[name]): value for name, value in tried.items()}
        leader = min(tried, key=tried.__getitem__)
        if tried[leader] > ENOUGH * last:
            break
        if chosen:
            library = [name for name in library if tried[name] < ENOUGH * last]
        chosen = sets[leader]
        library = [name for name in library if name != leader]
    return found


def by_hand(case) -> dict:
    """The result by hand of one case of :mod:`fits.measured_changes.cases`."""
    rows = table(case.logs)
    on, parts = folds(rows, case.in_time)
    library = [
        *_OF_ALL,
        *(_STEERED if case.logs.axle == "front" else ()),
        *_TRIED.get(case.letter, ()),
        *(_OF_RUNS if rows.codes.max() > 0 and not on.endswith("turn") else ()),
    ]
    values = best(rows, parts, library)
    found: dict = {"n": len(rows["fy"]), "on": on}
    if case.fitted_on is not None:
        given = fitted((), table(case.fitted_on))
        found |= {"given": list(given), "plain": list(fitted((), rows))}
        values = {"parameters+" + names: value for names, value in values.items()}
        values = {"": rms(given, (), rows)} | values
    low = min(values.values()) / ENOUGH
    leader = min((k for k in values if values[k] <= low), key=lambda k: k.count("+"))
    names = tuple(n for n in leader.split("+") if n not in ("", "parameters"))
    found |= {"rms": values, "best": leader, "values": list(fitted(names, rows))}
    if case.held_out is not None:
        other = table(case.held_out)
        found["held_out"] = {
            "+".join(s): rms(fitted(s, rows), s, other) for s in ((), *((n,) for n in names), names)
        }
    return found


def rounded(value):
    """The value with its numbers rounded to five significant digits."""
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(item) for item in value]
    return float(f"{value:.5g}") if isinstance(value, float) else value


def main() -> None:
    """Write ``by_hand.json`` for all cases, or for those given as arguments."""
    known = json.loads(FILE.read_text()) if FILE.exists() else {}
    for case in CASES:
        if not sys.argv[1:] or case.name in sys.argv[1:]:
            new = known[case.name] = rounded(by_hand(case))
            there = [c.name for c in CASES if c.name in known]
            lines = (f"{json.dumps(name)}: {json.dumps(known[name])}" for name in there)
            FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n")
            print(case.name, new["rms"][""], new["best"], new["rms"][new["best"]])


if __name__ == "__main__":
    main()
