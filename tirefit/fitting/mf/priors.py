"""Weak priors of the coefficients, from published tires or a named one (``--like``).

The table ``priors.csv`` holds the centre and the spread of the prior of every
coefficient. ``fits/magic_formula_priors`` writes it and names its sources. The priors
are weak: a spread is at least twice the scatter among the published tires, and at least
a physical size that does not depend on them.

Coefficients are dimensionless, so those of a named tire apply at another nominal load
and radius. The coefficients of friction and stiffness are scaled by the ratio of the
measured forces to those of the named tire.
"""

import csv
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tirefit.data.tir.tir import TirFile
from tirefit.fitting.mf.parts import PARTS, SLIPS_OF, coefficients_of
from tirefit.fitting.mf.rows import ForceRows
from tirefit.fitting.problem.config import FitConfig
from tirefit.fitting.tir import own_tire
from tirefit.models import forces
from tirefit.models.mf import MFTire
from tirefit.params import parameter_values, with_values


class Prior(NamedTuple):
    """Centre and standard deviation of a Gaussian prior."""

    centre: float
    spread: float  # relative to the centre with ``log``
    log: bool = False  # the logarithm is Gaussian

    @property
    def std(self) -> float:
        """Standard deviation of the coefficient itself, for small spreads."""
        return self.spread * self.centre if self.log else self.spread


LOGARITHMIC = ("RBX1", "RBX2", "RBY1", "RBY2", "RVY4", "QSX5", "QSX6")
"""Coefficients with a prior of their logarithm, as their sign has no effect (that of
RBX1 and RBY1 changes together with RBX3 and RBY4)."""


def normal_form(values: Mapping[str, float]) -> dict[str, float]:
    """The same tire in the signs of this package, if two sets of signs are equivalent.

    In some published files mu_y and B_y C_y are both negative. A sine is odd in its
    argument, and a weighting function depends on the square of some slopes.
    """
    values = dict(values)
    induced = ("RVY1", "RVY2", "RVY3")
    turning = {
        "PDY1": ("PDY2", *induced),
        "RVY5": induced,
        "RVY6": induced,
        "RBX1": ("RBX3",),
        "RBY1": ("RBY4",),
        "QSX9": ("QSX8",),
        "QSX11": ("QSX10",),
        "QSX7": ("QSX4", "QSX8"),
    }
    for leader, followers in turning.items():
        if values.get(leader, 0.0) < 0:
            for name in (leader, *followers):
                values[name] = -values.get(name, 0.0)
    even = {*LOGARITHMIC, "QBZ9"}  # coefficients whose sign has no effect
    return {name: abs(value) if name in even else value for name, value in values.items()}


@cache
def published_priors() -> dict[str, Prior]:
    """The priors of ``priors.csv``."""
    with open(Path(__file__).with_name("priors.csv"), newline="") as file:
        return {
            row["coefficient"]: Prior(
                float(row["centre"]), float(row["spread"]), row["scale"] == "log"
            )
            for row in csv.DictReader(file)
        }


ALIKE = 0.25  # spread of a borrowed prior over that of all published tires: a judgement

_LOWEST, _HIGHEST = 0.2, 0.8  # quantiles of slip of the rows that give stiffness, friction

_SCALED: dict[str, dict[str, tuple[str, ...]]] = {
    "fx": {"friction": ("PDX1", "PDX2"), "stiffness": ("PKX1", "PKX2")},
    "fy": {"friction": ("PDY1", "PDY2"), "stiffness": ("PKY1",)},
}
"""Force -> the coefficients of its friction and of its stiffness."""


def borrowed_from(
    like: TirFile, tire: MFTire, rows: Mapping[str, ForceRows], config: FitConfig
) -> tuple[dict[str, Prior], list[str]]:
    """Priors from the coefficients of another tire that the settings do not give, and
    notes on them, on the scales, and on forces that have no rows.

    Args:
        like: the other tire; if its version differs, both must have the coefficient.
        tire: this tire, with its nominal state.
        rows: measured rows, by force.
    """
    values, of_part = normal_form(like.numbers), coefficients_of(tire.version)
    scales = []
    for force, kinds in _SCALED.items():
        by = next((by for by in (force, *_SCALED) if by in rows), "")
        for kind, names in kinds.items() if by else ():
            scale = _scale(like, tire, rows[by], kind)
            values |= {name: scale * values.get(name, 0.0) for name in names}
            scales.append(f"{kind} of {force} times {scale:.3g} (from the rows of {by})")
    coefficients, published = parameter_values(tire), published_priors()
    priors = {}
    for name in of_part.keys() & values.keys() & coefficients.keys() - config.parameters.keys():
        prior, value = published[name], values[name]
        if value and (value > 0 or not prior.log):
            priors[name] = Prior(value, ALIKE * prior.spread, prior.log)
    file, parts = Path(like.path).name, {of_part[name] for name in priors}
    notes = [
        f"priors of {len(priors)} coefficients are those of {file} (MF {like.version}), {ALIKE:g}"
        f" times as wide as the spread of published tires; its forces at"
        f" {own_tire(like).nominal.FNOMIN:g} N are used at FNOMIN = {tire.nominal.FNOMIN:g} N",
        f"scaled coefficients of {file}: {', '.join(scales)}",
    ]
    measured = {*rows, *(["combined"] if {"fx", "fy", "mz"} & rows.keys() else [])}
    if absent := [PARTS[part] for part in PARTS if part in parts - measured]:
        notes.append(f"borrowed, since not measured: {', '.join(absent)}")
    lost = [k for k, v in like.numbers.items() if k in published and v and k not in of_part]
    if lost:
        notes.append(f"not borrowed, as MF {tire.version} lacks them: {', '.join(lost)}")
    return priors, notes


def _scale(like: TirFile, tire: MFTire, rows: ForceRows, kind: str) -> float:
    """Ratio of a measured force to that of the other tire in the nominal state of this
    one, by least squares over the largest (``friction``) or smallest slips; one if the
    rows or the other tire do not give it."""
    nominal = {k: v for k, v in parameter_values(tire.nominal).items() if k != "LONGVL"}
    predicted = getattr(forces(with_values(own_tire(like), nominal), rows.inputs), rows.force)
    if predicted is None or not np.any(rows.pure):
        return 1.0
    size = np.abs(rows.column(SLIPS_OF[rows.force][0]))
    low, high = np.quantile(size[rows.pure], [_LOWEST, _HIGHEST])
    chosen = rows.pure & (size >= high if kind == "friction" else size <= low)
    given = np.asarray(predicted)[chosen]
    scale = float(given @ rows.observed[chosen] / max(given @ given, 1e-12))
    return scale if scale > 0 else 1.0
