"""Names of what a rig was set to."""

from collections.abc import Mapping

import numpy as np

from tirefit.data.prepare.set_points import Settings

__all__ = ["SHOWN", "bin_name", "setting_names"]

SHOWN = {
    "fz": (1.0, "N"),
    "gamma": (180 / np.pi, "deg"),
    "alpha": (180 / np.pi, "deg"),
    "pressure": (1e-3, "kPa"),
    "v": (1.0, "m/s"),
    "sigma_x": (100.0, "%"),
}
"""Channel -> factor from SI and unit in the names of bins."""

_FINE = 0.02
"""Of the distance of two settings, by which their names may be off; and in the unit of
the name: nothing is set to a hundredth of a degree or of a newton."""


def setting_names(settings: Settings) -> list[str]:
    """Each setting with its unit, in as few digits as tell it from its neighbours."""
    scale, unit = SHOWN[settings.name]
    center = settings.center * scale
    size = np.min(np.diff(center)) if len(center) > 1 else np.max(np.abs(center))
    for places in range(-5, 7):
        # + 0.0: no setting is called -0.
        rounded = [round(float(value), places) + 0.0 for value in center]
        if np.max(np.abs(np.array(rounded) - center)) <= _FINE * max(size, 1.0):
            break
    return [f"{value:.{max(places, 0)}f} {unit}" for value in rounded]


def bin_name(level: Mapping[str, int], names: Mapping[str, list[str]], told) -> str:
    """The name of a bin: of the channels ``told``, which had several settings."""
    parts = [names[c][k] for c, k in level.items() if c in told and k >= 0]
    return " ".join(parts) or "all"
