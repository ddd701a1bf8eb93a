"""Runs every estimator on every log; returns the rows of the tables."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from time import perf_counter

import numpy as np

from fits.friction_benchmark.estimators import lacking, settings_of, surprises, traces
from fits.friction_benchmark.metrics import Trace, detection
from fits.friction_benchmark.page import DETECTORS
from fits.friction_benchmark.peers import PEERS
from fits.friction_benchmark.scenarios import DROPS, KINDS, Log, read_columns, read_index, read_log
from fits.friction_benchmark.scoring import COLUMNS, closest_brush, detections_of, pooled, score
from tirefit.online.methods import METHODS

__all__ = ["run_all"]

SURPRISED = ("rls", "ekf")
"""Methods that supply the surprises for the change detectors."""


def run_all(
    folder: Path, *, names: Sequence[str] = (), peers: bool = True, foreign: Path | None = None
) -> dict[str, list[dict]]:
    """Tables by name, as lists of rows.

    Args:
        folder: folder of the logs.
        names: tirefit's methods; all if empty.
        peers: also run other libraries; a missing one gets a row that states so.
        foreign: folder of traces of other estimators, NAME/LOG.csv.
    """
    logs = [read_log(folder, scenario) for scenario in read_index(folder)]
    by_kind = {k: [one for one in logs if one.scenario.kind == k] for k in KINDS}
    lines = []
    for name in names or METHODS:
        lines += _of_method(name, by_kind)
    for name, estimate in PEERS.items() if peers else ():
        lines += _of_peer(name, estimate, by_kind["braking"])
    lines += _of_others(foreign, logs) if foreign else []
    tables = {"scores": lines}
    tried = [n for n in SURPRISED if n in (names or METHODS)]
    if tried:
        tables["detectors"] = _detectors(tried, by_kind["braking"], peers)
    from fits.friction_benchmark.measured import measured_lines

    return tables | {"measured": measured_lines(names or METHODS, peers)}


def _of_method(name: str, by_kind: Mapping[str, Sequence[Log]]) -> list[dict]:
    """Rows of a method on every kind of log that has its inputs."""
    lines, reasons = [], []
    for kind, logs in by_kind.items():
        reason = lacking(name, logs[0].columns) if logs else "no logs"
        if reason:
            reasons.append(reason)
            continue
        began = perf_counter()
        answers = traces(name, logs, settings_of(name, kind))
        lines += _lines(f"tirefit {name}", logs, [answer.trace for answer in answers])
        print(f"{name}: {len(logs)} logs, {perf_counter() - began:.1f} s", flush=True)
    return lines or [_skipped(f"tirefit {name}", "; ".join(dict.fromkeys(reasons)))]


def _lines(name: str, logs: Sequence[Log], found: Sequence[Trace]) -> list[dict]:
    """A row for every kind of log and use of friction among the logs."""
    groups: dict[tuple[str, float], list[tuple[Log, Trace]]] = {}
    for log, trace in zip(logs, found, strict=True):
        key = (log.scenario.kind, log.scenario.use)
        groups.setdefault(key, []).append((log, trace))
    lines = []
    for (kind, use), pairs in sorted(groups.items()):
        scored = [(log.scenario, score(log, trace)) for log, trace in pairs]
        steady = [log for log, _ in pairs if np.isnan(log.scenario.drop)]
        nearest = closest_brush(steady[0]) if steady else np.nan
        lines.append(pooled(name, kind, use, scored, nearest))
    return lines


def _skipped(name: str, reason: str) -> dict:
    return dict.fromkeys(COLUMNS, "") | {"estimator": name, "note": f"skipped: {reason}"}


def _of_peer(name: str, estimate: Callable, logs: Sequence[Log]) -> list[dict]:
    try:
        found = [estimate(log.columns) for log in logs]
    except ImportError as missing:
        return [_skipped(name, f"{missing.name} is not installed")]
    print(f"{name}: {len(logs)} logs", flush=True)
    return _lines(name, logs, found)


def _of_others(folder: Path, logs: Sequence[Log]) -> list[dict]:
    lines = []
    for one in sorted(path for path in folder.iterdir() if path.is_dir()):
        there = [log for log in logs if (one / f"{log.scenario.name}.csv").exists()]
        if there:
            found = [_foreign(one / f"{log.scenario.name}.csv", log) for log in there]
            lines += _lines(one.name, there, found)
    return lines


def _foreign(path: Path, log: Log) -> Trace:
    """A trace from a file, with the same rows as the log."""
    columns = read_columns(path)
    missing = [name for name in Trace._fields if name not in columns]
    if missing or len(columns["time"]) != len(log.columns["time"]):
        rows = len(log.columns["time"])
        raise ValueError(f"{path}: {missing or 'rows'} missing; {rows} rows are needed")
    values = [columns[name] for name in Trace._fields]
    return Trace(*values[:3], *(value == 1 for value in values[3:]))


def _detectors(
    names: Sequence[str], logs: Sequence[Log], peers: bool
) -> list[dict[str, float | str]]:
    """Rows of every detector at every threshold on the surprises of every method."""
    lines: list[dict[str, float | str]] = []
    for name in names:
        series = surprises(name, logs)
        for detector, (detect, thresholds) in DETECTORS.items():
            if detector != "page (tirefit)" and not peers:
                continue
            for threshold in thresholds:
                try:
                    times = [s[detect(s[:, 1], threshold), 0] for s in series]
                except ImportError as missing:
                    print(f"{detector}: {missing.name} is not installed")
                    break
                lines += _at(detector, name, threshold, logs, times)
        print(f"detectors on {name}", flush=True)
    return lines


def _at(detector, name, threshold, logs, times):
    head = {"detector": detector, "surprise_of": name, "threshold": threshold}
    for use in KINDS["braking"][1]:
        kept = [
            (log.scenario, detection(when, log.scenario.drop, log.scenario.duration))
            for log, when in zip(logs, times, strict=True)
            if log.scenario.use == use
        ]
        if not kept:
            continue
        hours = sum(one.seconds for _, one in kept) / 3600
        line = head | {"use": use}
        for after in DROPS:
            delays = [one.delay for s, one in kept if s.after == after]
            share, delay = detections_of(delays) if delays else (np.nan, np.nan)
            percent = f"{100 * after:.0f}"
            line |= {f"found_{percent}": share, f"delay_{percent}": delay}
        false = sum(one.false for _, one in kept)
        yield line | {"false_per_hour": false / hours, "hours": hours}
