"""The tire of a ``.tir`` file, and rows for which it was not made."""

import numpy as np

from tirefit.data.table import TireData
from tirefit.data.tir import TirFile
from tirefit.data.tir_keys import LIMITS
from tirefit.models.base import AbstractTire
from tirefit.models.mf import OTHER_SIDE, Mirrored, mf_tire
from tirefit.models.mf.fields import Nominal
from tirefit.results import InputProblem, UsageError, did_you_mean
from tirefit.slip import CONVENTIONS, kappa_from_sigma

__all__ = ["TIR_SIGNS", "moments_noted", "rows_outside", "tire_of", "turned_by"]

TIR_SIGNS = "iso-w"
"""Convention of ``.tir`` files: those of the axes TYDEX W."""


def tire_of(
    tir: TirFile, *, starred: bool = False, side: str | None = None, signs=None
) -> AbstractTire:
    """The tire of a ``.tir`` file.

    Args:
        tir: the file, read and checked.
        starred: whether the equations take tan(alpha) and sin(gamma).
        side: ``left`` or ``right``: where the tire is mounted; mirrored if the file is
            of the other side. None: as the file has it.
        signs: the convention in which the file was written, a key of
            ``slip.CONVENTIONS``; None for :data:`TIR_SIGNS`.

    Raises:
        UsageError: a side is wanted of a file that does not say its own; no such
            convention.
    """
    tire = mf_tire(tir.version, tir.numbers, starred=starred)
    turned = turned_by(signs)
    if side is not None and tir.side not in (side.upper(), "SYMMETRIC"):
        if tir.side == "UNKNOWN":
            reason = "TYRESIDE is not stated: no side to mirror the tire from"
            remedy = "write TYRESIDE = 'LEFT' or 'RIGHT' into [MODEL], or omit --side"
            raise UsageError(InputProblem(reason, remedy, tir.path))
        turned ^= OTHER_SIDE
    return Mirrored(tire, turned) if turned else tire


def moments_noted(tir: TirFile, data: TireData) -> list[str]:
    """Sentences on M_x and M_y: which the file does not give, and at what speed."""
    there = {key[:3] for key in tir.numbers}
    keys = {"QSX": "mx (overturning moment)", "QSY": "my (rolling resistance moment)"}
    said = [
        f"no coefficients {key}...: {name} is not predicted"
        for key, name in keys.items()
        if key not in there
    ]
    if "v" not in data and any(tir.numbers.get(key) for key in ("QSY3", "QSY4")):
        speed = tir.numbers.get("LONGVL", Nominal().LONGVL)
        said.append(f"no column v: my is that of {speed:g} m/s (--constant v=SPEED)")
    return said


def turned_by(signs: str | None) -> frozenset[str]:
    """Fields that turn in the convention ``signs``, in place of :data:`TIR_SIGNS`; the
    load is positive in any.

    Raises:
        UsageError: there is no such convention.
    """
    if signs is not None and signs not in CONVENTIONS:
        remedy = f"{did_you_mean(signs, CONVENTIONS)}valid: {', '.join(CONVENTIONS)}"
        raise UsageError(InputProblem(f"--signs: {signs!r} is not known", remedy))
    own = CONVENTIONS[TIR_SIGNS]
    return own.turned(CONVENTIONS[signs or TIR_SIGNS]) - {"fz"}


def rows_outside(tir: TirFile, data: TireData, signs: str | None = None) -> list[str]:
    """Sentences on used rows outside the ranges that the file, written in ``signs``,
    states for its tire."""
    numbers, said, turned = tir.numbers, [], turned_by(signs)
    for name, (least, most) in LIMITS.items():
        column = "sigma_x" if name == "kappa" else name
        if column not in data:
            continue
        values = data.usable(column)
        if name == "kappa":
            values = -kappa_from_sigma(values)
        if {"kappa": "slip"}.get(name, name) in turned:
            values = -values
        low, high = numbers.get(least, -np.inf), numbers.get(most, np.inf)
        # A slip loses some digits in its conversions.
        margin = 1e-9 * (high - low) if np.isfinite(high - low) else 0.0
        count = np.count_nonzero((values < low - margin) | (values > high + margin))
        if count:
            said.append(
                f"{count} of {data.n} rows outside {least} = {low:g} to {most} ="
                f" {high:g}: extrapolated"
            )
    return said
