"""Condense rows into cells, to which a Magic Formula is fitted in place of the rows.

A cell holds the rows of one setting of the rig at nearly the same slips, load and
camber. It is fitted with its mean inputs and its mean force. The scatter of its rows
about their mean is measurement noise, which averages out over the rows. The difference
between its mean and the formula is misfit, which does not.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tirefit.fitting.mf.rows import ForceRows
from tirefit.fitting.noise import NoiseLaw, noise_law
from tirefit.models import TireInputs

_WIDTH = {"sigma_x": 0.005, "alpha": 0.005, "gamma": 0.005}
"""Width of a cell at small slip [-], [rad]. The force at the mean input of a cell
differs from the mean force by (B width)^2 / 24 of it: 0.1 % at B = 30."""

_FEWEST = 4096
"""Number of rows below which every row is a cell: so few take no longer to fit."""

_WIDENS = 0.1
"""Slip above which cells widen with the slip: the curves are nearly straight there."""

_SHARE = {"fz": 0.05, "pressure": 0.02, "v": 0.05}
"""Relative width of a cell in load, pressure and speed."""

_AT_FIRST = 0.05
"""Noise relative to the root mean square of the force, before the first residuals."""


class Cells(NamedTuple):
    """m cells of the n rows of one force, in the order of their setting and slips."""

    inputs: TireInputs  # (m,) means
    observed: np.ndarray  # (m,) means
    rows: np.ndarray  # (m,) number in the cell
    code: np.ndarray  # (n,) cell of each row
    setting: np.ndarray  # (m,) of the rig

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Mean of the values (n,) over the rows of each cell: (m,)."""
        return np.bincount(self.code, values, len(self.rows)) / self.rows

    def white_law(self, rows: ForceRows, predicted: np.ndarray) -> NoiseLaw:
        """Noise law of one row, from the scatter within the cells.

        Args:
            predicted: (n,) force of the formula at each row.
        """
        residual = rows.observed - predicted
        free = (1 - 1 / self.rows)[self.code]
        shared = free > 0
        if not np.any(shared):
            return NoiseLaw(0.0, 0.0, 0.0)
        scatter = (residual - self.mean(residual)[self.code])[shared]
        scatter = scatter / np.sqrt(free[shared])
        return noise_law(scatter, rows.column("fz")[shared], predicted[shared])


def cells_of(rows: ForceRows, setting: np.ndarray) -> Cells:
    """The cells of the rows of one force.

    Args:
        rows: n rows.
        setting: (n,) number of the setting of the rig at each row.
    """
    columns = {k: np.asarray(part) for k, part in rows.inputs._asdict().items()}
    # Of all forces and moments, only M_y depends on speed.
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
    """For each row (n,), the number of the interval that one input lies in."""
    if name in _WIDTH:
        stretched = _WIDENS * np.arcsinh(columns[name] / _WIDENS)
        return np.rint(stretched / _WIDTH[name]).astype(int)
    logarithm = np.log(np.maximum(columns[name], 1e-9))
    return np.rint(logarithm / _SHARE[name]).astype(int)


@dataclass(frozen=True)
class Group:
    """Cells of one force in pure or in combined slip, with their noise."""

    force: str
    pure: bool
    cells: Cells
    given: np.ndarray | None  # (m,) variance of each mean where noise is given
    white: NoiseLaw = NoiseLaw(0.0, 0.0)  # of one row
    misfit: NoiseLaw | None = None  # of a cell's mean less the formula
    each: float = 1.0  # cells per independent cell, as neighbours have similar misfit

    def variance(self, predicted: np.ndarray) -> np.ndarray:
        """Variance (m,) of each cell's mean about the formula.

        Args:
            predicted: (m,) force of the formula.
        """
        known = self.known(predicted)
        # A force that is zero everywhere gives no size: 1 N, or 1 N m.
        mean_square = float(np.mean(self.cells.observed**2)) or 1.0
        if self.misfit is None:
            return known + _AT_FIRST**2 * mean_square
        misfit = self.misfit.variance(np.asarray(self.cells.inputs.fz), predicted)
        return known + np.maximum(misfit, 1e-12 * mean_square)

    def row_variance(self, fz: np.ndarray, predicted: np.ndarray) -> np.ndarray:
        """Variance (n,) of single rows about the formula: noise and misfit."""
        misfit = self.misfit or NoiseLaw(0.0, 0.0)
        single = self.white.variance(fz, predicted)
        if self.given is not None:
            single = np.median(self.given * self.cells.rows)
        return single + misfit.variance(fz, predicted)

    def known(self, predicted: np.ndarray) -> np.ndarray:
        """Variance (m,) of each cell's mean from measurement noise alone."""
        if self.given is not None:
            return self.given
        return self.white.variance(self.cells.inputs.fz, predicted) / self.cells.rows

    def part(self, chosen: np.ndarray) -> "Group":
        """The group of the ``chosen`` cells, (m,) bool; their rows have no code."""
        cells, given = self.cells, self.given
        inputs = TireInputs(*(np.asarray(column)[chosen] for column in cells.inputs))
        observed, rows = cells.observed[chosen], cells.rows[chosen]
        some = Cells(inputs, observed, rows, np.zeros(0, int), cells.setting[chosen])
        given = None if given is None else given[chosen]
        return replace(self, cells=some, given=given)


def groups_of(
    rows: Mapping[str, ForceRows], settings: Mapping[str, np.ndarray], both: bool
) -> dict[str, list[Group]]:
    """The groups of each force: pure slip, then combined slip if ``both``.

    Args:
        settings: by force, the setting of the rig (n,) of each row.
        both: whether to include the rows of combined slip.
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
