"""The tire of a ``.tir`` file, and rows for which it was not made."""

import numpy as np

from tirefit.data.table import TireData
from tirefit.data.tir import TirFile
from tirefit.data.tir_keys import LIMITS
from tirefit.models.base import AbstractTire
from tirefit.models.mf import Mirrored, mf_tire
from tirefit.models.mf.fields import Nominal
from tirefit.results import InputProblem, UsageError
from tirefit.slip import kappa_from_sigma

__all__ = ["moments_noted", "rows_outside", "tire_of"]


def tire_of(
    tir: TirFile, *, starred: bool = False, side: str | None = None
) -> AbstractTire:
    """The tire of a ``.tir`` file.

    Args:
        tir: the file, read and checked.
        starred: whether the equations take tan(alpha) and sin(gamma).
        side: ``left`` or ``right``: where the tire is mounted; mirrored if the file is
            of the other side. None: as the file has it.

    Raises:
        UsageError: a side is wanted of a file that does not say its own.
    """
    tire = mf_tire(tir.version, tir.numbers, starred=starred)
    if side is None or tir.side in (side.upper(), "SYMMETRIC"):
        return tire
    if tir.side == "UNKNOWN":
        reason = "TYRESIDE is not stated: it cannot be said whether to mirror the tire"
        remedy = "write TYRESIDE = 'LEFT' or 'RIGHT' into [MODEL], or leave out --side"
        raise UsageError(InputProblem(reason, remedy, tir.path))
    return Mirrored(tire)


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


def rows_outside(tir: TirFile, data: TireData) -> list[str]:
    """Sentences on used rows outside the ranges that the file states for its tire."""
    numbers, said = tir.numbers, []
    for name, (least, most) in LIMITS.items():
        column = "sigma_x" if name == "kappa" else name
        if column not in data:
            continue
        values = data.usable(column)
        if name == "kappa":
            values = -kappa_from_sigma(values)
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
