"""Errors of the prediction of a car, by quantity and horizon."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

QUANTITIES = {
    "yaw_rate": "rad/s",
    "sideslip": "rad",
    "a_y": "m/s2",
    "heading": "rad",
    "lateral": "m",
}
"""Compared quantity -> unit; ``lateral`` is the distance across the measured heading."""


class Errors(NamedTuple):
    """Predicted - measured at each horizon: {quantity: (windows, horizons)}, NaN if the
    log ends before."""

    of: Mapping[str, np.ndarray]

    def rms(self) -> dict[str, list[float | None]]:
        """Root mean square by quantity, for each horizon; None without windows."""
        found = {}
        for name, values in self.of.items():
            count = np.isfinite(values).sum(axis=0)
            squares = np.nansum(values**2, axis=0)
            rms = np.sqrt(squares / np.maximum(count, 1))
            found[name] = [float(x) if n else None for x, n in zip(rms, count, strict=True)]
        return found
