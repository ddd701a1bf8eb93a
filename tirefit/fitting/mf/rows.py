"""The measured rows of each force, from one or more files, and their noise.

The residual of a row is measurement noise and misfit of the formula. One law describes
both. The misfit of neighbouring rows is alike, so a number of them counts as one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tirefit.data.table import TireData, join
from tirefit.data.tir.tir import PRESSURES
from tirefit.fitting.mf.parts import MOMENTS, SLIPS_OF, is_pure
from tirefit.fitting.problem.build import inputs_of
from tirefit.fitting.problem.config import FitConfig
from tirefit.fitting.problem.noise import NoiseLaw
from tirefit.models import TireInputs
from tirefit.results import DataError

_FEWEST = 30  # smallest number of rows of a force, which has some 20 coefficients in pure slip
_ASIDE = {
    "sigma_x": "the tire rolls freely",
    "alpha": "the tire runs straight",
    "gamma": "the tire stands upright",
    "pressure": "the pressure is the nominal one",
}
"""Column that a test may lack -> the state that is then assumed."""


@dataclass(frozen=True)
class ForceRows:
    """n rows of one force."""

    force: str
    inputs: TireInputs
    observed: np.ndarray
    run: np.ndarray  # (n,) number of the run
    pure: np.ndarray  # (n,) rows of pure slip; none if too few to be fitted alone
    setting: np.ndarray  # (n,) number of the setting of the rig, zero before it is known

    def column(self, name: str) -> np.ndarray:
        """One of the inputs, (n,)."""
        return np.asarray(getattr(self.inputs, name))

    def part(self, chosen: np.ndarray) -> "ForceRows":
        """The chosen rows, by bool (n,) or by number."""
        inputs = TireInputs(*(np.asarray(column)[chosen] for column in self.inputs))
        names = ("observed", "run", "pure", "setting")
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
) -> tuple[dict[str, ForceRows], list[str]]:
    """The rows of a force in pure slip, or of all forces, and notes on them.

    Args:
        part: ``fx``, ``fy``, ``mz`` or ``all``.

    Raises:
        DataError: the part's own rows are not there, or a pressure that no tire has.
    """
    rows = rows_of_forces(whole, tuple(SLIPS_OF) if part == "all" else (part,))
    pressures = next(iter(rows.values())).column("pressure")
    pressure = np.median(pressures[pressures > 0]) if np.any(pressures > 0) else PRESSURES[0]
    if not PRESSURES[0] <= pressure <= PRESSURES[1]:
        reason = f"a median pressure of {pressure:g} Pa, which no tire has"
        remedy = "name the unit of its column, as in --unit pressure=bar"
        raise DataError(reason, remedy, whole.file)
    if part != "all":
        if not np.any(rows[part].pure):
            reason = f"--part {part}: the data have too few rows of {part} in pure slip"
            remedy = "leave out --part: its rows of combined slip are fitted too"
            raise DataError(reason, remedy, whole.file)
        rows = {part: rows[part].part(rows[part].pure)}
    notes = []
    if part == "all" and "mx" in whole and "mx" not in rows:
        notes.append("mx is not fitted: the data have no fy, from which the model computes it")
    if "mz" in rows and "fy" not in rows:
        notes.append(
            "mz is the trail times fy, which is not fitted: fy is as borrowed,"
            " given, or that of the priors, and the trail makes up for it"
        )
    columns = [f"{name}_std" for name in ("sigma_x", "alpha", *SLIPS_OF)]
    noise = config.noise.model_dump(exclude={"loss", "effective_samples"}, exclude_defaults=True)
    unused = [*(name for name in columns if name in whole), *(f"noise.{key}" for key in noise)]
    if unused:
        reason = "not used, a Magic Formula fit takes the slips as exact and estimates the noise"
        notes.append(f"{', '.join(unused)}: {reason}")
    return rows, notes


def rows_of_forces(data: TireData, forces: Sequence[str]) -> dict[str, ForceRows]:
    """The rows of every force that has its slip; of M_x only beside F_y.

    Raises:
        DataError: a force has fewer than 30 rows, or none is there with its slip.
    """
    rows: dict[str, ForceRows] = {}
    for force in forces:
        has_slip = any({force, slip} <= data.columns.keys() for slip in SLIPS_OF[force])
        there = np.isfinite(data.columns[force]) & data.used if has_slip else np.zeros(1, bool)
        count = np.count_nonzero(there)
        if not count or (force == "mx" and "fy" not in rows):
            continue
        if count < _FEWEST:
            reason = f"{count} rows of {force}: a Magic Formula needs at least {_FEWEST}"
            raise DataError(reason, "measure more, or fit a brush model", data.file)
        some = replace(data, used=there)
        pure = is_pure(some, force)
        pure &= np.count_nonzero(pure) >= _FEWEST
        columns = inputs_of(some), some.usable(force), data.run[there]
        rows[force] = ForceRows(force, *columns, pure, np.zeros(count, int))
    if not rows:
        raise DataError(
            f"no {' or '.join(forces)} with its slip: a fit needs fx with sigma_x"
            " (or kappa, s), fy and mz with alpha, mx with alpha and fy",
            "check with `tirefit inspect` how the columns were read",
            data.file,
        )
    return rows


# The rows of a rig come so fast that neighbours are alike.
_MOST = 8192  # largest number of rows of a group, evenly taken along the slip
_ALIKE = 0.005  # slip [-] and slip angle [rad] within which rows keep the order of time

_AT_FIRST = 0.05  # noise over the root mean square of the force, before the first residuals


@dataclass(frozen=True)
class Group:
    """n rows of one force in pure or in combined slip, in the order of the slip in each
    setting, with their noise."""

    pure: bool
    rows: ForceRows
    law: NoiseLaw  # of the residuals
    each: float = 1.0  # rows per independent row

    @property
    def force(self) -> str:
        """The force of its rows."""
        return self.rows.force

    @property
    def part(self) -> str:
        """The key of :data:`~tirefit.fitting.mf.parts.PARTS` of its stage."""
        return self.force if self.pure else "combined"

    @property
    def title(self) -> str:
        """The name of its stage."""
        slip = "pure" if self.pure else "combined"
        return self.force + ("" if self.force in MOMENTS else f" in {slip} slip")

    def variance(self, predicted: np.ndarray) -> np.ndarray:
        """Variance (n,) of each row about the force of the formula, ``predicted`` (n,)."""
        variance = self.law.variance(self.rows.column("fz"), predicted)
        # A force that is zero everywhere gives no size: 1 N, or 1 N m.
        return np.maximum(variance, 1e-12 * (float(np.mean(self.rows.observed**2)) or 1.0))


def groups_of(rows: Mapping[str, ForceRows]) -> dict[str, list[Group]]:
    """The groups of each force: pure slip, then combined slip."""
    groups: dict[str, list[Group]] = {}
    for force, of_force in rows.items():
        size = float(np.sqrt(np.mean(of_force.observed**2))) or 1.0
        alpha, slip = (np.rint(of_force.column(k) / _ALIKE) for k in ("alpha", "sigma_x"))
        order = np.lexsort((alpha, slip, of_force.setting))
        for pure in (True, False):
            chosen = order[of_force.pure[order] == pure]
            if len(chosen):
                count = min(len(chosen), _MOST)
                part = of_force.part(chosen[np.linspace(0, len(chosen) - 1, count).astype(int)])
                first = NoiseLaw(_AT_FIRST * size, 0.0)
                groups.setdefault(force, []).append(Group(pure, part, first))
    return groups
