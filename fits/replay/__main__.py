"""Predicts logs of measured 1:10 cars with tires that were fitted to other logs.

    python -m fits.replay --out out/replay [--only a]

Each car's logs are split in two; tires fitted to one half predict the other. The fit by
trajectory is compared with ``derive`` and ``fit``, with the steering as stated and as
estimated by the fit by trajectory. ``--out`` receives ``table.md``, ``table.json`` and
the figures of the f1tenth car.
"""

import argparse
import json
import tempfile
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import tirefit  # noqa: E402
from fits.replay.cars import write_logs  # noqa: E402
from tirefit.data.vehicle.vehicle import vehicle_toml  # noqa: E402
from tirefit.report.canvas import save_picture  # noqa: E402
from tirefit.report.vehicle import plotted, trajectory_figure  # noqa: E402

HORIZONS = (0.25, 0.5, 1.0, 2.0)
STEERING = ("steering_delay", "steering_offset")
UNKNOWNS = {"a": STEERING, "d": STEERING, "dart": (*STEERING, "steering_ratio", "sideslip_zero")}
WAYS = ("derive + fit", "derive + fit, steering found", "trajectory")


def derived(logs, toml: Path, folder: Path) -> list:
    """Brushes of front and rear axle by ``derive`` and ``fit``."""
    fits = []
    for axle in ("front", "rear"):
        out = folder / f"{axle}.csv"
        tirefit.derive_files(logs, toml, out, axle, believe=True)
        fits.append(tirefit.fit(tirefit.read(out), "brush"))
    return fits


def tires_of(source: str, logs, toml: Path, folder: Path) -> dict:
    """Method -> (vehicle file, front, rear), and the fit by trajectory."""
    fit = tirefit.fit_trajectory(logs, toml, unknowns=UNKNOWNS[source])
    found = folder / "found.toml"
    found.write_text(vehicle_toml(fit.vehicle, "by trajectory"))
    return {
        WAYS[0]: (toml, *derived(logs, toml, folder)),
        WAYS[1]: (found, *derived(logs, found, folder)),
        WAYS[2]: (found, *fit.axles.values()),
        "fit": fit,
    }


def rms(logs, vehicle, front, rear) -> dict:
    """Model (these tires, their linear form, the floor) -> rms at the horizons."""
    result = tirefit.replay(logs, vehicle, front, rear, horizons=HORIZONS)
    assert not any(result.logs.values()), "a tire was fitted to these logs"
    return {k: result.models[k].rms() for k in ("tire", "linear tire", "floor")} | {
        "windows": result.windows
    }


def halves(source: str, folder: Path) -> list[dict]:
    """Predictions of each half of the logs with tires fitted to the other half."""
    logs, toml = write_logs(source, folder)
    found = []
    for k in (0, 1):
        own, other = logs[k::2], logs[1 - k :: 2]
        tires = tires_of(source, own, toml, folder)
        found += [{"car": source, "half": k, "way": way, **rms(other, *tires[way])} for way in WAYS]
    return found


def line(one: dict) -> str:
    cells = [one["car"], f"{one['half']}", one["way"]]
    for at in (1, 2):
        for name in ("lateral", "heading", "yaw_rate"):
            cells.append(f"{one['tire'][name][at]:.3f}")
    cells += [f"{one['linear tire']['lateral'][2]:.3f}"]
    cells += [f"{one['floor']['lateral'][2]:.3f}", str(one["windows"][2])]
    return f"| {' | '.join(cells)} |"


HEAD = """\
| car | half | tires by | lateral 0.5 s [m] | heading [rad] | yaw rate [rad/s] \
| lateral 1 s [m] | heading | yaw rate | linear tires, lateral 1 s | floor | starts |
|---|---|---|---|---|---|---|---|---|---|---|---|
"""


def other_tires(folder: Path, pictures: Path) -> tuple[list[dict], list[str]]:
    """Predictions of logs D with tires A and D, and the change of friction."""
    fits, notes, found = {}, [], []
    for source in ("a", "d"):
        logs, toml = write_logs(source, folder / source)
        fits[source] = tirefit.fit_trajectory(logs, toml)
    logs, toml = write_logs("d", folder / "d")
    for source, fit in fits.items():
        result = tirefit.replay(logs, fits["d"].vehicle, *fit.axles.values(), horizons=HORIZONS)
        errors = {k: v.rms() for k, v in result.models.items()}
        way = f"tires {source.upper()} on logs D"
        found.append({"car": "d", "half": "all", "way": way, **errors})
        found[-1]["windows"] = result.windows
    for axle in ("front", "rear"):
        a, d = (fits[k].parameters[f"{axle}.mu"] for k in ("a", "d"))
        ratio = d.value / a.value
        std = ratio * ((a.std / a.value) ** 2 + (d.std / d.value) ** 2) ** 0.5
        notes.append(f"{axle} friction D over A: {ratio:.3f} ± {std:.3f}")
    logs, _ = write_logs("a", folder / "a")
    result = tirefit.replay(logs, fits["a"].vehicle, *fits["a"].axles.values())
    for name, picture in (
        ("replay", plotted(result, "path")),
        ("series", plotted(result, "series")),
        ("tires", trajectory_figure(fits["a"])),
    ):
        save_picture(picture, pictures / f"{name}.png")
    return found, notes


def diagnosed(folder: Path, pictures: Path) -> list[str]:
    """Effects of the car of set A, diagnosed on three logs, and predictions of the other two
    with and without them, on tires of ``derive`` and ``fit``."""
    logs, toml = write_logs("a", folder)
    tires = derived(logs[:3], toml, folder)
    found = tirefit.diagnose_vehicle(logs[:3], toml, *tires, holdout=logs[3:])
    save_picture(found.plot(), pictures / "diagnosis.png")
    result = tirefit.replay(logs[3:], toml, *tires, horizons=HORIZONS, effects=found)
    save_picture(result.plot(), pictures / "with_effects.png")
    return [found.summary(), result.summary()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", choices=("a", "d", "dart", "tires", "diagnosis"))
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    found, notes = [], []
    with tempfile.TemporaryDirectory() as folder:
        for source in ("a", "d", "dart"):
            if asked.only in (None, source):
                found += halves(source, Path(folder) / source)
        if asked.only in (None, "tires"):
            more, notes = other_tires(Path(folder), asked.out)
            found += more
        if asked.only in (None, "diagnosis"):
            notes += diagnosed(Path(folder), asked.out)
    text = HEAD + "\n".join(map(line, found)) + "\n\n" + "\n\n".join(notes) + "\n"
    (asked.out / "table.json").write_text(json.dumps(found, indent=1) + "\n")
    (asked.out / "table.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
