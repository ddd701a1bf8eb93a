"""The methods on measured logs, compared with the offline fit of tirefit.

The DART car logs lateral slip and force. The brush is isotropic; therefore tan(alpha) and
F_y replace sigma_x and F_x. The offline fit itself is uncertain by a few percent
(`offline_std`).
"""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

import tirefit
from fits.friction_benchmark.estimators import lacking, traces
from fits.friction_benchmark.metrics import Trace, accuracy
from fits.friction_benchmark.peers import PEERS
from fits.friction_benchmark.scenarios import Log, Scenario
from tirefit.online.methods import METHODS

__all__ = ["LOGS", "measured_lines"]

FITS = Path(__file__).parents[1]
LOGS = {
    "free driving": FITS / "dart_rear_axle" / "free_driving.csv",
    "circles": FITS / "dart_simulator" / "circles.csv",
}
"""Name -> file of the measured logs that have a time."""
UNUSED = {"sand (cmu_wheel)": "no time; and no tire model describes it"}


def measured_lines(names: Sequence[str], peers: bool) -> list[dict]:
    """A row for every measured log and estimator: value and error against the fit."""
    lines = []
    for title, path in LOGS.items():
        data = tirefit.read(path)
        fitted = tirefit.fit(data, "brush").parameters["mu"]
        logs = _logs(title, data, fitted.value)
        for name in names:
            reason = lacking(name, logs[0].columns)
            if not reason and "mu" not in METHODS[name].method.parameters:
                reason = "it does not estimate mu"
            if reason:
                head = {"log": title, "estimator": f"tirefit {name}"}
                lines.append(_empty(head, f"skipped: {reason}"))
                continue
            found = [answer.trace for answer in traces(name, logs)]
            lines.append(_line(title, f"tirefit {name}", fitted, logs, found))
        for name, estimate in PEERS.items() if peers else ():
            lines.append(_of_peer(title, name, estimate, fitted, logs))
    for title, reason in UNUSED.items():
        lines.append(_empty({"log": title, "estimator": "all"}, f"skipped: {reason}"))
    return lines


def _logs(title: str, data, mu: float) -> list[Log]:
    logs = []
    for code in np.unique(data.run):
        rows = data.run == code
        part = {name: values[rows] for name, values in data.columns.items()}
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


def _of_peer(title, name, estimate: Callable, fitted, logs) -> dict:
    try:
        found = [estimate(log.columns) for log in logs]
    except ImportError as missing:
        head = {"log": title, "estimator": name}
        return _empty(head, f"skipped: {missing.name} is not installed")
    return _line(title, name, fitted, logs, found)


def _line(title, name, fitted, logs: Sequence[Log], found: Sequence[Trace]) -> dict:
    """One estimator on the runs of one log, scored over all rows."""
    whole = Trace(*(np.concatenate(parts) for parts in zip(*found, strict=True)))
    error = accuracy(whole, fitted.value)
    at = np.flatnonzero(whole.supported & np.isfinite(whole.mu))
    last = (whole.mu[at[-1]], whole.mu_std[at[-1]]) if len(at) else (np.nan, np.nan)
    return {
        "log": title,
        "estimator": name,
        "offline": fitted.value,
        "offline_std": fitted.std,
        "last": last[0],
        "last_std": last[1],
        **error._asdict(),
        "alarms": int(np.count_nonzero(whole.alarm)),
        "note": "",
    }
