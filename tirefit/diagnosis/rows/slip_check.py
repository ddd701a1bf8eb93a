"""The slip column against the slip of the wheel speed: evidence, no reason to refuse.

A column that holds another definition of slip, or a constant more than it should, shows
against (v - omega R) / (omega R) without any force. Whether the column or the speeds
are wrong it does not show, save for the definition: no error of a speed or a radius
bends one slip into another.
"""

from typing import NamedTuple

import numpy as np

from tirefit.data.table import TireData
from tirefit.data.units import slip_from_sigma, slip_from_speeds

FOR, BESIDE, AGAINST = 3.0, 1.5, -1.5
"""What the check adds to the log odds of an effect that it shows, of one that it shows
as much as an error of the speeds, and of one that it would have shown. One effect of
some 25 is expected: 3 makes it about as likely as not before any force is looked at,
1.5 leaves half of that to the speeds."""

_DEFINITIONS = ("sigma_x", "kappa", "slip_ratio")
_LARGEST = 3.0
"""Slip beyond which the wheel hardly turns and its speed says little."""

_LEAST_ROWS = 10
"""Rows from which the scatter about a line says something."""
_WRITTEN = 1e-6
"""Slip as files write it: nothing is known better."""
_BETTER = 0.7
"""Share of the scatter that another definition must leave at most, to be the one: on
slips of 0.25 it leaves a tenth and less; noise of the slip hides it below 0.03."""

_SURE = 4.0
"""Standard errors of an offset that count."""

_GAIN = 0.02
"""Difference of a gain from one that a radius may give by itself (2 % of it)."""


class SlipCheck(NamedTuple):
    """A slip column, in its own definition, against that of omega, v and the radius.

    Attributes:
        read_as: definition that the column was read by.
        fits: definition that its values follow best.
        radius: rolling radius of the computed slip [m].
        rms: difference of the column from the computed slip, read as it was [-].
        scatter: what is left of it by ``fits``, less offset and gain [-].
        offset: of the column over the computed slip in ``fits`` [-], and its standard
            error ``offset_std``.
        gain: of the column over the computed slip [-].
        told_apart: whether another definition would have left clearly more.
    """

    read_as: str
    fits: str
    radius: float
    rms: float
    scatter: float
    offset: float
    offset_std: float
    gain: float
    told_apart: bool

    @property
    def shifted(self) -> bool:
        """Whether a constant stands between the two."""
        return abs(self.offset) > _SURE * self.offset_std

    @property
    def agrees(self) -> bool:
        """Whether the column is what the speeds say."""
        same = self.fits == self.read_as and not self.shifted
        return same and abs(self.gain - 1) < _GAIN


class _Line(NamedTuple):
    scatter: float
    offset: float
    offset_std: float
    gain: float


def _line(computed, logged) -> _Line:
    """logged = offset + gain computed, by least squares."""
    columns = np.stack([np.ones_like(computed), computed], axis=1)
    (offset, gain), *_ = np.linalg.lstsq(columns, logged, rcond=None)
    left = logged - columns @ (offset, gain)
    scatter = np.sqrt(np.sum(left**2) / (len(left) - 2))
    inverse = np.linalg.inv(columns.T @ columns)
    error = max(scatter * np.sqrt(inverse[0, 0]), _WRITTEN)
    return _Line(float(scatter), float(offset), float(error), float(gain))


def check_slip(data: TireData, radius: float | None) -> SlipCheck | None:
    """The check, on the used rows.

    Args:
        radius: rolling radius that is given [m]; one that is taken from the slip
            itself would agree with it.

    Returns:
        None without omega, v, a radius and a slip along that varies.
    """
    if radius is None or not {"omega", "v", "sigma_x"} <= set(data.columns):
        return None
    omega, v, sigma = (data.usable(name) for name in ("omega", "v", "sigma_x"))
    computed = slip_from_speeds(omega, v, radius)
    good = (np.abs(computed) < _LARGEST) & (np.abs(sigma) < _LARGEST) & (omega > 0)
    good &= computed > -1 + 1 / (1 + _LARGEST)
    if good.sum() < _LEAST_ROWS or np.ptp(computed[good]) < _WRITTEN:
        return None
    alpha = data.usable("alpha")[good] if "alpha" in data else None
    read_as = data.source.slip_definition
    own = "kappa" if read_as == "s" else read_as
    logged = slip_from_sigma(sigma[good], read_as, alpha)
    meant = {name: slip_from_sigma(computed[good], name) for name in _DEFINITIONS}
    lines = {name: _line(x, logged) for name, x in meant.items()}
    best = min(lines, key=lambda name: lines[name].scatter)
    if lines[best].scatter > _BETTER * lines[own].scatter:
        best = own
    others = [line.scatter for name, line in lines.items() if name != best]
    return SlipCheck(
        read_as=read_as,
        fits=read_as if best == own else best,
        radius=radius,
        rms=float(np.sqrt(np.mean((logged - meant[own]) ** 2))),
        told_apart=lines[best].scatter < _BETTER * min(others),
        **lines[best]._asdict(),
    )
