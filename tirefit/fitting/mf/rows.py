"""The measured rows of each force, from one or more files, and their cells.

A Magic Formula is fitted to cells in place of the rows. A cell holds the rows of one
setting of the rig at nearly the same slips, load and camber. It is fitted with its mean
inputs and its mean force. The scatter of its rows about their mean is measurement noise,
which averages out over the rows. The difference between its mean and the formula is
misfit, which does not.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tirefit.data.table import TireData, join
from tirefit.data.tir.tir import PRESSURES
from tirefit.fitting.mf.parts import MOMENTS, PARTS, SLIPS_OF, is_pure, parts_named
from tirefit.fitting.problem.build import force_scale
from tirefit.fitting.problem.config import FitConfig
from tirefit.fitting.problem.noise import NoiseLaw, noise_law
from tirefit.models import TireInputs
from tirefit.results import DataError

_FEWEST = 30
"""Smallest number of rows of a force, which has some 20 coefficients in pure slip."""

_ASIDE = {
    "sigma_x": "the tire rolls freely",
    "alpha": "the tire runs straight",
    "gamma": "the tire stands upright",
    "pressure": "the pressure is the nominal one",
}
"""Column that a test may lack -> the state that is then assumed."""


@dataclass(frozen=True)
class ForceRows:
    """The rows of one force, or its cells: each the mean of some rows."""

    force: str
    inputs: TireInputs
    observed: np.ndarray
    std: np.ndarray  # (n,) of the noise, which is given unless ``estimated``
    estimated: bool
    run: np.ndarray  # (n,) number of the run
    pure: np.ndarray  # (n,) rows of pure slip; none if too few to be fitted alone
    setting: np.ndarray  # (n,) number of the setting of the rig, zero before it is known
    count: np.ndarray  # (n,) rows of each cell; of rows, one

    def column(self, name: str) -> np.ndarray:
        """One of the inputs, (n,)."""
        return np.asarray(getattr(self.inputs, name))

    def chosen(self, kinds: Sequence[bool]) -> np.ndarray:
        """Which rows (n,) are among the kinds: pure (True) or combined slip (False)."""
        return np.isin(self.pure, kinds)

    def part(self, chosen: np.ndarray) -> "ForceRows":
        """The chosen rows, by bool (n,) or by number."""
        inputs = TireInputs(*(np.asarray(column)[chosen] for column in self.inputs))
        names = ("observed", "std", "run", "pure", "setting", "count")
        return replace(self, inputs=inputs, **{k: getattr(self, k)[chosen] for k in names})


def joined(tables: Sequence[TireData]) -> TireData:
    """Join files as runs of one data set.

    A file without a slip or camber counts as measured at zero, one without a pressure
    at the nominal pressure. A missing force is NaN.
    """
    if len(tables) == 1:
        return tables[0]
    names = dict.fromkeys(name for table in tables for name in table.columns)
    wanted = [name for name in names if name in (*_ASIDE, *SLIPS_OF)]
    filled = []
    for table in tables:
        lost = {name: _ASIDE.get(name) for name in wanted if name not in table}
        empty = {name: np.full(len(table), 0.0 if why else np.nan) for name, why in lost.items()}
        messages = (f"no column {name}: {why}" for name, why in lost.items() if why)
        assumptions = (*table.source.assumptions, *messages)
        source = replace(table.source, assumptions=assumptions)
        filled.append(replace(table, columns={**table.columns, **empty}, source=source))
    return join(filled)


def rows_of_part(
    whole: TireData, part: str, config: FitConfig
) -> tuple[Mapping[str, ForceRows], list[str]]:
    """The rows of the forces of a part, and what to say of them.

    Raises:
        DataError: the part's own rows are not there, or a pressure that no tire has.
    """
    parts = parts_named(part)
    forces = list(dict.fromkeys(f for name in parts for f in PARTS[name].forces))
    forces = [force for force in forces if force != "mz" or part not in MOMENTS]
    rows = rows_of_forces(whole, forces, config)
    pressures = next(iter(rows.values())).column("pressure")
    pressures = pressures[pressures > 0]
    lacking = "mx is not fitted: the data have no fy, from which the model computes it"
    if len(pressures) and not PRESSURES[0] <= np.median(pressures) <= PRESSURES[1]:
        reason = f"a median pressure of {np.median(pressures):g} Pa, which no tire has"
        remedy = "name the unit of its column, as in --unit pressure=bar"
        raise DataError(reason, remedy, whole.file)
    if "combined" not in parts and not np.any(rows[part].pure):
        reason = f"--part {part}: the data have too few rows of {part} in pure slip"
        remedy = "leave out --part: its rows of combined slip are fitted too"
        raise DataError(reason, remedy, whole.file)
    if part in MOMENTS and part not in rows:
        reason = lacking if part in whole else f"the data have no {part}"
        raise DataError(reason, f"leave out --part {part}, or see `tirefit inspect`", whole.file)
    notes = [lacking] if "mx" in {*parts} & {*whole.columns} - {*rows} else []
    if "mz" in rows and "fy" not in rows:
        notes.append(
            "mz is the trail times fy, which is not fitted: fy is as borrowed,"
            " given, or that of the priors, and the trail makes up for it"
        )
    return rows, notes


def rows_of_forces(
    data: TireData, forces: Sequence[str], config: FitConfig
) -> dict[str, ForceRows]:
    """The rows of every force that has its slip; of M_x only beside F_y.

    Raises:
        DataError: a force has fewer than 30 rows, or none is there with its slip.
    """
    rows: dict[str, ForceRows] = {}
    for force in forces:
        if not any({force, slip} <= data.columns.keys() for slip in SLIPS_OF[force]):
            continue
        there = np.isfinite(data.columns[force]) & data.used
        count = np.count_nonzero(there)
        if not count or (force == "mx" and "fy" not in rows):
            continue
        if count < _FEWEST:
            reason = f"{count} rows of {force}: a Magic Formula needs at least {_FEWEST}"
            raise DataError(reason, "measure more, or fit a brush model", data.file)
        some = replace(data, used=there)
        zero = np.zeros(count)
        inputs = (some.usable(k) if k in data else zero for k in TireInputs._fields)
        std, estimated, _ = force_scale(some, force, config.noise)
        pure = is_pure(some, force)
        rows[force] = ForceRows(
            force,
            TireInputs(*map(np.nan_to_num, inputs)),
            some.usable(force),
            np.asarray(std, float),
            estimated,
            data.run[there],
            pure & (np.count_nonzero(pure) >= _FEWEST),
            np.zeros(count, int),
            np.ones(count, int),
        )
    if not rows:
        raise DataError(
            f"no {' or '.join(forces)} with its slip: a fit needs fx with sigma_x"
            " (or kappa, s), fy and mz with alpha, mx with alpha and fy",
            "check with `tirefit inspect` how the columns were read",
            data.file,
        )
    return rows


_WIDTH = {"sigma_x": 0.005, "alpha": 0.005, "gamma": 0.005}
"""Width of a cell at small slip [-], [rad]. The force at the mean input of a cell
differs from the mean force by (B width)^2 / 24 of it: 0.1 % at B = 30."""

_SINGLE = 4096
"""Number of rows below which every row is a cell: so few take no longer to fit."""

_WIDENS = 0.1
"""Slip above which cells widen with the slip: the curves are nearly straight there."""

_SHARE = {"fz": 0.05, "pressure": 0.02, "v": 0.05}
"""Relative width of a cell in load, pressure and speed."""

_AT_FIRST = 0.05
"""Noise relative to the root mean square of the force, before the first residuals."""


def cells_of(rows: ForceRows) -> tuple[ForceRows, np.ndarray]:
    """The m cells of n rows, in the order of their setting and slips, and the cell of each
    row (n,). The ``std`` of a cell is that of its mean."""
    columns = {k: np.asarray(part) for k, part in rows.inputs._asdict().items()}
    # Of all forces and moments, only M_y depends on speed.
    names = [*_WIDTH, *(name for name in _SHARE if name != "v" or rows.force == "my")]
    places = [rows.setting, *(_place(columns, name) for name in names)]
    if len(rows.setting) < _SINGLE:
        places.append(np.arange(len(rows.setting)))
    _, first, code = np.unique(np.stack(places), axis=1, return_index=True, return_inverse=True)
    code = code.ravel()
    count = np.bincount(code)
    cells = replace(
        rows.part(first),
        inputs=TireInputs(**{k: np.bincount(code, part) / count for k, part in columns.items()}),
        observed=np.bincount(code, rows.observed) / count,
        std=np.sqrt(np.bincount(code, rows.std**2)) / count,
        count=count,
    )
    return cells, code


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

    pure: bool
    rows: ForceRows | None  # n of them; None in a part
    cells: ForceRows  # m of them
    code: np.ndarray  # (n,) cell of each row
    white: NoiseLaw = NoiseLaw(0.0, 0.0)  # of one row
    misfit: NoiseLaw | None = None  # of a cell's mean less the formula
    each: float = 1.0  # cells per independent cell, as neighbours have similar misfit

    @property
    def force(self) -> str:
        """The force of its cells."""
        return self.cells.force

    @property
    def title(self) -> str:
        """The name of its stage."""
        slip = "pure" if self.pure else "combined"
        return self.force + ("" if self.force in MOMENTS else f" in {slip} slip")

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Mean of the values (n,) over the rows of each cell: (m,)."""
        return np.bincount(self.code, values, len(self.cells.count)) / self.cells.count

    def white_law(self, rows: ForceRows, predicted: np.ndarray) -> NoiseLaw:
        """Noise law of one row, from the scatter of ``rows`` within the cells.

        Args:
            predicted: (n,) force of the formula at each row.
        """
        residual = rows.observed - predicted
        free = (1 - 1 / self.cells.count)[self.code]
        shared = free > 0
        if not np.any(shared):
            return NoiseLaw(0.0, 0.0, 0.0)
        scatter = (residual - self.mean(residual)[self.code])[shared]
        scatter = scatter / np.sqrt(free[shared])
        return noise_law(scatter, rows.column("fz")[shared], predicted[shared])

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
        misfit = self.misfit.variance(self.cells.column("fz"), predicted)
        return known + np.maximum(misfit, 1e-12 * mean_square)

    def row_variance(self, fz: np.ndarray, predicted: np.ndarray) -> np.ndarray:
        """Variance (n,) of single rows about the formula: noise and misfit."""
        misfit = self.misfit or NoiseLaw(0.0, 0.0)
        single = self.white.variance(fz, predicted)
        if not self.cells.estimated:
            single = np.median(self.cells.std**2 * self.cells.count)
        return single + misfit.variance(fz, predicted)

    def known(self, predicted: np.ndarray) -> np.ndarray:
        """Variance (m,) of each cell's mean from measurement noise alone."""
        if not self.cells.estimated:
            return self.cells.std**2
        return self.white.variance(np.asarray(self.cells.inputs.fz), predicted) / self.cells.count

    def part(self, chosen: np.ndarray) -> "Group":
        """The group of the ``chosen`` cells, (m,) bool, without their rows."""
        return replace(self, rows=None, cells=self.cells.part(chosen), code=np.zeros(0, int))


def groups_of(rows: Mapping[str, ForceRows], both: bool) -> dict[str, list[Group]]:
    """The groups of each force: pure slip, then combined slip if ``both``."""
    groups: dict[str, list[Group]] = {}
    for force, of_force in rows.items():
        for pure in (True, False):
            chosen = of_force.chosen([pure])
            if np.any(chosen) and (pure or both):
                part = of_force.part(chosen)
                groups.setdefault(force, []).append(Group(pure, part, *cells_of(part)))
    return groups
