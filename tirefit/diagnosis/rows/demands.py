"""What data must be for a diagnosis to mean something: said with a remedy, else."""

import numpy as np

from tirefit.data.table import TireData
from tirefit.diagnosis.rows.rig import Rig
from tirefit.results import DataError, InputProblem

_LEAST_ROWS = 20
"""Rows that a diagnosis needs."""

_ABSURD = 1e4
"""Largest force over largest load from which units are wrong by more than a factor of a
thousand: of such numbers nothing can be said."""


def check_data(data: TireData) -> None:
    """Raises DataError where there is no load, are too few rows, or is a force far
    beyond all loads."""
    file = data.source.path or data.name
    if "fz" not in data:
        reason = "a diagnosis needs fz (load, N) for every row"
        remedy = "name its column with --column fz=HEADER, or --constant fz=4000"
        raise DataError(InputProblem(reason, remedy, file))
    if data.n < _LEAST_ROWS:
        reason = f"{data.n} usable rows: a diagnosis needs {_LEAST_ROWS} or more"
        raise DataError(InputProblem(reason, "measure more points", file))
    for force in sorted({"fx", "fy"} & set(data.columns)):
        most = np.max(np.abs(data.usable(force))) / _largest_load(data)
        if not most < _ABSURD:
            reason = f"{most:.0e} times the largest load: no tire's force"
            remedy = f"name the unit with --unit {force}=... or that of the load"
            raise DataError(InputProblem(reason, remedy, file, column=force))


def check_force_noise(data: TireData, channels: tuple[str, ...], rig: Rig) -> None:
    """Raises DataError where the stated noise of a force is beyond all loads."""
    fz = data.usable("fz")
    for channel in channels:
        column = f"{channel}_std"
        stated = data.usable(column) if column in data else rig.force_noise(channel, fz)
        if stated is not None and np.median(stated) > _largest_load(data):
            reason = f"noise of {np.median(stated):.3g}, beyond the largest load"
            of_rig = column not in data
            source = f"[noise] of the rig for {channel}" if of_rig else column
            at = channel if of_rig else column
            problem = InputProblem(
                reason, f"check the unit of the noise, {source}",
                data.source.path or data.name, column=at,
            )  # fmt: skip
            raise DataError(problem)


def _largest_load(data: TireData) -> float:
    return float(np.max(np.abs(data.usable("fz"))))
