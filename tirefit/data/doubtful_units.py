"""Warnings on columns that were probably read in another unit than they are in."""

from collections.abc import Iterator, Mapping

import numpy as np

from tirefit.data.columns import Plan
from tirefit.data.table import CANONICAL
from tirefit.slip import LOCKED

_SHARES = (5e-3, 5.0)
_FOLLOWED = 0.5  # smallest correlation of a force with the slip that it follows
_HEAVIEST = 1e3  # largest median load [N] for which kN are suggested: no wheel carries a meganewton
_STEEPEST = 100.0
"""Largest force over load, over the slip: the stiffest tire of ``fits`` has 42 at zero slip, and
of all data the largest is 30. Radians read as degrees multiply it by 57, shares read as
percent by 100."""
_LONGEST_ARM = 0.5  # m, of M_z over the load: five times the trail of a truck's tire
_LEAST_SLIP = (("fx", "sigma_x", 0.01), ("fy", "alpha", np.radians(0.5)))


def doubt_units(
    columns: Mapping[str, np.ndarray], headers: Mapping[str, str], plan: Plan
) -> list[str]:
    """Warnings on forces that no tire has at its load, or at its slip.

    Args:
        columns: (n,) canonical columns, used rows only.
        headers: the header of each column in the file.
        plan: how each column was read.
    """
    if "fz" not in columns:
        return []
    return [*_of_forces(columns, headers), *_of_slips(columns, plan)]


def _of_forces(columns: Mapping[str, np.ndarray], headers: Mapping[str, str]) -> Iterator[str]:
    """Warnings on forces that no tire has at its load.

    Force over load is some 5 to 30 times the slip until the tire slides, then about the
    friction. If the 99th percentile is out of ``_SHARES``, a unit is wrong. A small
    force is not reported if the slips are small as well.
    """
    low, high = _SHARES
    for force, slip, least in _LEAST_SLIP:
        if force not in columns:
            continue
        share = _high(columns[force] / columns["fz"])
        if share > high:
            mended, column = share / 1000, "fz"
            much = f"{share:.0f} times the load, which no tire has"
        elif share < low and slip in columns and _high(columns[slip]) > least:
            mended, column = share * 1000, force
            much = f"only {share:.2g} of the load, too little at these slips"
        else:
            continue
        remedy = f"check the units of {force} and fz"
        possible = column != "fz" or np.median(columns["fz"]) < _HEAVIEST
        if 10 * low < mended < high and possible:
            remedy = f"give --constant {column} in N, not in kN"
            if column in headers:
                remedy = f"if {headers[column]!r} is in kN, pass --unit {column}=kN"
        yield (
            f"{headers.get(force, force)!r} reaches {much}: the unit of one of the two is probably"
            f" wrong (kN read as N?); {remedy}"
        )
    arm = _high(columns["mz"] / columns["fz"]) if "mz" in columns else 0.0
    if arm > _LONGEST_ARM:
        yield (
            f"{headers.get('mz', 'mz')!r} reaches {arm:.2g} m times the load, an arm that no tire"
            " has: one of the two is in another unit than it was read in; check the units of mz"
            " and of the forces (--unit fz=kN, --unit mz=Nmm)"
        )


def _high(values: np.ndarray) -> float:
    """The largest size, but for one row in a hundred."""
    return float(np.percentile(abs(values), 99))


def _of_slips(columns: Mapping[str, np.ndarray], plan: Plan) -> Iterator[str]:
    """Warnings on slips that are too small for their forces, as if in a larger unit.

    Slips that the force hardly follows are about zero, and not judged.
    """
    for force, slip, _ in _LEAST_SLIP:
        column = plan.columns.get((plan.slip or "") if slip == "sigma_x" else slip)
        if column is None or not {force, slip} <= set(columns):
            continue
        near = abs(columns[slip]) < LOCKED
        if not near.any():
            continue
        share, size = (columns[force] / columns["fz"])[near], columns[slip][near]
        together = abs(np.mean((share - np.mean(share)) * (size - np.mean(size))))
        most, largest = _high(share), _high(size)
        if most <= _STEEPEST * largest or together <= _FOLLOWED * np.std(share) * np.std(size):
            continue
        remedy = f"check the units of {column.name} and {force}"
        if column.unit and abs(column.unit.scale) < 1:
            larger = "-" * (column.unit.scale < 0) + CANONICAL[slip][0]
            remedy = f"if it is in {larger}, pass --unit {column.name}={larger}"
        unit = column.unit_text or CANONICAL[slip][0]
        yield (
            f"{column.header!r}, read in {unit}, is too small for {force}: force over load"
            f" reaches {most / largest:.0f} times the slip, which no tire does; {remedy}"
        )
