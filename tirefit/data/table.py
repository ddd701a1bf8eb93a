"""The checked, canonical data that every fit reads: :class:`TireData`."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from tirefit.results import Problem

__all__ = ["CANONICAL", "Source", "TireData"]

CANONICAL = {
    "time": ("s", "time"),
    "sigma_x": ("-", "longitudinal physical slip, braking positive"),
    "alpha": ("rad", "slip angle"),
    "omega": ("rad/s", "wheel speed"),
    "fx": ("N", "longitudinal force, braking positive"),
    "fy": ("N", "lateral force, positive for alpha > 0"),
    "fz": ("N", "load"),
    "mz": ("N m", "aligning moment"),
    "v": ("m/s", "forward speed of the wheel centre"),
    "gamma": ("rad", "camber angle"),
    "pressure": ("Pa", "inflation pressure"),
    "temperature": ("degC", "tire temperature"),
}
"""Canonical column -> (unit, meaning); each may have a ``<column>_std`` beside it."""


@dataclass(frozen=True)
class Source:
    """Where data came from and what was assumed in reading them.

    ``columns`` maps a canonical column to the file's own header; ``units`` to the
    unit it was read in; ``slip_definition`` is the definition of the file's slip
    column (a key of ``slip.SLIP_DEFINITIONS``); ``line`` holds each row's line.
    """

    path: str = ""
    sha256: str = ""
    convention: str = "braking"
    slip_definition: str = "sigma_x"
    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    assumptions: tuple[str, ...] = ()
    masked: tuple[Problem, ...] = ()
    line: np.ndarray | None = None


@dataclass(frozen=True)
class TireData:
    """Measured force-slip data in the canonical convention (see ``tirefit.slip``).

    ``columns`` holds float64 arrays of shape ``(n,)`` by canonical name. Rows are
    never dropped: ``used`` (n,) bool is False for a masked row, whose values may be
    NaN. ``run`` (n,) int indexes ``runs``.
    """

    name: str
    columns: Mapping[str, np.ndarray]
    used: np.ndarray
    run: np.ndarray
    runs: tuple[str, ...]
    source: Source = field(default_factory=Source)

    def __len__(self) -> int:
        return len(self.used)

    def __contains__(self, column: str) -> bool:
        return column in self.columns

    def __getitem__(self, column: str) -> np.ndarray:
        return self.columns[column]

    @property
    def n(self) -> int:
        """Number of used rows."""
        return int(np.count_nonzero(self.used))

    def where(self, rows: np.ndarray) -> "TireData":
        """The same data with only ``rows`` (n,) bool used; nothing is dropped."""
        return replace(self, used=self.used & rows)

    def usable(self, column: str) -> np.ndarray:
        """The used rows of one column, shape (n_used,)."""
        return self.columns[column][self.used]
