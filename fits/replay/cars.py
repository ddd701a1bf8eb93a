"""Writes the measured logs of both 1:10 cars for ``tirefit``: :func:`write_logs`."""

import csv
import gzip
from pathlib import Path

import numpy as np

FITS = Path(__file__).parent.parent
POINT = {"a": 0.170, "d": 0.195, "others": 0.295}
"""Tracked point of the f1tenth car [m ahead of the rear axle], of each set of tires."""
SHORTEST = 4.0  # s

STEERING = """
[steering]
command = [-1.0, 1.0]  # of the DART car: the angle at full lock is not stated; the ratio
angle = [-0.35, 0.35]  # is therefore estimated by the fit [rad]
"""


def write_logs(source: str, folder: Path) -> tuple[list[Path], Path]:
    """Write the logs of ``a``, ``d``, ``others`` (f1tenth) or ``dart`` into a folder,
    with their ``vehicle.toml``; returns the logs' paths and the vehicle's."""
    folder.mkdir(parents=True, exist_ok=True)
    toml, paths = folder / f"{source}.toml", []
    if source == "dart":
        text = (FITS / "dart_jetracer/vehicle.toml").read_text()
        text = text.replace("[filter]", 'steering = "steering"\n' + STEERING + "[filter]")
        toml.write_text(text)
        for k, path in enumerate(sorted(FITS.glob("dart_jetracer/*/*.csv.gz"))):
            paths.append(folder / f"dart_{k}.csv")
            paths[-1].write_bytes(gzip.decompress(path.read_bytes()))
        return paths, toml
    text = (FITS / "measured_changes/f1tenth/vehicle.toml").read_text()
    toml.write_text(f"tracked_point = [{POINT[source]}, 0.0]\n{text}")
    with gzip.open(FITS / f"measured_changes/f1tenth/{source}.csv.gz", "rt") as file:
        header, *rows = csv.reader(file)
    values = np.array(rows, float)
    for run in np.unique(values[:, header.index("run_id")]):
        own = values[values[:, header.index("run_id")] == run]
        log = dict(zip(header, own.T, strict=True))
        time, v_y = log["time"], log["v_y"]
        if np.ptp(time) < SHORTEST:
            continue
        log["a_y"] = log["v_x"] * log["r"] + np.gradient(v_y, time)
        paths.append(folder / f"{source}_{run:.0f}.csv")
        names = ("time", "v_x", "v_y", "r", "a_y", "delta")
        cells = np.stack([log[name] for name in names], axis=1)
        np.savetxt(paths[-1], cells, "%.6f", ",", header=",".join(names), comments="")
    return paths, toml
