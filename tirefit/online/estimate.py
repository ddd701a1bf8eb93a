"""Online estimates over a whole log, and on a stream of rows."""

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
    """Columns (n,) for the estimators: all rows, with missing values for bad ones.

    Time and speeds of bad rows are kept, to distinguish standstill from a lost sample.
    """
    kept = ("time", "v", "omega")
    columns = {
        name: values if name in kept else np.where(data.used, values, np.nan)
        for name, values in data.columns.items()
    }
    # A row with bad values in other columns must not count as a good row.
    return {**columns, "run": data.run.astype(float)}


def _check_time(data: TireData) -> None:
    """Raises DataError if the time never increases; a single row back is only flagged."""
    steps = np.diff(data["time"])[np.diff(data.run) == 0]
    if len(steps) and not np.any(steps > 0):
        reason = "the time never increases from one row to the next"
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
        data: a log in time order, a result of ``tirefit.read(file, mask_bad_rows=True)``, or a
            path, a frame, a mapping of column -> array; methods restart at a new run.
        methods: names of ``tirefit methods``, as a list or separated by commas.
        settings: values of the methods' settings by ``METHOD.NAME`` or ``NAME``.
        seed: of random numbers; rls, mit, ekf and cubic use none.

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
        value, std, flag, surprise, own_std = map(np.asarray, rows)
        done[name] = MethodEstimates(
            name,
            estimator.method.parameters,
            value,
            std,
            own_std,
            flag,
            surprise,
            {key: float(x) for key, x in parameter_values(estimator).items()},
        )
    return _estimates(data, columns, done, seed)


def _rate(name: str, data: TireData, chosen: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Samples per second of the log, for methods with a fixed rate."""
    if "rate" in chosen[name] or "rate" not in specs(METHODS[name]()):
        return {}
    steps = np.diff(data.columns["time"])
    steps = steps[np.isfinite(steps) & (steps > 0)]
    return {"rate": float(1 / np.median(steps))} if len(steps) else {}


def _usual_load(data: TireData, columns: Mapping[str, np.ndarray]) -> float:
    """The first load [N] of the log, as a stream knows no other."""
    loads = columns.get("fz", np.ones(1))
    there = loads[np.isfinite(loads) & (loads > 0)]
    if not len(there):
        reason = "no row can be used: none has a load"
        raise DataError(reason, "check fz", data.file)
    return float(there[0])


def _estimates(
    data: TireData,
    columns: Mapping[str, np.ndarray],
    done: Mapping[str, MethodEstimates],
    seed: int,
) -> Estimates:
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
    """Several methods on a stream; ``header`` is that of ``estimates.csv``.

    The expected stiffness follows from the first load, so the methods start with it.

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
        """The cells of the next row."""
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
