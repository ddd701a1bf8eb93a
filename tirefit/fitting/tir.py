"""The tire of a ``.tir`` file, and remarks on rows to which it does not apply."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from tirefit.data.table import TireData
from tirefit.data.tir.tir import TirFile, notes_on
from tirefit.data.tir.tir_keys import LIMITS, PRESSURE_TERMS
from tirefit.models.base import AbstractTire
from tirefit.models.mf import OTHER_SIDE, WEIGHTS, MFTire, Mirrored, mf_tire
from tirefit.params import parameter_values
from tirefit.results import DataError, UsageError, unknown_names
from tirefit.slip import CONVENTIONS, kappa_from_sigma

TIR_SIGNS = "iso-w"  # convention of ``.tir`` files: that of the axes TYDEX W

_SYMBOLS = {"fx": "F_x", "fy": "F_y", "mz": "M_z"}
_NEEDED = {
    "camber": "PDY3 PKY3 PKY6 PKY7 PHY3 PVY3 PVY4 PEY4 PEY5",
    "pressure": " ".join(PRESSURE_TERMS),
}
"""Quantity -> the coefficients by which it changes a force (camber: F_y)."""


def own_tire(
    tir: TirFile,
    *,
    starred: bool = False,
    combination: str | None = None,
    values: Mapping[str, float] | None = None,
) -> MFTire:
    """The tire of a ``.tir`` file, on the side of the vehicle of the file.

    Args:
        tir: the file, read and checked.
        starred: whether the equations take tan(alpha) and sin(gamma).
        combination: how both slips combine, see :func:`~tirefit.models.mf.mf_tire`.
        values: coefficients that replace or complete those of the file.
    """
    lacks = [name for name, symbol in _SYMBOLS.items() if symbol in tir.lacks]
    return mf_tire(
        tir.version,
        tir.numbers | dict(values or {}),
        starred=starred,
        combination=combination or ("ellipse" if tir.ellipse else None),
        lacks=lacks,
    )


def tire_of(
    tir: TirFile, *, side: str | None = None, signs: str | None = None, **how: Any
) -> AbstractTire:
    """The tire of a ``.tir`` file, in given signs and on a side of the vehicle.

    Args:
        tir: the file, read and checked.
        side: ``left`` or ``right``, where the tire is mounted; it is mirrored if the
            file is for the other side. None for the side of the file.
        signs: the convention in which the file was written, a key of
            ``slip.CONVENTIONS``; None for :data:`TIR_SIGNS`.
        how: keywords of :func:`own_tire`.

    Raises:
        UsageError: ``side`` given but not stated in the file; unknown signs.
    """
    tire, turned = own_tire(tir, **how), turned_by(signs)
    if side is not None and tir.side not in (side.upper(), "SYMMETRIC"):
        if tir.side == "UNKNOWN":
            reason = "TYRESIDE is not stated: no side to mirror the tire from"
            remedy = "write TYRESIDE = 'LEFT' or 'RIGHT' into [MODEL], or omit --side"
            raise UsageError(reason, remedy, tir.path)
        turned ^= OTHER_SIDE
    return Mirrored(tire, turned) if turned else tire


def turned_by(signs: str | None) -> frozenset[str]:
    """Fields whose sign differs between the convention ``signs`` and
    :data:`TIR_SIGNS`; the load is positive in both.

    Raises:
        UsageError: there is no such convention.
    """
    UsageError.raise_for(unknown_names("--signs", [signs], CONVENTIONS))
    convention = CONVENTIONS[TIR_SIGNS]
    return convention.turned(CONVENTIONS[signs or TIR_SIGNS]) - {"fz"}


def check_gives(tir: TirFile, force: str) -> None:
    """Raise DataError if the file does not describe ``force``, fx or fy."""
    symbol = _SYMBOLS[force]
    if symbol in tir.lacks:
        reason = f"no {symbol} in this file: {tir.lacks[symbol]}"
        other = {"fx": "fy", "fy": "fx"}[force]
        instead = f", or ask for {other}" if _SYMBOLS[other] not in tir.lacks else ""
        raise DataError(reason, f"add the coefficients{instead}", tir.path)


def remarks(
    tir: TirFile, tire: AbstractTire, data: TireData | None = None, signs: str | None = None
) -> list[str]:
    """Sentences on assumptions about the file, and on rows to which it does not apply.

    Args:
        tire: result of :func:`tire_of`.
        data: its used rows are checked; None for any rows, with both slips too.
        signs: convention in which the file was written, see :func:`tire_of`.
    """
    messages = notes_on(tir)
    mounted = tire.tire if isinstance(tire, Mirrored) else tire
    assert isinstance(mounted, MFTire)
    if data is None:
        return messages + _combination(mounted, "wherever both slips act")
    slips = [np.nan_to_num(_used(data, name)) for name in ("sigma_x", "alpha")]
    if both := np.count_nonzero(slips[0] * slips[1]):
        messages += _combination(mounted, f"{both} of {data.n} rows with both slips")
    camber, pressure = (np.nan_to_num(_used(data, k)) for k in ("gamma", "pressure"))
    varied = {"camber": camber, "pressure": pressure - pressure[:1]}
    for name, keys in _NEEDED.items():
        acting = any(tir.numbers.get(key) for key in keys.split())
        acting |= name == "camber" and "F_y" in tir.lacks
        if (count := np.count_nonzero(varied[name])) and not acting:
            force = "F_y" if name == "camber" else "force"
            messages.append(
                f"{count} of {data.n} rows with {name}, which changes no {force}: the"
                " file has no coefficient of it"
            )
    return messages + _outside(tir, data, turned_by(signs))


def _combination(tire: MFTire, where: str) -> list[str]:
    """Sentences on forces whose combined slip the file does not describe."""
    messages = []
    if tire.ellipse:
        messages.append(
            f"{where}: F_x and F_y by the friction ellipse (FE_METHOD or --combination)"
        )
    if similar := [_SYMBOLS[force] for force in tire.similarity]:
        messages.append(
            f"{where}: {' and '.join(similar)} by the method of similarity (pure forces"
            " at the resultant normalised slip), as the file has no coefficients of"
            " combined slip; predict --combination none leaves them as in pure slip"
        )
    values = parameter_values(tire)
    whole = [
        _SYMBOLS[force]
        for force, keys in WEIGHTS.items()
        if force not in (*tire.unweighted, *tire.lacks) and any(values[key] == 0 for key in keys)
    ]
    if whole:
        remedy = "; --combination similarity avoids that" if not tire.lacks else ""
        messages.append(
            f"{where}: {' and '.join(whole)} as in pure slip: the weighting function"
            f" is one, so the resultant force may exceed the friction limit{remedy}"
        )
    return messages


def _used(data: TireData, name: str) -> np.ndarray:
    """A column of the used rows, (n,); zero if the data do not have it."""
    return data.usable(name) if name in data else np.zeros(data.n)


def _outside(tir: TirFile, data: TireData, turned: frozenset[str]) -> list[str]:
    """Sentences on rows outside the ranges that the file states.

    Args:
        turned: fields with reversed sign in the file.
    """
    numbers, messages = tir.numbers, []
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
        messages += beyond(values, low, high, f"{least} = {low:g} to {most} = {high:g}")
    return messages


def beyond(values: np.ndarray, low: float, high: float, ends: str) -> list[str]:
    """A sentence on the values (n,) of rows outside a range, ``ends`` its text; none if
    all are within."""
    # The conversions of a slip lose some digits.
    margin = 1e-9 * (high - low) if np.isfinite(high - low) else 0.0
    count = np.count_nonzero((values < low - margin) | (values > high + margin))
    return [f"{count} of {len(values)} rows outside {ends}: extrapolated"] if count else []
