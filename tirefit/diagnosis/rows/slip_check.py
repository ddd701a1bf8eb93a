"""Comparison of the slip column with the slip from the wheel speed.

Another definition or an offset shows against (v - omega R) / (omega R) without any
force. Except for the definition, the column or the speeds may be wrong.
"""

from typing import NamedTuple

import numpy as np

from tirefit.data.table import TireData
from tirefit.data.units import slip_from_sigma, slip_from_speeds
from tirefit.diagnosis.rows.rig import LEAST_ROWS

FOR, BESIDE, AGAINST = 3.0, 1.5, -1.5
"""Changes of an effect's log odds: the comparison shows it (about even odds of one in
25 effects), shows it or an error of the speeds, or would have shown it."""

_WRITTEN, _BETTER = 1e-6, 0.7
"""Resolution of the slip in files; largest scatter of the best definition over that of
another one."""


class SlipCheck(NamedTuple):
    """The slip column against omega, v and the radius."""

    read_as: str  # definition of the slip
    fits: str  # the one that fits best
    radius: float  # [m] that was used
    rms: float  # difference from the computed slip in ``read_as``
    scatter: float  # that in ``fits``, about a line of offset and gain
    offset: float
    offset_std: float
    gain: float
    told_apart: bool  # all other definitions leave clearly more

    @property
    def shifted(self) -> bool:
        """Whether the offset is significant: 4 standard errors."""
        return abs(self.offset) > 4 * self.offset_std

    @property
    def agrees(self) -> bool:
        """Whether column and speeds agree, but for a wrong radius (2 % of gain)."""
        same = self.fits == self.read_as and not self.shifted
        return same and abs(self.gain - 1) < 0.02


def _line(computed, logged) -> dict[str, float]:
    """Least-squares line logged = offset + gain computed."""
    columns = np.stack([np.ones_like(computed), computed], axis=1)
    (offset, gain), *_ = np.linalg.lstsq(columns, logged, rcond=None)
    left = logged - columns @ (offset, gain)
    scatter = np.sqrt(np.sum(left**2) / (len(left) - 2))
    error = scatter * np.sqrt(np.linalg.inv(columns.T @ columns)[0, 0])
    return {
        "scatter": float(scatter), "offset": float(offset), "gain": float(gain),
        "offset_std": max(float(error), _WRITTEN),
    }  # fmt: skip


def check_slip(data: TireData, radius: float | None) -> SlipCheck | None:
    """The comparison; None without omega, v, a radius [m] and slips that vary."""
    if radius is None or not {"omega", "v", "sigma_x"} <= set(data.columns):
        return None
    omega, v, sigma = (data.usable(name) for name in ("omega", "v", "sigma_x"))
    computed = slip_from_speeds(omega, v, radius)
    largest = 3.0  # beyond, the wheel hardly turns
    good = (np.abs(computed) < largest) & (np.abs(sigma) < largest) & (omega > 0)
    good &= computed > -1 + 1 / (1 + largest)
    if good.sum() < LEAST_ROWS or np.ptp(computed[good]) < _WRITTEN:
        return None
    alpha = data.usable("alpha")[good] if "alpha" in data else None
    read_as = data.source.slip_definition
    own = "kappa" if read_as == "s" else read_as
    logged = slip_from_sigma(sigma[good], read_as, alpha)
    definitions = ("sigma_x", "kappa", "slip_ratio")
    meant = {name: slip_from_sigma(computed[good], name) for name in definitions}
    lines = {name: _line(x, logged) for name, x in meant.items()}
    best = min(lines, key=lambda name: lines[name]["scatter"])
    if lines[best]["scatter"] > _BETTER * lines[own]["scatter"]:
        best = own
    others = [line["scatter"] for name, line in lines.items() if name != best]
    return SlipCheck(
        read_as=read_as, fits=read_as if best == own else best, radius=radius,
        rms=float(np.sqrt(np.mean((logged - meant[own]) ** 2))),
        told_apart=lines[best]["scatter"] < _BETTER * min(others), **lines[best],
    )  # fmt: skip
