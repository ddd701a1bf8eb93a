"""Fits the tires of measured 1:10 cars and writes them for simulators of such cars.

    python -m fits.cars --out out/cars          # 2 min
    python -m fits.cars --out out/cars --again  # write the files of these fits again

``--out`` receives the fits, ``fits/cars/CAR`` the files, ``fits/cars/README.md`` the table.
"""

import argparse
import json
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402

import tirefit  # noqa: E402
from fits.replay.cars import write_logs  # noqa: E402
from tirefit.data.vehicle.vehicle import load_vehicle  # noqa: E402
from tirefit.fitting.source import given_tire  # noqa: E402
from tirefit.params import parameter_values  # noqa: E402

HERE = Path(__file__).parent
REAR = HERE.parent / "dart_rear_axle"
CARS = {"f1tenth_a": "a", "f1tenth_d": "d"}
"""Car -> its logs in ``fits/replay/cars.py``."""

ONE, TWO = ("commonroad", "gymkhana"), ("gymkhana-stp", "forzaeth")
FILES = {"commonroad": "parameters_tire.yaml"}
DRAWS = 4000
START, END = "<!-- table: python -m fits.cars -->\n", "<!-- end -->"


def fitted(out: Path) -> None:
    """Fit all cars; front.json, rear.json, vehicle.toml and trajectory.json in ``out/CAR``."""
    for car, source in CARS.items():
        logs, toml = write_logs(source, out / car / "logs")
        tirefit.fit_trajectory(logs, toml).save(out / car)
    folder = out / "dart"
    logs, _ = write_logs("dart", folder / "logs")
    (folder / "vehicle.toml").write_text((REAR / "vehicle.toml").read_text())
    tirefit.derive_files(logs, folder / "vehicle.toml", folder / "rear.csv", "rear")
    fit = tirefit.fit(tirefit.read(folder / "rear.csv"), "brush", config={"force": "fy"})
    (folder / "rear.json").write_text(fit.to_json())


def written(out: Path, into: Path) -> None:
    """Write the files of all cars into ``into/CAR``."""
    for car in (*CARS, "dart"):
        fits, folder = out / car, into / car
        folder.mkdir(parents=True, exist_ok=True)
        axles = {axle: fits / f"{axle}.json" for axle in ("front", "rear")}
        axles = {axle: path for axle, path in axles.items() if path.exists()}
        for target in ONE:
            path = folder / FILES.get(target, f"{target}.yaml")
            tirefit.export(axles["rear"], target, path, force=True)
        for axle, path in axles.items():
            toml = fits / "vehicle.toml"
            file = folder / f"rubber_{axle}.yaml"
            tirefit.export(None, "slipx", file, **{axle: path}, vehicle=toml, force=True)
        if len(axles) == 2:
            for target in TWO:
                tirefit.export(None, target, folder / f"{target}.yaml", **axles, force=True)
            source, path = fits / "trajectory.json", folder / "autoware.param.yaml"
            tirefit.export(source, "autoware", path, force=True)
            (folder / "f1tenth_gym.yaml").write_text(f1tenth_gym(fits, axles))


def f1tenth_gym(fits: Path, axles: dict[str, Path]) -> str:
    """Parameters of f1tenth_gym's single track, F_y = mu C_S F_z alpha, with 95 % intervals; a
    cornering stiffness is taken at zero slip, and mu is that of the rear axle."""
    car, generator = load_vehicle(fits / "vehicle.toml"), np.random.default_rng(0)
    given = {axle: given_tire(path) for axle, path in axles.items()}
    drawn = {
        axle: [parameter_values(tire) for tire in (one.tire, *one.drawn(generator, DRAWS))]
        for axle, one in given.items()
    }
    mu = np.array([values["mu"] for values in drawn["rear"]])
    loads = {axle: one.content["reference"]["fz"] for axle, one in given.items()}
    numbers = {"mu": mu}
    for key, axle in (("C_Sf", "front"), ("C_Sr", "rear")):
        numbers[key] = np.array([2 * v["cpa2"] for v in drawn[axle]]) / (mu * loads[axle])
    lines = [
        "# tires of f1tenth_gym's single-track model, by tirefit: see README.md",
        "# the tires of this model are linear: F_y = mu C_S F_z alpha, and mu is no limit",
    ]
    for key, (value, *draws) in numbers.items():
        low, high = np.percentile(draws, (2.5, 97.5))
        lines.append(f"{key}: {value:.5g}  # +- {np.std(draws):.2g}, 95 %: {low:.4g} to {high:.4g}")
    stated = {"lf": car.l_f, "lr": car.l_r, "m": car.mass, "I": car.yaw_inertia}
    lines += [f"{key}: {value:.5g}  # as stated, not estimated" for key, value in stated.items()]
    return "\n".join(lines) + "\n"


def table(out: Path) -> str:
    """The estimates of all cars as a table in Markdown."""
    lines = ["| car | parameter | value ± standard error | 95 % | unit |", "|---|---|---|---|---|"]
    for car in (*CARS, "dart"):
        found = out / car / "trajectory.json"
        found = found if found.exists() else out / car / "rear.json"
        for name, one in json.loads(found.read_text())["parameters"].items():
            if one["fixed"]:
                continue
            low, high = one["ci95"]
            name = name if "." in name or name.startswith("steer") else f"rear.{name}"
            lines.append(
                f"| {car} | `{name}` | {one['value']:.4g} ± {one['std']:.2g} |"
                f" {low:.4g} to {high:.4g} | {one['unit']} |"
            )
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/cars"))
    parser.add_argument("--again", action="store_true")
    given = parser.parse_args()
    out = given.out
    if not given.again:
        fitted(out)
    written(out, HERE)
    readme = HERE / "README.md"
    text = readme.read_text(encoding="utf-8")
    before, _, rest = text.partition(START)
    readme.write_text(f"{before}{START}\n{table(out)}\n{END}{rest.partition(END)[2]}", "utf-8")


if __name__ == "__main__":
    main()
