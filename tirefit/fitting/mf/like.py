"""Priors from a named tire, for what a test does not determine: ``--like``.

Coefficients are dimensionless, so they apply at another nominal load and radius. The
coefficients of friction and stiffness are scaled by the ratio of the measured forces to
those of the named tire.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tirefit.data.tir import TirFile
from tirefit.fitting.config import FitConfig, ParameterConfig
from tirefit.fitting.mf.parts import NEVER_FITTED, PARTS, SLIPS_OF, coefficients_of
from tirefit.fitting.mf.priors import Prior, normal_form, published_priors
from tirefit.fitting.mf.rows import ForceRows
from tirefit.fitting.tir import own_tire
from tirefit.models import forces
from tirefit.models.mf import MFTire
from tirefit.params import parameter_values, with_values

ALIKE = 0.25
"""Spread of a borrowed prior over that of the published tires, which are of all kinds.
It is a judgement."""

_LOWEST, _HIGHEST = 0.2, 0.8
"""Quantiles of slip below which the rows of a force give the scale of stiffness, and
above which that of friction."""

_SCALED: dict[str, dict[str, tuple[str, ...]]] = {
    "fx": {"friction": ("PDX1", "PDX2"), "stiffness": ("PKX1", "PKX2")},
    "fy": {"friction": ("PDY1", "PDY2"), "stiffness": ("PKY1",)},
}
"""Force -> the coefficients of its friction and of its stiffness."""


class Borrowed(NamedTuple):
    """Priors by coefficient, and notes on them."""

    priors: Mapping[str, Prior]
    notes: tuple[str, ...]


def with_dimensions(
    like: TirFile,
    rows: Mapping[str, ForceRows],
    config: FitConfig,
    constants: Mapping[str, float],
) -> tuple[FitConfig, list[str]]:
    """Complete the settings from the other tire; returns them with notes.

    Taken are its free radius, its nominal pressure if the test has no pressure, and
    QSX12 to QSX14 if M_x is not measured, unless the settings or a constant of the data
    file give them.
    """
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
    """Priors from the coefficients of another tire that the settings do not give.

    Args:
        like: the other tire; if its version differs, both must have the coefficient.
        tire: this tire, with its nominal state.
        rows: measured rows, by force.
    """
    values, of_part = normal_form(like.numbers), coefficients_of(tire.version)
    said = []
    for force, kinds in _SCALED.items():
        by = next((by for by in (force, *_SCALED) if by in rows), "")
        for kind, names in kinds.items() if by else ():
            scale = _scale(like, tire, rows[by], kind)
            values |= {name: scale * values.get(name, 0.0) for name in names}
            said.append(f"{kind} of {force} times {scale:.3g} (from the rows of {by})")
    own = parameter_values(tire)
    priors = {}
    for name in of_part.keys() & values.keys() & own.keys() - config.parameters.keys():
        prior, value = published_priors()[name], values[name]
        if value and (value > 0 or not prior.log):
            spread = ALIKE * prior.spread
            priors[name] = Prior(value, spread, prior.log, (value,))
    return Borrowed(priors, _notes(like, tire, rows, priors, said))


def _notes(like: TirFile, tire: MFTire, rows, priors, scales) -> tuple[str, ...]:
    """Sentences on the priors and scales, and on forces that have no rows."""
    of_part, name = coefficients_of(tire.version), Path(like.path).name
    said = [
        f"priors of {len(priors)} coefficients are those of {name} (MF {like.version}),"
        f" {ALIKE:g} times as wide as the spread of published tires; its forces at"
        f" {own_tire(like).nominal.FNOMIN:g} N are used at FNOMIN ="
        f" {tire.nominal.FNOMIN:g} N",
        f"scaled coefficients of {name}: {', '.join(scales)}",
    ]
    parts = {of_part[name] for name in priors}
    whole = [
        part.meaning
        for part in PARTS.values()
        if part.name in parts and not set(part.forces) & rows.keys()
    ]
    if whole:
        said.append(f"borrowed, since not measured: {', '.join(whole)}")
    lost = [k for k, v in like.numbers.items() if k in published_priors() and v]
    if lost := [k for k in lost if k not in of_part]:
        said.append(f"not borrowed, as MF {tire.version} lacks them: {', '.join(lost)}")
    return tuple(said)


def _scale(like: TirFile, tire: MFTire, rows: ForceRows, kind: str) -> float:
    """Ratio of a measured force to that of the other tire in the nominal state of this
    one, by least squares over the largest (``friction``) or smallest slips; one if the
    rows or the other tire do not give it."""
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
