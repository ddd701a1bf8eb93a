"""A named tire as prior of what a test does not tell: :func:`borrowed_from`.

Coefficients are dimensionless: they carry over to another nominal load and radius. Its
friction and stiffness are those of the other tire times what the forces that were
measured are over the other tire's.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tirefit.data.tir import TirFile
from tirefit.fitting.config import FitConfig, ParameterConfig
from tirefit.fitting.mf.parts import (
    NEVER_FITTED,
    PARTS,
    SLIPS_OF,
    coefficients_of,
)
from tirefit.fitting.mf.priors import Prior, normal_form, published_priors
from tirefit.fitting.mf.rows import ForceRows
from tirefit.fitting.tir import own_tire
from tirefit.models import forces
from tirefit.models.mf import MFTire
from tirefit.params import parameter_values, with_values

ALIKE = 0.25
"""Spread of a borrowed coefficient over that among the published tires, which are of
all kinds: judgement, as that is."""

_LOWEST, _HIGHEST = 0.2, 0.8
"""Quantiles of the slips of a force below which its rows tell the stiffness, and above
which the friction."""

_SCALED: dict[str, dict[str, tuple[str, ...]]] = {
    "fx": {"friction": ("PDX1", "PDX2"), "stiffness": ("PKX1", "PKX2")},
    "fy": {"friction": ("PDY1", "PDY2"), "stiffness": ("PKY1",)},
}
"""Force -> the coefficients of its friction and of its stiffness."""


class Borrowed(NamedTuple):
    """Priors by coefficient, and what to say of them."""

    priors: Mapping[str, Prior]
    notes: tuple[str, ...]


def with_dimensions(
    like: TirFile,
    rows: Mapping[str, ForceRows],
    config: FitConfig,
    constants: Mapping[str, float],
) -> tuple[FitConfig, list[str]]:
    """The settings with what the data cannot hold taken from the other tire: its free
    radius, the nominal pressure of a test without one, and QSX12 to QSX14 where M_x is
    not measured; what is set, or a constant of the data file, stays. And what was
    taken, in sentences."""
    wanted = ["UNLOADED_RADIUS"]
    if not any(np.any(one.column("pressure") > 0) for one in rows.values()):
        wanted.append("NOMPRES")
    wanted += [] if "mx" in rows else NEVER_FITTED
    there = {k: like.numbers[k] for k in wanted if like.numbers.get(k)}
    known = config.parameters.keys() | constants.keys()
    taken = {k: v for k, v in there.items() if k not in known}
    given = {name: ParameterConfig(value=value) for name, value in taken.items()}
    new = config.model_copy(update={"parameters": config.parameters | given})
    file = Path(like.path).name
    return new, [f"{name} = {value:g}: that of {file}" for name, value in taken.items()]


def borrowed_from(
    like: TirFile, tire: MFTire, rows: Mapping[str, ForceRows], config: FitConfig
) -> Borrowed:
    """Priors about the coefficients of another tire, of which the settings say nothing.

    Args:
        like: the other tire; of another version, the coefficients that both have.
        tire: has the nominal state of this one.
        rows: measured rows, by force.
    """
    values, of_part = normal_form(like.numbers), coefficients_of(tire.version)
    said = []
    for force, kinds in _SCALED.items():
        for by in [by for by in (force, *_SCALED) if by in rows][:1]:
            for kind, names in kinds.items():
                scale = _scale(like, tire, rows[by], kind)
                values |= {name: scale * values.get(name, 0.0) for name in names}
                said.append(f"{kind} of {force} times {scale:.3g} by the rows of {by}")
    own = parameter_values(tire)
    priors = {}
    for name in of_part.keys() & values.keys() & own.keys() - config.parameters.keys():
        prior, value = published_priors()[name], values[name]
        if value and (value > 0 or not prior.log):
            spread = ALIKE * prior.spread
            priors[name] = Prior(value, spread, prior.log, (value,))
    return Borrowed(priors, _notes(like, tire, rows, priors, said))


def _notes(like: TirFile, tire: MFTire, rows, priors, scales) -> tuple[str, ...]:
    of_part = coefficients_of(tire.version)
    name = f"{Path(like.path).name} (MF {like.version})"
    whole = [
        part.meaning
        for part in PARTS.values()
        if not set(part.forces) & rows.keys() and part.name in map(of_part.get, priors)
    ]
    said = [
        f"priors of {len(priors)} coefficients are about those of {name}, {ALIKE:g}"
        " times as wide as the spread of the published tires; the tire at FNOMIN ="
        f" {tire.nominal.FNOMIN:g} N is taken to be as it at"
        f" {own_tire(like).nominal.FNOMIN:g} N",
        f"of {name}: {', '.join(scales)}",
    ]
    if whole:
        said.append(f"borrowed, since not measured: {', '.join(whole)}")
    lost = [
        k
        for k in like.numbers
        if k in published_priors() and k not in of_part and like.numbers[k]
    ]
    if lost:
        said.append(f"not borrowed, as MF {tire.version} lacks them: {', '.join(lost)}")
    return tuple(said)


def _scale(like: TirFile, tire: MFTire, rows: ForceRows, kind: str) -> float:
    """A measured force over that of the other tire at the nominal state of this one, by
    least squares over the largest or smallest slips."""
    nominal = {k: v for k, v in parameter_values(tire.nominal).items() if k != "LONGVL"}
    other = with_values(own_tire(like), nominal)
    force = rows.force
    size, pure = np.abs(rows.column(SLIPS_OF[force][0])), rows.pure
    if not np.any(pure):
        return 1.0
    low, high = np.quantile(size[pure], [_LOWEST, _HIGHEST])
    chosen = pure & (size >= high if kind == "friction" else size <= low)
    found = getattr(forces(other, rows.inputs), force)
    if found is None:
        return 1.0
    given = np.asarray(found)[chosen]
    scale = float(given @ rows.observed[chosen] / max(given @ given, 1e-12))
    return scale if scale > 0 else 1.0
