"""Scores of one log, and of all logs of a use of friction together."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from scipy.optimize import least_squares

from fits.formulas import brush
from fits.friction_benchmark.metrics import SETTLE, Trace, accuracy, crossings, detection
from fits.friction_benchmark.scenarios import DROPS, Log, Scenario

__all__ = ["BEFORE", "COLUMNS", "closest_brush", "detections_of", "pooled", "score"]

BEFORE = 0.98
"""Friction before a drop, and in logs without one."""
MIDWAY = 0.79
"""Level of the simplest warning: halfway from 0.98 to 0.60."""
AFTER = 8.0
"""Seconds after a drop from which the estimate is scored against the new friction."""

COLUMNS = (
    "estimator", "log", "use", "bias", "bias_brush", "std", "covered", "supported",
    "bias_after",
    "covered_after",
    *(f"{key}_{100 * after:.0f}" for after in DROPS for key in ("found", "delay")),
    "false_per_hour",
    *(f"below_{key}" for key in ("found", "delay", "false_per_hour")),
    "hours", "note",
)  # fmt: skip
"""Columns of table.csv, explained in README.md."""


def score(log: Log, trace: Trace) -> dict[str, float]:
    """Scores of one estimator on one log."""
    scenario, truth = log.scenario, log.truth["mu"]
    steady = np.isnan(scenario.drop)
    begin = SETTLE if steady else scenario.drop + AFTER
    error = accuracy(trace, truth, begin)
    alarm = detection(trace.time[trace.alarm], scenario.drop, scenario.duration)
    # The level does not detect a drop to 0.8.
    level = detection(crossings(trace, MIDWAY), scenario.drop, scenario.duration)
    return {
        **error._asdict(),
        "delay": alarm.delay,
        "false": alarm.false,
        "seconds": alarm.seconds,
        "below_delay": level.delay,
        "below_false": level.false,
    }


def _mean(rows: Iterable[Mapping[str, float]], key: str) -> float:
    values = np.array([row[key] for row in rows], float)
    return float(np.nanmean(values)) if np.isfinite(values).any() else np.nan


def detections_of(delays: Sequence[float]) -> tuple[float, float]:
    """Share of drops found, and their median delay [s]."""
    found = np.isfinite(delays)
    median = float(np.median(np.asarray(delays)[found])) if found.any() else np.nan
    return float(np.mean(found)), median


def closest_brush(log: Log) -> float:
    """Friction of the brush closest to the true forces of a steady log, over rows with at
    least a tenth of the load as force; NaN without longitudinal forces, where the true
    tire is a brush."""
    if not {"sigma_x", "fx"} <= log.truth.keys():
        return np.nan
    fz = log.columns["fz"]
    kept = np.flatnonzero(log.truth["fx"] > 0.1 * fz)[::20]
    sigma, share = log.truth["sigma_x"][kept], (log.truth["fx"] / fz)[kept]

    def missed(x):
        return brush(sigma, 1.0, 20.0, *x) - share

    return float(least_squares(missed, [9.0, 0.9], x_scale=[10, 1]).x[1])


def pooled(
    name: str,
    kind: str,
    use: float,
    scored: Sequence[tuple[Scenario, dict[str, float]]],
    brush_mu: float,
) -> dict[str, float | str]:
    """One row of the table: an estimator at one use of friction.

    Logs are weighted by their length, drops equally. ``brush_mu``: friction of the closest
    brush, NaN if the truth is a brush.
    """
    steady = [row for scenario, row in scored if np.isnan(scenario.drop)]
    by_drop = {
        after: [row for scenario, row in scored if scenario.after == after] for after in DROPS
    }
    deep = by_drop[DROPS[0]]
    bias = _mean(steady, "bias")
    spread = [row["std"] ** 2 + (row["bias"] - bias) ** 2 for row in steady]
    finite = np.isfinite(spread)
    hours = sum(row["seconds"] for _, row in scored) / 3600
    line: dict[str, float | str] = {
        "estimator": name,
        "log": kind,
        "use": use,
        "bias": bias,
        "bias_brush": bias + BEFORE - brush_mu,
        "std": float(np.sqrt(np.mean(np.array(spread)[finite]))) if any(finite) else np.nan,
        "covered": _mean(steady, "covered"),
        "supported": _mean(steady, "supported"),
        "bias_after": _mean(deep, "bias"),
        "covered_after": _mean(deep, "covered"),
    }
    for after, rows in by_drop.items():
        share, delay = detections_of([row["delay"] for row in rows])
        line |= {f"found_{100 * after:.0f}": share, f"delay_{100 * after:.0f}": delay}
    share, delay = detections_of([row["below_delay"] for row in deep])
    # Before a drop to 0.8 friction is 0.98 too; the level misleads only after it.
    high = [row for scenario, row in scored if scenario.after != DROPS[1]]
    exposed = sum(row["seconds"] for row in high) / 3600
    return line | {
        "false_per_hour": sum(row["false"] for _, row in scored) / hours,
        "below_found": share,
        "below_delay": delay,
        "below_false_per_hour": sum(row["below_false"] for row in high) / exposed,
        "hours": hours,
        "note": "",
    }
