"""The measured rows of each force, from one or more files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tirefit.data.table import Source, TireData, join
from tirefit.data.tir_check import PRESSURES
from tirefit.fitting.config import FitConfig
from tirefit.fitting.mf.parts import MOMENTS, PARTS, SLIPS_OF, is_pure, parts_named
from tirefit.fitting.problem import force_scale
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
    """The rows of one force."""

    force: str
    inputs: TireInputs
    observed: np.ndarray
    std: np.ndarray  # (n,) of the noise, which is given unless ``estimated``
    estimated: bool
    run: np.ndarray  # (n,) number of the run
    pure: np.ndarray  # (n,) rows of pure slip; none if too few to be fitted alone

    def column(self, name: str) -> np.ndarray:
        """One of the inputs, (n,)."""
        return np.asarray(getattr(self.inputs, name))

    @property
    def slip_range(self) -> float:
        """Largest minus smallest slip of the force, sigma_x or alpha [rad]."""
        return float(np.ptp(self.column(SLIPS_OF[self.force][-1])))

    def chosen(self, kinds: Sequence[bool]) -> np.ndarray:
        """Which rows (n,) are among the kinds: pure (True) or combined slip (False)."""
        return np.isin(self.pure, kinds)

    def part(self, chosen: np.ndarray) -> "ForceRows":
        """The chosen rows, by bool (n,) or by number."""
        inputs = TireInputs(*(np.asarray(column)[chosen] for column in self.inputs))
        return replace(
            self,
            inputs=inputs,
            observed=self.observed[chosen],
            std=self.std[chosen],
            run=self.run[chosen],
            pure=self.pure[chosen],
        )


def joined(tables: Sequence[TireData]) -> TireData:
    """Join files as runs of one data set.

    A file without a slip or camber counts as measured at zero, one without a pressure
    at the nominal pressure. A missing force is NaN.
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
    messages = tuple(f"no column {name}: {_ASIDE[name]}" for name in missing if name in _ASIDE)
    source: Source = replace(table.source, assumptions=(*table.source.assumptions, *messages))
    return replace(table, columns={**table.columns, **missing}, source=source)


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
    source = whole.file
    pressures = next(iter(rows.values())).column("pressure")
    typical = np.median(pressures[pressures > 0]) if np.any(pressures > 0) else None
    if typical is not None and not PRESSURES[0] <= typical <= PRESSURES[1]:
        reason = f"a median pressure of {typical:g} Pa, which no tire has"
        remedy = "name the unit of its column, as in --unit pressure=bar"
        raise DataError(reason, remedy, source)
    if "combined" not in parts and not np.any(rows[part].pure):
        reason = f"--part {part}: the data have too few rows of {part} in pure slip"
        remedy = "leave out --part: its rows of combined slip are fitted too"
        raise DataError(reason, remedy, source)
    lacking = "mx is not fitted: the data have no fy, from which the model computes it"
    if part in MOMENTS and part not in rows:
        reason = lacking if part in whole else f"the data have no {part}"
        remedy = f"leave out --part {part}, or see `tirefit inspect`"
        raise DataError(reason, remedy, source)
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
                f"{np.count_nonzero(there)} rows of {force}: a Magic Formula needs"
                f" at least {_FEWEST}",
                "measure more, or fit a brush model",
                data.file,
            )
        rows[force] = _rows_of(replace(data, used=there), force, config)
    if not rows:
        raise DataError(
            f"no {' or '.join(forces)} with its slip: a fit needs fx with sigma_x"
            " (or kappa, s), fy and mz with alpha, mx with alpha and fy",
            "check with `tirefit inspect` how the columns were read",
            data.file,
        )
    return rows


def _rows_of(data: TireData, force: str, config: FitConfig) -> ForceRows:
    def column(name):
        return data.usable(name) if name in data else np.zeros(data.n)

    inputs = TireInputs(*(np.nan_to_num(column(name)) for name in TireInputs._fields))
    std, estimated, _ = force_scale(data, force, config.noise)
    pure = is_pure(data, force)
    return ForceRows(
        force,
        inputs,
        data.usable(force),
        np.asarray(std, float),
        estimated,
        data.run[data.used],
        pure & (np.count_nonzero(pure) >= _FEWEST),
    )
