"""Cells of like rows: what a Magic Formula is fitted to in place of every row.

Rows of one setting of the rig at nearly the same slips, load and camber say the same of
the coefficients. A cell stands for them with its mean inputs and mean force. How its
rows scatter about its mean is the noise of the measurement; by how much its mean misses
the formula is misfit, which more rows do not make smaller.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from tirefit.fitting.mf.noise_law import NoiseLaw, noise_law
from tirefit.fitting.mf.rows import ForceRows
from tirefit.models import TireInputs

_WIDTH = {"sigma_x": 0.005, "alpha": 0.005, "gamma": 0.005}
"""Of a cell at small slip [-], [rad]: a curve of stiffness factor B misses its mean by
(B width)^2 / 24 of the force, 0.1 % at B = 30."""

_FEWEST = 4096
"""Rows that are put into cells: fewer take no longer one by one."""

_WIDENS = 0.1
"""Slip from which on cells grow with it: there the curves are nearly straight."""

_SHARE = {"fz": 0.05, "pressure": 0.02, "v": 0.05}
"""Width of a cell over the value itself, of loads, pressures and speeds."""


class Cells(NamedTuple):
    """Cells of the rows of one force.

    ``inputs`` and ``observed`` (m,) are means over the ``rows`` (m,) of each, ``code``
    (n,) is the cell of each row, ``setting`` (m,) that of the rig. Cells are in the
    order of their setting and slips.
    """

    inputs: TireInputs
    observed: np.ndarray
    rows: np.ndarray
    code: np.ndarray
    setting: np.ndarray

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Means over the rows of each cell, (n,) -> (m,)."""
        return np.bincount(self.code, values, len(self.rows)) / self.rows

    def white_law(self, rows: ForceRows, predicted: np.ndarray) -> NoiseLaw:
        """Noise of one row, from the scatter within cells about ``predicted`` (n,)."""
        residual = rows.observed - predicted
        free = (1 - 1 / self.rows)[self.code]
        shared = free > 0
        if not np.any(shared):
            return NoiseLaw(0.0, 0.0, 0.0)
        scatter = (residual - self.mean(residual)[self.code])[shared]
        scatter = scatter / np.sqrt(free[shared])
        return noise_law(scatter, rows.column("fz")[shared], predicted[shared])


def cells_of(rows: ForceRows, setting: np.ndarray) -> Cells:
    """The cells of rows.

    Args:
        rows: of one force.
        setting: (n,) integers, which setting of the rig each row is at.
    """
    columns = {k: np.asarray(part) for k, part in rows.inputs._asdict().items()}
    # Of the forces none, but M_y depends on speed.
    names = [*_WIDTH, *(name for name in _SHARE if name != "v" or rows.force == "my")]
    places = [setting, *(_place(columns, name) for name in names)]
    if len(setting) < _FEWEST:
        places.append(np.arange(len(setting)))
    found, code = np.unique(np.stack(places), axis=1, return_inverse=True)
    code = code.ravel()
    count = np.bincount(code)
    means = {name: np.bincount(code, part) / count for name, part in columns.items()}
    observed = np.bincount(code, rows.observed) / count
    return Cells(TireInputs(**means), observed, count, code, found[0])


def _place(columns: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    """Number of the interval of one input, (n,)."""
    if name in _WIDTH:
        stretched = _WIDENS * np.arcsinh(columns[name] / _WIDENS)
        return np.rint(stretched / _WIDTH[name]).astype(int)
    logarithm = np.log(np.maximum(columns[name], 1e-9))
    return np.rint(logarithm / _SHARE[name]).astype(int)
