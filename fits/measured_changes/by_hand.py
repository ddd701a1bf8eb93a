"""The best that SciPy does by hand, with rows left out: nothing of tirefit in here.

A brush S(12) in NumPy, changed by the effects of :data:`EFFECTS`, fitted by least
squares to the rows that are not left out. ``python -m fits.measured_changes.by_hand``
writes ``by_hand.json``: every single effect of a case, then the best combinations.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from fits.formulas import brush
from fits.measured_changes.cases import CASES
from fits.measured_changes.logs import RATE, Table, table

WAY = 0.02  # m, grid of distance of the relaxation
FOLDS = 5
"""Folds of blocks of time, where there are fewer than three runs."""
ENOUGH = 0.99
"""A further effect must take the rms left out below this share of what it was."""
MOST = 3  # effects of a combination


class State(NamedTuple):
    """What the effects change, (n,) each at the kept rows: slip angle [rad], tan of it
    added, factors of stiffness and friction, force added [N], force across [N]."""

    alpha: np.ndarray
    shift: np.ndarray
    stiffness: np.ndarray
    friction: np.ndarray
    force: np.ndarray
    across: np.ndarray


def _lag(values: np.ndarray, steps: float) -> np.ndarray:
    """A lag of first order; the past before the beginning is at rest."""
    keep = np.exp(-1 / max(steps, 1e-3))
    return lfilter([1 - keep], [1, -keep], values, zi=[keep * values[0]])[0]


def _slow(rows: Table, time: float) -> np.ndarray:
    """The steering through a lag of first order with a time constant [s]."""
    steering = rows.columns["steering"]
    whole = [_lag(steering[part], time * RATE) for part in rows.parts]
    return np.concatenate(whole)[rows.kept]


def _relaxed(rows: Table, length: float) -> np.ndarray:
    """The slip angle through a lag of first order over a distance [m]."""
    whole = []
    for part in rows.parts:
        way = np.cumsum(rows.columns["v"][part]) / RATE
        grid = np.arange(way[0], way[-1] + WAY, WAY)
        slip = np.interp(grid, way, rows.columns["alpha"][part])
        whole.append(np.interp(way, grid, _lag(slip, length / WAY)))
    return np.concatenate(whole)[rows.kept]


def _sliding(s: State, rows: Table) -> np.ndarray:
    """Sliding speed [m/s]."""
    return np.maximum(rows["v"] * np.abs(np.tan(s.alpha) + s.shift), 0.02)


def _adds(name, what):
    """Add to a field of the state."""
    return lambda s, rows, *a: s._replace(**{name: getattr(s, name) + what(rows, *a)})


def _times(name, what):
    """Multiply a field of the state by a factor that stays positive."""
    return lambda s, rows, *a: s._replace(
        **{name: getattr(s, name) * np.maximum(what(s, rows, *a), 0.05)}
    )


def _each(rows: Table, *values) -> np.ndarray:
    """One value for every run but the first, which has 0."""
    return np.array([0.0, *values])[rows.codes]


_STEERED = {
    "steering_delay": (
        _adds("alpha", lambda rows, t: rows["steering"] - rows.late("steering", t)),
        0.08, -0.1, 0.3,
    ),
    "steering_lag": (
        _adds("alpha", lambda rows, t: rows["steering"] - _slow(rows, t)),
        0.05, 0.001, 0.5,
    ),
    "steering_gain": (
        _adds("alpha", lambda rows, a: a * rows["steering"]), 0, -0.6, 0.6,
    ),
}  # fmt: skip
_OF_RUNS = {
    "slip_offset_run": (_adds("shift", _each), 0, -0.2, 0.2),
    "friction_run": (_times("friction", lambda s, *a: 1 + _each(*a)), 0, -0.8, 2),
    "stiffness_run": (_times("stiffness", lambda s, *a: 1 + _each(*a)), 0, -0.8, 2),
}
_OF_ALL = {
    "slip_offset": (_adds("shift", lambda rows, a: a), 0, -0.2, 0.2),
    "force_offset": (_adds("force", lambda rows, a: a), 0, -20, 20),
    "speed_zero": (_adds("shift", lambda rows, a: a / rows["v"]), 0, -0.3, 0.3),
    "friction_speed_linear": (
        _times("friction", lambda s, rows, n: 1 + n * _sliding(s, rows)), 0, -1, 5,
    ),
    "friction_ln_speed": (
        _times("friction", lambda s, rows, n: 1 + n * np.log(_sliding(s, rows))),
        0, -0.5, 0.5,
    ),
    "drive_force": (
        lambda s, rows: s._replace(across=rows["push"] / 2), None, None, None,
    ),
    "drive_share": (
        lambda s, rows, k: s._replace(across=k * rows["push"]), 0.5, 0, 1.5,
    ),
    "channel_delay": (
        _adds("alpha", lambda rows, t: rows.late("alpha", t) - rows["alpha"]),
        0.02, -0.2, 0.3,
    ),
    "relaxation_length": (
        _adds("alpha", lambda rows, x: _relaxed(rows, x) - rows["alpha"]), 0.05, 0, 2,
    ),
    "yaw_inertia": (
        _adds("force", lambda rows, j: j * rows["yaw_acceleration"]), 0, -2, 2,
    ),
    "tracked_point": (
        _adds("shift", lambda rows, x: x * rows["yaw_rate"] / rows["v"]), 0, -0.4, 0.4,
    ),
    "yaw_delay": (_adds("shift", lambda rows, t: t * rows["yaw_rate"]), 0, -0.2, 0.2),
}  # fmt: skip
EFFECTS = _OF_ALL | _STEERED | _OF_RUNS
"""Name -> (change of the state, then start, lowest and highest value of its parameter,
None where it has none); names are those of tirefit where it has the effect."""


def _count(name: str, rows: Table) -> int:
    """Parameters of an effect."""
    if name in _OF_RUNS:
        return int(rows.codes.max())
    return int(EFFECTS[name][1] is not None)


def predicted(values, effects: Sequence[str], rows: Table) -> np.ndarray:
    """Lateral force [N] at the kept rows; first values: stiffness [N], friction."""
    zero, one = np.zeros(len(rows["fy"])), np.ones(len(rows["fy"]))
    state, at = State(rows["alpha"], zero, one, one, zero, zero), 2
    for name in effects:
        count = _count(name, rows)
        state = EFFECTS[name][0](state, rows, *values[at : at + count])
        at += count
    slip = np.tan(state.alpha) + state.shift
    used = (values[1] * state.friction) ** 2 - (state.across / rows["fz"]) ** 2
    friction = np.sqrt(np.maximum(used, 0.01))
    size = brush(np.abs(slip), rows["fz"], 0.0, values[0] * state.stiffness, friction)
    return np.sign(slip) * size + state.force


def fitted(effects: Sequence[str], rows: Table, use=slice(None), start=None):
    """Values of all parameters, from the kept rows ``use``."""
    limits = [(40.0, 1.0, 1e5), (0.7, 0.05, 5.0)]
    for name in effects:
        limits += [EFFECTS[name][1:]] * _count(name, rows)
    usual, low, high = np.array(limits, float).T
    found = least_squares(
        lambda p: (predicted(p, effects, rows) - rows["fy"])[use],
        usual if start is None else start,
        bounds=(low, high), x_scale=np.abs(usual) + 0.05, ftol=1e-6, max_nfev=40,
    )  # fmt: skip
    return found.x


def rms(values, effects: Sequence[str], rows: Table) -> float:
    """rms [N] of observed less predicted at the kept rows."""
    missed = rows["fy"] - predicted(values, effects, rows)
    return float(np.sqrt(np.mean(missed**2)))


def folds(rows: Table, in_time: bool = False) -> tuple[str, list[np.ndarray]]:
    """How the kept rows are left out, and which (bool) in each fold."""
    count = rows.codes.max() + 1
    if count >= 3 and not in_time:
        return f"{count} runs, each left out in turn", [
            rows.codes == k for k in range(count)
        ]
    block = np.empty(len(rows.codes), int)
    for k in range(count):
        own = np.flatnonzero(rows.codes == k)
        block[own] = np.arange(len(own)) * 2 * FOLDS // len(own) % FOLDS
    return f"{FOLDS} sets of blocks of time", [block == k for k in range(FOLDS)]


def rms_left_out(effects: Sequence[str], rows: Table, parts) -> float:
    """rms [N] of observed less predicted on rows left out, all folds together."""
    start, missed = fitted(effects, rows), np.zeros(len(parts[0]))
    for out in parts:
        values = fitted(effects, rows, ~out, start)
        missed[out] = (rows["fy"] - predicted(values, effects, rows))[out]
    return float(np.sqrt(np.mean(missed**2)))


def best(rows: Table, parts, library: Sequence[str]) -> dict[str, float]:
    """Set of effects (joined by +) -> rms left out: nothing, each alone, then the best
    set with one more, until no further one is worth it."""
    found = {"": rms_left_out((), rows, parts)}
    chosen: tuple[str, ...] = ()
    while len(chosen) < MOST:
        tried = {
            (*chosen, name): rms_left_out((*chosen, name), rows, parts)
            for name in library if name not in chosen
        }  # fmt: skip
        found |= {"+".join(names): value for names, value in tried.items()}
        leader = min(tried, key=tried.__getitem__)
        if tried[leader] > ENOUGH * found["+".join(chosen)]:
            break
        chosen = leader
    return found


def by_hand(case) -> dict:
    """All that is known by hand of one case, of :mod:`fits.measured_changes.cases`."""
    rows = table(case.logs)
    on, parts = folds(rows, case.in_time)
    by_run = rows.codes.max() > 0 and not on.endswith("turn")
    library = {**_OF_ALL, **(_STEERED if case.logs.axle == "front" else {})}
    values = best(rows, parts, [*library, *(_OF_RUNS if by_run else ())])
    found: dict = {"n": len(rows["fy"]), "on": on}
    if case.fitted_on is not None:
        given, new = fitted((), table(case.fitted_on)), fitted((), rows)
        found["change"] = {"cpa2": [given[0], new[0]], "mu": [given[1], new[1]]}
        values = {"parameters+" + names: value for names, value in values.items()}
        values = {"": rms(given, (), rows)} | values
    low = min(values.values()) / ENOUGH
    leader = min((k for k in values if values[k] <= low), key=lambda k: k.count("+"))
    names = tuple(n for n in leader.split("+") if n not in ("", "parameters"))
    found |= {"rms": values, "best": leader, "values": list(fitted(names, rows))}
    if case.held_out is not None:
        other = table(case.held_out)
        found["held_out"] = {
            "+".join(s): rms(fitted(s, rows), s, other)
            for s in ((), *((n,) for n in names), names)
        }
    return found


def rounded(value):
    """The same with five significant digits."""
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [rounded(item) for item in value]
    return float(f"{value:.5g}") if isinstance(value, float) else value


def main() -> None:
    """Write ``by_hand.json`` for all cases, or again for those named."""
    path = Path(__file__).with_name("by_hand.json")
    known = json.loads(path.read_text()) if path.exists() else {}
    for case in CASES:
        if not sys.argv[1:] or case.name in sys.argv[1:]:
            known[case.name] = rounded(by_hand(case))
            path.write_text(json.dumps(known, indent=1) + "\n")
            print(case.name, known[case.name]["rms"][""], known[case.name]["best"],
                  min(known[case.name]["rms"].values()), flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
