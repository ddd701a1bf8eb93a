"""Measured rows for a Magic Formula: files put together, one force at a time."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from tirefit.data.table import Source, TireData, join
from tirefit.fitting.config import FitConfig
from tirefit.fitting.mf.parts import PARTS, SLIPS_OF, part_of
from tirefit.fitting.problem import force_scale
from tirefit.models import TireInputs
from tirefit.results import DataError, InputProblem

__all__ = ["ForceRows", "NoiseLaw", "joined", "noise_law", "rows_of_forces"]

_FEWEST = 30
"""Rows of a force, at least: it has some 20 coefficients in pure slip."""

_ASIDE = {
    "sigma_x": "the tire rolls freely",
    "alpha": "the tire runs straight",
    "gamma": "the tire stands upright",
    "pressure": "the pressure is the nominal one",
}
"""Column that a test may leave out -> what then holds."""


class NoiseLaw(NamedTuple):
    """Variance of one measurement: constant^2 + (share F_z)^2."""

    constant: float
    share: float

    def std(self, fz):
        """Standard deviation [N, N m] at loads fz [N], any shape."""
        return np.sqrt(self.constant**2 + (self.share * fz) ** 2)


@dataclass(frozen=True)
class ForceRows:
    """The rows of one force: ``inputs`` and ``observed`` (n,), ``std`` (n,) of their
    noise, which is ``estimated`` or given; ``run`` and ``place`` (n,) are the run and
    the number of the row among the used ones; ``parts``: which rows each takes."""

    force: str
    inputs: TireInputs
    observed: np.ndarray
    std: np.ndarray
    estimated: bool
    run: np.ndarray
    parts: dict[str, np.ndarray]

    def column(self, name: str) -> np.ndarray:
        """One of the inputs, (n,)."""
        return np.asarray(getattr(self.inputs, name))


def joined(tables: Sequence[TireData]) -> TireData:
    """Files as runs of one data set; what a file lacks is what its test left out.

    A file without a slip or camber was measured at zero, one without a pressure at the
    nominal one, and one without a force says nothing of it (NaN).
    """
    if len(tables) == 1:
        return tables[0]
    names = dict.fromkeys(name for table in tables for name in table.columns)
    wanted = [name for name in names if name in (*_ASIDE, *SLIPS_OF)]
    return join([_filled(table, wanted) for table in tables])


def _filled(table: TireData, names: Sequence[str]) -> TireData:
    missing = {
        name: np.full(len(table), 0.0 if name in _ASIDE else np.nan)
        for name in names
        if name not in table
    }
    said = tuple(
        f"no column {name}: {_ASIDE[name]}" for name in missing if name in _ASIDE
    )
    source: Source = replace(
        table.source, assumptions=(*table.source.assumptions, *said)
    )
    return replace(table, columns={**table.columns, **missing}, source=source)


def rows_of_forces(
    data: TireData, forces: Sequence[str], config: FitConfig
) -> dict[str, ForceRows]:
    """The rows of every force that the data hold with its slip, those of M_x beside
    F_y, which it takes from the model.

    Raises:
        DataError: a force has fewer than 30 rows, or none is there with its slip.
    """
    rows = {}
    for force in forces:
        if force not in data or not any(slip in data for slip in SLIPS_OF[force]):
            continue
        if force == "mx" and "fy" not in rows:
            continue
        there = np.isfinite(data.columns[force]) & data.used
        if not np.any(there):
            continue
        if np.count_nonzero(there) < _FEWEST:
            raise DataError(
                InputProblem(
                    f"{np.count_nonzero(there)} rows of {force}: a Magic Formula needs"
                    f" {_FEWEST} at least",
                    "measure more, or fit a brush model",
                    data.source.path or data.name,
                )
            )
        rows[force] = _rows_of(replace(data, used=there), force, config)
    if not rows:
        raise DataError(
            InputProblem(
                f"no {' or '.join(forces)} with its slip: a fit needs fx with sigma_x"
                " (or kappa, s), fy and mz with alpha, mx with alpha and fy",
                "see `tirefit inspect`",
                data.source.path or data.name,
            )
        )
    return rows


def _rows_of(data: TireData, force: str, config: FitConfig) -> ForceRows:
    def column(name):
        return data.usable(name) if name in data else np.zeros(data.n)

    inputs = TireInputs(*(np.nan_to_num(column(name)) for name in TireInputs._fields))
    std, estimated, _ = force_scale(data, force, config.noise)
    return ForceRows(
        force, inputs, data.usable(force), np.asarray(std, float), estimated,
        data.run[data.used], {part: part_of(part, data, force) for part in PARTS},
    )  # fmt: skip


def noise_law(residual: np.ndarray, fz: np.ndarray) -> NoiseLaw:
    """The law whose squares the residuals (n,) follow best, at loads fz (n,) [N].

    Squares of residuals are regressed on 1 and F_z^2, each row weighted by its own
    variance, twice the square of which is that of a square; neither share is negative.
    """
    scale = float(np.mean(residual**2)) or 1e-18
    size = float(np.mean(fz**2))
    terms = np.stack([np.full(len(fz), 1.0), fz**2 / size], axis=1)
    shares = np.array([0.5, 0.5])
    for _ in range(20):
        variance = terms @ shares + 1e-9
        weighted = terms / variance[:, None]
        # The normal equations: two unknowns, whatever the number of rows.
        upper = np.linalg.cholesky(weighted.T @ weighted + 1e-9 * np.eye(2)).T
        aim = np.linalg.solve(upper.T, weighted.T @ (residual**2 / scale / variance))
        shares, last = nnls(upper, aim)[0], shares
        if np.max(np.abs(shares - last)) < 1e-4:
            break
    constant, share = np.sqrt(shares * scale)
    return NoiseLaw(float(constant), float(share / np.sqrt(size)))
