"""The curve of a tire as data, to fit another model to it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tirefit.data.table import Source, TireData
from tirefit.fitting.predict import predict
from tirefit.fitting.problem.likelihood import CHANNEL_SLIP, row_moments
from tirefit.fitting.result import FitResult
from tirefit.models import AbstractTire


def curve(
    tire: AbstractTire | str,
    force: str,
    slips: np.ndarray,
    loads: Sequence[float],
    *,
    values: Mapping[str, float] | None = None,
    v: float | None = None,
    source: Source | None = None,
) -> TireData:
    """The pure-slip curve of a tire over slip and load, as if measured.

    The loads are the runs and the slips of each are ascending: the misfit of another model is then
    an autocorrelated residual, which reduces the effective number of rows.

    Args:
        tire: the tire, or the name of a model.
        force: ``fx`` or ``fy``.
        slips: sigma_x or alpha [rad], shape (n,), ascending.
        loads: F_z [N].
        values: parameter values that replace those of the tire.
        v: forward speed [m/s]; None: the data have none.
        source: the origin of the curve.

    Returns:
        Data of len(loads) n rows.

    Raises:
        UsageError: unknown model or parameter, value out of bounds, 32-bit floats.
        DataError: the tire needs a speed.
    """
    columns = {
        CHANNEL_SLIP[force]: np.tile(np.asarray(slips, float), len(loads)),
        "fz": np.repeat(np.asarray(loads, float), len(slips)),
    }
    if v is not None:
        columns["v"] = np.full(len(columns["fz"]), float(v))
    rows = TireData(
        "curve",
        columns,
        np.full(len(columns["fz"]), True),
        np.repeat(np.arange(len(loads)), len(slips)),
        tuple(f"F_z {load:g} N" for load in loads),
        source or Source(),
    )
    return replace(rows, columns=columns | {force: predict(tire, rows, values)[force]})


def misfit_by_load(result: FitResult) -> dict[float, float]:
    """Load [N] -> rms misfit of the fitted curve [N]."""
    problem = result.problem
    (force,) = result.forces
    mean, _ = row_moments(problem, result.z)
    residual = problem.used(problem.rows.observed[force]) - mean[force]
    fz = problem.used(problem.rows.inputs.fz)
    return {
        float(load): float(np.sqrt(np.mean(residual[fz == load] ** 2))) for load in np.unique(fz)
    }
