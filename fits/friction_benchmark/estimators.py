"""Runs all registered methods of tirefit on the logs of the benchmark."""

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from fits.friction_benchmark.metrics import Trace
from fits.friction_benchmark.scenarios import Log
from tirefit.models import LuGre, TireInputs, forces
from tirefit.online.base import Flag, code
from tirefit.online.methods import METHODS, estimator_of
from tirefit.online.run import run
from tirefit.params import parameter_values, with_values
from tirefit.sim.braking import LOAD, STIFFNESS, source_tire

__all__ = ["Answer", "lacking", "matched_lugre", "settings_of", "surprises", "traces"]


class Answer(NamedTuple):
    """Result for one log: the trace, and (time, surprise) of the steps with one (k, 2)."""

    trace: Trace
    surprise: np.ndarray


@cache
def matched_lugre() -> dict[str, float]:
    """The steady LuGre tire closest to the braked wheel's tire: in S section 3.4 all
    other parameters are fitted before theta is observed."""
    kappa = np.geomspace(0.001, 0.5, 100)  # beyond the peak, which determines the fall of g
    sigma, one = kappa / (1 - kappa), np.ones(100)
    curve = np.asarray(source_tire().pure(kappa, LOAD)) / LOAD
    names = ("sigma0", "mu_s", "mu_c")

    def missed(logs):
        values = dict(zip(names, np.exp(logs), strict=True))
        tire = with_values(LuGre(), values)
        at = TireInputs(sigma_x=sigma, fz=one, v=20 * one)
        return np.asarray(forces(tire, at).fx) - curve

    best = least_squares(missed, np.log([150.0, 1.2, 0.6]))
    return dict(zip(names, np.exp(best.x).tolist(), strict=True))


def settings_of(name: str, kind: str) -> dict[str, float]:
    """Settings of a method for a log, in addition to its defaults."""
    if name == "lugre-observer":
        return matched_lugre()
    if name == "cubic":  # it is the one that follows from the load, but known
        return {"cpa2": STIFFNESS / 2}
    return {"slope": STIFFNESS / LOAD} if kind == "braking" and "slip" in name else {}


def lacking(name: str, columns) -> str:
    """The reason why a method cannot run on a log; empty if it can."""
    method = METHODS[name].method
    missing = [c for c in ("time", *method.inputs) if c not in columns]
    if missing:
        return f"the log has no {', '.join(missing)}"
    return ""


def _closed(name: str, load: float):
    """The method without its reaction to alarms: it does not widen its uncertainty, so its
    surprises before the first alarm are the same at any threshold."""
    kind: Any = METHODS[name]

    class Closed(kind):
        def open(self, state):
            return state

    values = parameter_values(estimator_of(name, load))
    return with_values(Closed(), {k: float(v) for k, v in values.items()})


def traces(name: str, logs: Sequence[Log], settings=None, *, deaf=False) -> list[Answer]:
    """Runs one method over logs, each from its start.

    Args:
        name: a key of ``METHODS``.
        logs: logs with the method's inputs, all of one load.
        settings: of the method.
        deaf: do not react to the method's own alarms.
    """
    columns = set.intersection(*(set(log.columns) for log in logs))
    joined = {key: np.concatenate([log.columns[key] for log in logs]) for key in sorted(columns)}
    sizes = [len(log.columns["time"]) for log in logs]
    joined["run"] = np.repeat(np.arange(len(logs), dtype=float), sizes)
    load = float(joined["fz"][0]) if "fz" in joined else 1.0
    estimator = _closed(name, load) if deaf else estimator_of(name, load, settings)
    _, rows = run(estimator, joined)
    mu = std = np.full(len(joined["time"]), np.nan)
    if "mu" in estimator.method.parameters:
        k = estimator.method.parameters.index("mu")
        mu, std = rows.value[:, k], rows.std[:, k]
    supported, alarm = rows.flag == 0, rows.flag == code(Flag.CHANGED)
    whole = Trace(joined["time"], mu, std, supported, alarm)
    ends = np.cumsum(sizes)
    answers = []
    for begin, end in zip(ends - sizes, ends, strict=True):
        part = slice(begin, end)
        made = np.isfinite(rows.surprise[part])
        pairs = np.c_[joined["time"][part], rows.surprise[part]][made]
        answers.append(Answer(Trace(*(column[part] for column in whole)), pairs))
    return answers


def surprises(name: str, logs: Sequence[Log]) -> list[np.ndarray]:
    """(time, surprise) (k, 2) of each log, without a reaction to alarms."""
    return [answer.surprise for answer in traces(name, logs, deaf=True)]
