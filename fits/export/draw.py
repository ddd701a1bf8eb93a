"""The figure and the asserted numbers of the case: ``python -m fits.export.draw``
writes ``forces_and_path.png`` to this folder.

The brush of each measured axle is fitted, exported, loaded by the target program, and
evaluated there.
"""

import importlib.util
import tempfile
from functools import cache
from pathlib import Path

import jax
import numpy as np
import yaml

import tirefit
from fits.export.avoidance import LOAD, shortest
from tirefit.report.canvas import BLUE, DARK, GREEN, ORANGE, RED, WIDE, Picture, panel_title, tidy

jax.config.update("jax_enable_x64", True)
HERE = Path(__file__).parent
ANGLES = np.linspace(-0.5, 0.5, 201)
"""Slip angles [rad] of the measured range."""
ENDINGS = {
    "casadi": "rear.py",
    "commonroad": "parameters_tire.yaml",
    "forzaeth": "rear_pacejka.yaml",
}
"""Target -> name of the file."""


@cache
def fitted(axle: str):
    """The brush of an axle, such as ``a_rear``."""
    return tirefit.fit(tirefit.read(HERE / f"{axle}.csv"), "brush")


def own(axle: str) -> np.ndarray:
    """F_y / F_z at the slip angles by tirefit, in the signs of ISO-W."""
    rows = {"alpha": ANGLES, "fz": np.full(len(ANGLES), LOAD), "v": 3.0 + 0 * ANGLES}
    return -tirefit.predict(fitted(axle), rows)["fy"] / LOAD


def values_of(axle: str) -> list[float]:
    """c_p a^2 [N] and mu of the fit of an axle."""
    return [fitted(axle).least_squares[name].value for name in ("cpa2", "mu")]


def module(path: Path):
    """A Python file as a module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec and spec.loader
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


def by_casadi(path: Path) -> np.ndarray:
    tire = getattr(module(path), path.stem)
    return np.array([float(tire(0.0, a, LOAD)[1]) for a in ANGLES]) / LOAD


def by_commonroad(path: Path) -> np.ndarray:
    """Forces by the formula of CommonRoad's single-track drift model."""
    from types import SimpleNamespace

    from vehiclemodels.utils.tire_model import formula_lateral

    tire = SimpleNamespace(**yaml.safe_load(path.read_text())["tire"])
    return np.array([formula_lateral(a, 0, LOAD, tire)[0] for a in ANGLES]) / LOAD


def by_forzaeth(path: Path) -> np.ndarray:
    """Forces by the formula of ForzaETH's simulator, whose slip angle has the opposite sign."""
    b, c, d, e = yaml.safe_load(path.read_text())["C_Pr"]
    x = b * -ANGLES
    return d * np.sin(c * np.arctan(x - e * (x - np.arctan(x))))


BY = {"casadi": by_casadi, "commonroad": by_commonroad, "forzaeth": by_forzaeth}
"""Target -> F_y / F_z at the slip angles, in the signs of ISO-W."""


@cache
def compared() -> dict[str, np.ndarray]:
    """Target -> F_y / F_z of the rear axle by the target program."""
    with tempfile.TemporaryDirectory() as folder:
        found = {}
        for target, force in BY.items():
            path = Path(folder, ENDINGS[target])
            tirefit.export(fitted("a_rear"), target, path)
            found[target] = force(path)
    return found


@cache
def way(tires: str):
    """The shortest path around the obstacle on a set of tires."""
    with tempfile.TemporaryDirectory() as folder:
        loaded = []
        for axle in ("front", "rear"):
            path = Path(folder, f"{axle}.py")
            tirefit.export(fitted(f"{tires}_{axle}"), "casadi", path)
            loaded.append(getattr(module(path), axle))
        return shortest(*loaded)


def properties() -> dict:
    from fits.export.reference import driven

    found = {
        f"{target}: largest miss, % of F_z": 100 * np.abs(force - own("a_rear")).max()
        for target, force in compared().items()
    }
    for tires in ("a", "d"):
        planned = way(tires)
        found[f"{tires}: distance"] = planned.distance
        axles = [values_of(f"{tires}_{axle}") for axle in ("front", "rear")]
        x, y = driven(*axles, planned.time, planned.steering)
        found[f"{tires}: place reached, scipy"] = y
        found[f"{tires}: distance over that of scipy"] = planned.distance / x
    for axle in ("a_rear", "d_rear"):
        for name, value in zip(("cpa2", "mu"), values_of(axle), strict=True):
            found[f"{axle} {name}"] = value
    return {name: float(value) for name, value in found.items()}


def main() -> None:
    picture = Picture(figsize=(WIDE, 6.4), layout="constrained")
    upper, lower = picture.subplots(2, 1)
    data = tirefit.read(HERE / "a_rear.csv")
    upper.plot(
        np.degrees(data["alpha"]),
        -data["fy"] / data["fz"],
        ".",
        ms=2,
        color="#bbbbbb",
        label="measured",
    )
    upper.plot(np.degrees(ANGLES), own("a_rear"), color=DARK, label="fitted brush")
    styles = zip(compared().items(), (BLUE, ORANGE, GREEN), "osD", strict=True)
    for (target, force), color, marker in styles:
        upper.plot(
            np.degrees(ANGLES),
            force,
            marker,
            color=color,
            ms=5,
            mfc="none",
            markevery=12,
            label=target,
        )
    tidy(upper, "slip angle [deg]", "$F_y / F_z$")
    panel_title(upper, "One tire in three programs")
    upper.legend(frameon=False, fontsize=8)
    for tires, color in (("a", BLUE), ("d", RED)):
        planned = way(tires)
        label = f"tires {tires.upper()}: {planned.distance:.2f} m"
        lower.plot(planned.x, planned.y, color=color, label=label)
    lower.axhline(0.5, color=DARK, lw=0.8, ls=":")
    tidy(lower, "longitudinal distance [m]", "lateral displacement [m]")
    panel_title(lower, "Shortest path around, at 4 m/s")
    lower.legend(frameon=False, fontsize=8)
    picture.savefig(HERE / "forces_and_path.png")


if __name__ == "__main__":
    main()
    for name, value in properties().items():
        print(f"{name:40s} {value:.6g}")
