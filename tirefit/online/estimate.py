"""Online estimates over a whole log; :class:`tirefit.online.run.Stream` takes single rows."""

from collections.abc import Mapping, Sequence

import numpy as np

from tirefit import __version__
from tirefit.data.accept import DataLike, as_data
from tirefit.data.read import require
from tirefit.data.table import TireData
from tirefit.online.methods import METHODS, estimator_of
from tirefit.online.result import Estimates, MethodEstimates
from tirefit.online.run import run
from tirefit.params import by_owner, check_names, parameter_values, specs
from tirefit.precision import require_x64
from tirefit.results import DataError


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


def estimate(
    data: DataLike,
    methods: str | Sequence[str] = "rls",
    settings: Mapping[str, float] | None = None,
) -> Estimates:
    """Estimate friction and stiffness row by row, as while driving.

    Args:
        data: a log in time order, a result of ``tirefit.read(file, mask_bad_rows=True)``, or a
            path, a frame, a mapping of column -> array; methods restart at a new run.
        methods: names of ``tirefit methods``, as a list or separated by commas.
        settings: values of the methods' settings by ``METHOD.NAME`` or ``NAME``.

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
    # A single row back is only flagged.
    steps = np.diff(data["time"])[np.diff(data.run) == 0]
    if len(steps) and not np.any(steps > 0):
        reason = "the time never increases from one row to the next"
        remedy = "sort the rows by time, or name its column: --column time=HEADER"
        raise DataError(reason, remedy, data.file, column="time")
    load = _usual_load(data, columns)
    done = {}
    for name in names:
        estimator = estimator_of(name, load, chosen[name] | _rate(name, data, chosen))
        value, std, flag, surprise, own_std = map(np.asarray, run(estimator, columns)[1])
        used = {key: float(x) for key, x in parameter_values(estimator).items()}
        parameters = estimator.method.parameters
        rows = (value, std, own_std, flag, surprise)
        done[name] = MethodEstimates(name, parameters, *rows, used)
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
    use = columns["fx"] / columns["fz"] if {"fx", "fz"} <= columns.keys() else None
    return Estimates(columns["time"], use, done, about, __version__)


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
