"""The methods on measured logs, compared with the offline fit of tirefit.

Four logs of two cars. The brush is isotropic; therefore tan(alpha) and F_y of an axle replace
sigma_x and F_x. On the f1tenth car the methods for a whole vehicle run too: the road is the
path of the car, so its heading is the car's, and the offset is the integral of v_y; wheel
torques follow from the acceleration, as all wheels are driven; the steering is read 0.11 s
later than logged, which is when it acts. The offline fit itself is uncertain by a few percent
(`offline_std`).
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

import tirefit
from fits.friction_benchmark.estimators import lacking, traces
from fits.friction_benchmark.metrics import Trace, accuracy
from fits.friction_benchmark.peers import PEERS
from fits.friction_benchmark.scenarios import Log, Scenario
from fits.measured_changes.logs import Logs, data, table
from tirefit.data.table import WHEELS
from tirefit.online.methods import METHODS

__all__ = ["LOGS", "measured_lines"]

FITS = Path(__file__).parents[1]
LOGS = {
    "free driving": FITS / "dart_rear_axle" / "free_driving.csv",
    "circles": FITS / "dart_simulator" / "circles.csv",
}
"""Name -> file of the measured logs of the DART car that have a time."""
F1TENTH = {"f1tenth a": "a", "f1tenth d": "d"}
"""Name -> set of tires of the f1tenth car."""
UNUSED = {"sand (cmu_wheel)": "no time; and no tire model describes it"}
DELAY = 0.11
"""Time [s] after which the steering of the f1tenth car acts (its front axle fits best)."""
RADIUS, INERTIA = 0.05, 3e-5
"""Wheel of the f1tenth car: radius [m], inertia [kg m2]."""
CAR = {"mass": 5.1, "yaw_inertia": 0.12, "l_f": 0.165, "l_r": 0.165}
SIZES = {
    "position": {},
    "path": {"radius": RADIUS, "wheel_inertia": INERTIA, "height": 0.05},
    "force-filter": {
        "radius": RADIUS, "wheel_inertia": INERTIA, "height": 0.05, "track": 0.25,
    },
}  # fmt: skip
"""Data of the f1tenth car, in addition to CAR and the stiffness of the offline fit."""


class Case(NamedTuple):
    """Runs of one measured log, the offline friction, settings by method."""

    title: str
    logs: list[Log]
    fitted: object
    settings: Mapping[str, Mapping[str, float]]


def cases() -> list[Case]:
    """The measured logs with slip and force of an axle."""
    made = []
    for title, path in LOGS.items():
        read = tirefit.read(path)
        fitted = tirefit.fit(read, "brush").parameters["mu"]
        made.append(Case(title, _logs(title, read.columns, read.run, fitted.value), fitted, {}))
    for title, tires in F1TENTH.items():
        rear = table(Logs((tires,), every=20))
        fit = tirefit.fit(data(rear, title), "brush").parameters
        logs = _logs(title, rear.columns, rear.run, fit["mu"].value)
        made.append(Case(title, logs, fit["mu"], {}))
        front = table(Logs((tires,), axle="front", every=20, late={"delta": DELAY}))
        ahead = tirefit.fit(data(front, title), "brush").parameters
        title = f"{title}, vehicle"
        whole = _vehicle(front, rear)
        logs = _logs(title, whole, front.run, ahead["mu"].value)
        stiffness = {
            f"stiffness_{axle}": 2 * found["cpa2"].value / made_of["fz"][0]
            for axle, found, made_of in (("f", ahead, front), ("r", fit, rear))
        }
        settings = {name: CAR | sizes | stiffness for name, sizes in SIZES.items()}
        made.append(Case(title, logs, ahead["mu"], settings))
    return made


def _vehicle(front, rear) -> dict[str, np.ndarray]:
    """Columns of the motion of the f1tenth car, at the rows of its front axle."""
    own = {name: front.columns[name] for name in ("time", "v", "yaw_rate", "steering")}
    v, rate, a_x = own["v"], own["yaw_rate"], front.columns["a_x"]
    v_y = np.zeros_like(v)
    for run in np.unique(front.run):
        here, there = front.run == run, rear.run == run
        slip = np.interp(
            own["time"][here], rear.columns["time"][there], rear.columns["alpha"][there]
        )
        v_y[here] = CAR["l_r"] * rate[here] - v[here] * np.tan(slip)
    heading, offset = np.zeros_like(v), np.zeros_like(v)
    for part in front.parts:
        step = np.gradient(own["time"][part]) if len(part) > 1 else np.zeros(1)
        heading[part] = np.cumsum(rate[part] * step)
        offset[part] = np.cumsum(v_y[part] * step)
    own |= {"heading": heading, "road_heading": heading, "offset": offset, "a_x": a_x}
    own |= {"a_y": front.columns["a_y"], "roll_rate": np.zeros_like(v)}
    for wheel in WHEELS:
        own[f"omega_{wheel}"] = v / RADIUS
        own[f"torque_{wheel}"] = -RADIUS * CAR["mass"] * a_x / 4
    return own


def measured_lines(names: Sequence[str], peers: bool) -> list[dict]:
    """A row for every measured log and estimator: value and error against the fit."""
    lines = []
    for case in cases():
        for name in names:
            reason = lacking(name, case.logs[0].columns)
            if not reason and "mu" not in METHODS[name].method.parameters:
                reason = "it does not estimate mu"
            if reason:
                head = {"log": case.title, "estimator": f"tirefit {name}"}
                lines.append(_empty(head, f"skipped: {reason}"))
                continue
            answers = traces(name, case.logs, case.settings.get(name))
            found = [answer.trace for answer in answers]
            lines.append(_line(case, f"tirefit {name}", found))
        if "sigma_x" in case.logs[0].columns:
            for name, estimate in PEERS.items() if peers else ():
                lines.append(_of_peer(case, name, estimate))
    for title, reason in UNUSED.items():
        lines.append(_empty({"log": title, "estimator": "all"}, f"skipped: {reason}"))
    return lines


def _logs(title: str, columns: Mapping[str, np.ndarray], runs, mu: float) -> list[Log]:
    logs = []
    for code, run in enumerate(dict.fromkeys(runs.tolist())):
        rows = runs == run
        part = {name: values[rows] for name, values in columns.items()}
        if "alpha" in part:
            part |= {"sigma_x": np.tan(part.pop("alpha")), "fx": part.pop("fy")}
        part["time"] = part["time"] - part["time"][0]
        scenario = Scenario(f"{title} {code}", title, np.nan, 0, part["time"][-1])
        logs.append(Log(scenario, part, {"mu": np.full(rows.sum(), mu)}))
    return logs


_COLUMNS = (
    "log", "estimator", "offline", "offline_std", "last", "last_std", "bias", "std",
    "covered", "supported", "alarms", "note",
)  # fmt: skip


def _empty(head: dict, note: str) -> dict:
    return dict.fromkeys(_COLUMNS, "") | head | {"note": note}


def _of_peer(case: Case, name: str, estimate: Callable) -> dict:
    try:
        found = [estimate(log.columns) for log in case.logs]
    except ImportError as missing:
        head = {"log": case.title, "estimator": name}
        return _empty(head, f"skipped: {missing.name} is not installed")
    return _line(case, name, found)


def _line(case: Case, name: str, found: Sequence[Trace]) -> dict:
    """One estimator on the runs of one log, scored over all rows."""
    whole = Trace(*(np.concatenate(parts) for parts in zip(*found, strict=True)))
    error = accuracy(whole, case.fitted.value, begin=0.0)
    at = np.flatnonzero(whole.supported & np.isfinite(whole.mu))
    last = (whole.mu[at[-1]], whole.mu_std[at[-1]]) if len(at) else (np.nan, np.nan)
    return {
        "log": case.title,
        "estimator": name,
        "offline": case.fitted.value,
        "offline_std": case.fitted.std,
        "last": last[0],
        "last_std": last[1],
        **error._asdict(),
        "alarms": int(np.count_nonzero(whole.alarm)),
        "note": "",
    }
