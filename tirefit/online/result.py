"""The result of ``tirefit estimate``: all rows, final estimates, flags, changes."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tirefit.data.write import csv_text
from tirefit.display import Record
from tirefit.files import json_safe
from tirefit.online.base import FLAGS, PARAMETERS, Flag, code
from tirefit.online.methods import METHODS
from tirefit.results import Outcome

SCHEMA = "tirefit.estimate/1"


@dataclass(frozen=True)
class Change:
    """A parameter that a detected change moved, and the time [s] of the detection."""

    time: float
    parameter: str
    before: float
    after: float


@dataclass(frozen=True)
class MethodEstimates:
    """One method over a log."""

    name: str
    parameters: tuple[str, ...]
    value: np.ndarray  # (n, p)
    std: np.ndarray  # (n, p)
    own_std: np.ndarray  # (n, p) by the method alone, for :func:`changes`
    flag: np.ndarray  # (n,) codes
    surprise: np.ndarray  # (n,) [-]
    settings: Mapping[str, float]  # values of its fields

    def __getitem__(self, parameter: str) -> np.ndarray:
        """Estimates (n,) of one parameter."""
        return self.value[:, self.parameters.index(parameter)]

    def std_of(self, parameter: str) -> np.ndarray:
        """Standard deviations (n,) of one parameter."""
        return self.std[:, self.parameters.index(parameter)]

    @property
    def reasons(self) -> list[str]:
        """The flag of each row as text, empty without a flag."""
        return [FLAGS[k].value for k in self.flag]

    def counts(self) -> dict[str, int]:
        """Reason -> rows flagged with it, in the order of severity."""
        return {
            flag.value: int(rows)
            for flag in FLAGS[1:]
            if (rows := np.count_nonzero(self.flag == code(flag)))
        }


@dataclass(frozen=True, repr=False)
class Estimates(Record):
    """Online estimates of one or more methods over one log.

    ``time`` (n,) [s]; ``use`` (n,): force over load; ``data``: name, file, sha256,
    rows, convention, assumptions of the log.
    """

    text_by: ClassVar[str] = "tirefit.report.estimates:estimates_text"
    plot_by: ClassVar[str] = "tirefit.report.estimates:estimates_figure"

    time: np.ndarray
    use: np.ndarray | None
    methods: Mapping[str, MethodEstimates]
    data: Mapping[str, Any]
    version: str

    @property
    def limits(self) -> dict[Outcome, str]:
        """The methods whose last estimate its sample does not support, and why."""
        last = {name: method.reasons[-1] for name, method in self.methods.items()}
        message = (f"{name}, last row: {why}" for name, why in last.items() if why)
        return {Outcome.NOT_IDENTIFIED: "; ".join(message)}

    def __getitem__(self, name: str) -> MethodEstimates:
        return self.methods[name]

    def columns(self) -> dict[str, Any]:
        """``estimates.csv``: the header of each column -> (n,) values."""
        table: dict[str, Any] = {"time": self.time}
        for name, method in self.methods.items():
            for parameter in method.parameters:
                table[f"{name}_{parameter}"] = method[parameter]
                table[f"{name}_{parameter}_std"] = method.std_of(parameter)
            table[f"{name}_flag"] = method.reasons
        return table

    def files(self, name: str = "") -> dict[str, str]:
        """``estimates.csv`` and ``summary.json``."""
        rows = csv_text(self.columns())
        return {"estimates.csv": rows, "summary.json": self.to_json()}

    def to_dict(self) -> dict[str, Any]:
        """``summary.json``."""
        units, methods = dict[str, str](), dict[str, Any]()
        for name, method in self.methods.items():
            final = {}
            for key in method.parameters:
                units[key] = PARAMETERS[key].unit
                last = {"value": method[key][-1], "std": method.std_of(key)[-1]}
                final[key] = last | {"unit": units[key]}
            methods[name] = {
                "final": final, "model": METHODS[name].method.model,
                "supported": bool(method.flag[-1] == 0), "flags": method.counts(),
                "changes": [vars(change) for change in changes(self.time, method)],
                "settings": dict(method.settings),
            }  # fmt: skip
        content = {
            "schema": SCHEMA, "version": self.version,
            "convention": "braking, SI", "units": units, "data": dict(self.data),
            "methods": methods,
        }  # fmt: skip
        return json_safe(content)


def changes(time: np.ndarray, method: MethodEstimates) -> list[Change]:
    """Parameters that a detected change moved permanently, by time.

    "Before" is the estimate shortly before the detection, "after" that at the next
    detection or the end. A detection without a move of three standard deviations (of
    both together, by the method alone) was a false alarm, which is only flagged.
    """
    alarms = np.flatnonzero(method.flag == code(Flag.CHANGED))
    ends = [*(alarms[1:] - 1), len(time) - 1][: len(alarms)]
    there = []
    for alarm, end in zip(alarms, ends, strict=True):
        # Rows before an alarm in which a change may already have moved the estimate.
        early = max(int(alarm) - 20, 0)
        for k, parameter in enumerate(method.parameters):
            before, after = method.value[early, k], method.value[end, k]
            spread = np.hypot(method.own_std[early, k], method.own_std[end, k])
            # A detected change is reported if the estimate moved by this many standard deviations.
            if abs(after - before) > 3.0 * spread:
                there.append(Change(float(time[alarm]), parameter, float(before), float(after)))
    return there
