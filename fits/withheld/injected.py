"""Known changes put into measured data: the rear axle of ``fits/dart_rear_axle``.

The file has other effects, too. The score is whether the change is named, whatever else
is named, provided that it is not named for the unchanged rows.
"""

from pathlib import Path

import numpy as np

from fits.withheld.effects import family_of
from fits.withheld.patch import plain_brush

__all__ = ["CHANGES", "half", "injected", "raw"]

FILE = Path(__file__).parents[1] / "dart_rear_axle" / "free_driving.csv"
C, MU = 39.3, 0.702  # N, -: the fit of fits/dart_rear_axle
RIG = "# A car; slip angle and force of an axle are derived from its motion.\n"


def read_axle() -> dict[str, np.ndarray]:
    """Columns of the measured file; ``run`` is the number of the log."""
    names = FILE.read_text().split("\n", 1)[0].split(",")
    text = np.genfromtxt(FILE, delimiter=",", skip_header=1, dtype=str)
    columns = {name: text[:, k] for k, name in enumerate(names)}
    run = np.unique(columns.pop("run"), return_inverse=True)[1]
    return {name: value.astype(float) for name, value in columns.items()} | {"run": run}


def _delay(data, size, _):
    out = data["fy"].copy()
    for run in np.unique(data["run"]):
        rows = data["run"] == run
        time = data["time"][rows]
        out[rows] = np.interp(time - size, time, out[rows])
    return {"fy": out}


def _force_zero(data, size, _):
    return {"fy": data["fy"] + size}


def _heading(data, size, _):
    return {"alpha": data["alpha"] + size}


def _friction(data, size, g):
    """The friction of a brush changes at a time in the middle of the record."""
    start = np.quantile(data["time"], g.uniform(0.3, 0.7))
    slip = np.tan(data["alpha"])
    before = plain_brush(slip, data["fz"], C, MU)[0]
    after = plain_brush(slip, data["fz"], C, MU * (1 + size))[0]
    return {"fy": data["fy"] + (after - before) * (data["time"] > start)}


CHANGES = {
    "channel_delay": (_delay, 0.02, 0.10),
    "force_offset": (_force_zero, 0.3, 1.2),
    "slip_offset": (_heading, 0.01, 0.04),
    "friction_step": (_friction, 0.15, 0.4),
}
"""Effect -> (change, smallest size, largest): s, N, rad, share of the friction."""


def half(which: int) -> dict[str, np.ndarray]:
    """The first (0) or the second (1) half of the file's rows."""
    data = read_axle()
    n = len(data["time"]) // 2
    return {name: values[which * n : (which + 1) * n] for name, values in data.items()}


def _label(which: int, n: int) -> dict:
    return {
        "effects": [], "families": [], "forms": [], "amplitudes": [], "kind": "",
        "noise_effects": [], "leave_out": None, "design": "axle", "half": which,
        "noise": "measured", "n": n, "force": "fy", "sealed": False,
    }  # fmt: skip


def raw(which: int) -> tuple[dict, dict, str]:
    """Columns, label and rig text of a half as measured."""
    data = half(which)
    return data, {**_label(which, len(data["time"])), "set": "raw"}, RIG


def injected(g) -> tuple[dict, dict, str]:
    """Columns, label and rig text of a half with one change in it."""
    which = int(g.integers(2))
    data = half(which)
    effect = str(g.choice(list(CHANGES)))
    change, low, high = CHANGES[effect]
    size = float(np.exp(g.uniform(np.log(low), np.log(high))))
    if effect != "channel_delay":
        size *= float(g.choice([-1, 1]))
    changed = data | change(data, size, g)
    moved = {name: changed[name] - data[name] for name in ("fy", "alpha")}
    label = _label(which, len(data["time"])) | {
        "set": "injected",
        "effects": [effect],
        "families": [family_of(effect)],
        "forms": [effect],
        "amplitudes": [size],
        "kind": effect,
        "changed_rms": {k: float(np.sqrt(np.mean(x**2))) for k, x in moved.items()},
    }
    return changed, label, RIG
