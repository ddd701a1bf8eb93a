"""Cells of like rows: what a Magic Formula is fitted to in place of every row.

Rows of one setting of the rig at nearly the same slips, load and camber say the same of
the coefficients. A cell stands for them with its mean inputs and mean force. How its
rows scatter about its mean is the noise of the measurement; by how much its mean misses
the formula is misfit, which more rows do not make smaller.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tirefit.fitting.mf.rows import ForceRows
from tirefit.fitting.noise_law import NoiseLaw, noise_law
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


_AT_FIRST = 0.05
"""Noise over the root mean square of the force, before any residual is known."""


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


@dataclass(frozen=True)
class Group:
    """Cells of one force in pure or in combined slip.

    ``white`` and ``misfit`` are the noise laws of one row and of a cell's mean beside
    it; ``each``: how many cells count as one, as neighbours miss the formula alike.
    """

    force: str
    pure: bool
    cells: Cells
    given: np.ndarray | None
    white: NoiseLaw = NoiseLaw(0.0, 0.0)
    misfit: NoiseLaw | None = None
    each: float = 1.0

    def variance(self, predicted: np.ndarray) -> np.ndarray:
        """Of each cell's mean (m,) about the formula; that is ``predicted`` (m,)."""
        fz = np.asarray(self.cells.inputs.fz)
        known = self.known(predicted)
        if self.misfit is None:
            return known + _AT_FIRST**2 * float(np.mean(self.cells.observed**2))
        least = 1e-12 * float(np.mean(self.cells.observed**2))
        return known + np.maximum(self.misfit.variance(fz, predicted), least)

    def row_variance(self, fz: np.ndarray, predicted: np.ndarray) -> np.ndarray:
        """Of single rows (n,) about the formula, as the misfit goes."""
        misfit = self.misfit or NoiseLaw(0.0, 0.0)
        single = self.white.variance(fz, predicted)
        if self.given is not None:
            single = np.median(self.given * self.cells.rows)
        return single + misfit.variance(fz, predicted)

    def known(self, predicted: np.ndarray) -> np.ndarray:
        """Part of the variance that the noise of single rows makes, (m,)."""
        if self.given is not None:
            return self.given
        return self.white.variance(self.cells.inputs.fz, predicted) / self.cells.rows

    def part(self, chosen: np.ndarray) -> "Group":
        """Some of the cells, chosen (m,) bool; their rows are not kept."""
        cells, given = self.cells, self.given
        inputs = TireInputs(*(np.asarray(column)[chosen] for column in cells.inputs))
        return replace(
            self,
            cells=Cells(
                inputs,
                cells.observed[chosen],
                cells.rows[chosen],
                np.zeros(0, int),
                cells.setting[chosen],
            ),
            given=None if given is None else given[chosen],
        )


def groups_of(
    rows: Mapping[str, ForceRows], settings: Mapping[str, np.ndarray], both: bool
) -> dict[str, list[Group]]:
    """Cells of pure slip and, where asked for, of combined slip, by force.

    Args:
        settings: by force, the setting of the rig (n,) of each row.
        both: whether rows of combined slip are taken.
    """
    groups: dict[str, list[Group]] = {}
    for force, of_force in rows.items():
        for is_pure in (True, False):
            chosen = of_force.chosen([is_pure])
            if np.any(chosen) and (is_pure or both):
                some = of_force.part(chosen)
                cells = cells_of(some, settings[force][chosen])
                given = None
                if not some.estimated:
                    given = cells.mean(some.std**2) / cells.rows
                group = Group(force, is_pure, cells, given)
                groups.setdefault(force, []).append(group)
    return groups
