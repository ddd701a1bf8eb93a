"""Online estimates over a whole log, and on rows as they come."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from tirefit import __version__
from tirefit.data.accept import DataLike, as_data
from tirefit.data.read import require
from tirefit.data.table import CANONICAL, TireData
from tirefit.online.base import FLAGS, Estimate, Flag
from tirefit.online.methods import METHODS, estimator_of
from tirefit.online.result import Estimates, MethodEstimates
from tirefit.online.run import Stream, run
from tirefit.params import by_owner, check_names, parameter_values, specs
from tirefit.precision import require_x64
from tirefit.results import DataError, InputProblem


def log_columns(data: TireData) -> dict[str, np.ndarray]:
    """Columns (n,) for the estimators: all rows, the values of bad ones missing.

    Time and speeds stay even in a bad row: they tell a standstill from a lost sample.
    """
    kept = ("time", "v", "omega")
    columns = {
        name: values if name in kept else np.where(data.used, values, np.nan)
        for name, values in data.columns.items()
    }
    # A row whose other values are bad must not pass for a good one without them.
    return {**columns, "run": data.run.astype(float)}


def _check_time(data: TireData) -> None:
    """Raises DataError where the time never goes on: one row back is but a flag."""
    steps = np.diff(data["time"])[np.diff(data.run) == 0]
    if len(steps) and not np.any(steps > 0):
        reason = "the time never goes on from one row to the next"
        remedy = "sort the rows by time, or name its column: --column time=HEADER"
        file = data.file
        raise DataError(reason, remedy, file, column="time")


def estimate(
    data: DataLike,
    methods: str | Sequence[str] = "rls",
    settings: Mapping[str, float] | None = None,
    *,
    seed: int = 0,
) -> Estimates:
    """Estimate friction and stiffness row by row, as while driving.

    Args:
        data: a log in time order, as ``tirefit.read(file, mask_bad_rows=True)`` gives
            it, or a path, a frame, a mapping of column to array; a new run starts every
            method anew.
        methods: names of ``tirefit methods``, one by one or with commas.
        settings: values of the methods' settings by ``METHOD.NAME`` or ``NAME``.
        seed: of everything random; none of rls, mit, ekf and cubic has any.

    Returns:
        By method the estimates of every row with standard deviations and flags.

    Raises:
        UsageError: an unknown method or setting; 32-bit floats.
        DataError: a needed column is missing, no row is usable, or time stands still.

    Example:
        >>> found = estimate(simulate("braking", teeth=2, seed=1).columns, "rls,cubic")
        >>> found["rls"]["mu"].shape, found.warnings
        ((400,), ('cubic, last row: friction used too little for mu',))
    """
    require_x64("an online estimate")
    data = as_data(data, mask_bad_rows=True, curve=False)
    names = check_names("method", methods, METHODS)
    chosen = by_owner(settings or {}, {name: METHODS[name]() for name in names})
    for name in names:
        require(data, ("time", *METHODS[name].method.inputs), f"method {name!r}")
    columns = log_columns(data)
    _check_time(data)
    load = _usual_load(data, columns)
    done = {}
    for name in names:
        estimator = estimator_of(name, load, chosen[name] | _rate(name, data, chosen))
        _, rows = run(estimator, columns)
        value, std, flag, surprise = map(np.asarray, rows)
        done[name] = MethodEstimates(
            name,
            estimator.method.parameters,
            value,
            std,
            flag,
            surprise,
            {key: float(x) for key, x in parameter_values(estimator).items()},
        )
    return _estimates(data, columns, done, seed)


def _rate(name: str, data: TireData, chosen) -> dict[str, float]:
    """Samples a second of the log, for a method that is made for one rate."""
    if "rate" in chosen[name] or "rate" not in specs(METHODS[name]()):
        return {}
    steps = np.diff(data.columns["time"])
    steps = steps[np.isfinite(steps) & (steps > 0)]
    return {"rate": float(1 / np.median(steps))} if len(steps) else {}


def _usual_load(data: TireData, columns: Mapping[str, np.ndarray]) -> float:
    """The first load [N] that is there: a stream knows no other."""
    loads = columns.get("fz", np.ones(1))
    there = loads[np.isfinite(loads) & (loads > 0)]
    if not len(there):
        reason = "no row can be used: none has a load"
        raise DataError(reason, "check fz", data.file)
    return float(there[0])


def _estimates(data, columns, done, seed) -> Estimates:
    source = data.source
    about = {
        "name": data.name,
        "file": source.path,
        "sha256": source.sha256,
        "rows": len(data),
        "used": data.n,
        "runs": list(data.runs),
        "convention": source.convention,
        "assumptions": list(source.notes),
    }
    use = None
    if "fx" in columns and "fz" in columns:
        use = columns["fx"] / columns["fz"]
    return Estimates(columns["time"], use, done, about, seed, __version__)


class Streams:
    """Methods beside each other; ``header`` is that of ``estimates.csv``.

    The expected stiffness comes from the first load, so nothing starts before it.

    Args:
        names: methods.
        settings: of each method, by its name.
        columns: canonical columns that every row has.

    Raises:
        DataError: a column that a method needs is missing.
    """

    def __init__(
        self,
        names: Sequence[str],
        settings: Mapping[str, Mapping[str, float]],
        columns: Sequence[str],
    ):
        problems = [
            InputProblem(
                f"method {name!r} needs {column} ({CANONICAL[column][1]}), which the"
                " rows do not have",
                f"name its column with --column {column}=HEADER",
            )
            for name in names
            for column in ("time", *METHODS[name].method.inputs)
            if column not in columns
        ]
        DataError.raise_for(problems)
        self._settings = {name: settings.get(name, {}) for name in names}
        self._streams: dict[str, Stream] = {}

    @property
    def header(self) -> list[str]:
        head = ["time"]
        for name in self._settings:
            for parameter in METHODS[name].method.parameters:
                head += [f"{name}_{parameter}", f"{name}_{parameter}_std"]
            head.append(f"{name}_flag")
        return head

    def push(self, row: Mapping[str, float]) -> list[str]:
        """The cells of one more row."""
        if not self._streams and row.get("fz", 1.0) > 0:
            load = row.get("fz", 1.0)
            self._streams = {
                name: Stream(estimator_of(name, load, settings))
                for name, settings in self._settings.items()
            }
        cells = [_cell(row["time"])]
        for name in self._settings:
            if self._streams:
                cells += _cells(self._streams[name].push(row))
            else:
                nothing = [""] * (2 * len(METHODS[name].method.parameters))
                cells += [*nothing, Flag.MISSING.value]
        return cells


def _cells(estimate: Estimate) -> list[str]:
    pairs = zip(np.asarray(estimate.value), np.asarray(estimate.std), strict=True)
    numbers = [_cell(float(number)) for pair in pairs for number in pair]
    return [*numbers, FLAGS[int(estimate.flag)].value]


def _cell(number: float) -> str:
    return "" if math.isnan(number) else repr(float(number))
