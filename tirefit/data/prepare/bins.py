"""Names of what a rig was set to."""

from collections.abc import Mapping, Set

import numpy as np

from tirefit.data.prepare.set_points import Settings

SHOWN = {
    "fz": (1.0, "N"),
    "gamma": (180 / np.pi, "deg"),
    "alpha": (180 / np.pi, "deg"),
    "pressure": (1e-3, "kPa"),
    "v": (1.0, "m/s"),
    "sigma_x": (100.0, "%"),
}
"""Channel -> factor from SI and unit in the names of bins."""

_ANGLES = {"gamma": " camber", "alpha": " slip angle"}

_FINE = 0.02
"""Of a setting, and of its distance to others, by which its name may be off; and in the
unit of the name: nothing is set to a hundredth of a degree or of a newton."""


def setting_names(settings: Settings) -> list[str]:
    """Each setting with its unit, in as few digits as tell it from its neighbours."""
    scale, unit = SHOWN[settings.name]
    center = settings.center * scale
    apart = np.diff(center).min() if len(center) > 1 else np.max(np.abs(center))
    # Nothing is set to a twentieth of a step: that is zero.
    size = min([apart, *(abs(c) for c in center if abs(c) > 0.05 * apart)])
    for places in range(-5, 7):
        # + 0.0: no setting is called -0.
        rounded = [round(float(value), places) + 0.0 for value in center]
        off = float(np.max(np.abs(np.array(rounded) - center)))
        if off <= _FINE * max(size, 1.0) and len(set(rounded)) == len(rounded):
            break
    return [f"{value:.{max(places, 0)}f} {unit}" for value in rounded]


def bin_name(
    level: Mapping[str, int], names: Mapping[str, list[str]], varied: Set[str]
) -> str:
    """The name of a bin: its settings of the channels ``varied``.

    If camber and slip angle both varied, their names follow the values in degrees.
    """
    words = _ANGLES if varied >= _ANGLES.keys() else {}
    shown = ((c, k) for c, k in level.items() if c in varied and k >= 0)
    return " ".join(names[c][k] + words.get(c, "") for c, k in shown) or "all"
