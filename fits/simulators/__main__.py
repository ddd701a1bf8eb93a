"""Simulators whose fault is known, against measured drives: is the fault named, and how far
does the better reading predict data left out?

    python -m fits.simulators --out out/simulators [--drive free] [--simulator linear]
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

import tirefit
from fits.measured_changes.logs import Logs, data, table
from tirefit.data.accept import as_data
from tirefit.data.table import TireData
from tirefit.diagnosis.summary.readings import SLOPE
from tirefit.diagnosis.summary.result import Diagnosis
from tirefit.results import DataError

DRIVES = {"free": Logs(("free",)), "later": Logs(("later",)), "f1tenth_a": Logs(("a",), every=10)}
ON_REQUEST = {"others": Logs(("others",), every=20)}
"""Drives that are run by name: rows on which a carcass could take the place of the stiffness."""
HERE = Path(__file__).parent


class Drive(NamedTuple):
    """The rows of a drive with the plain brush fitted to them; ``late`` delays a column."""

    alpha: np.ndarray
    fz: np.ndarray
    v: np.ndarray
    cpa2: float
    mu: float
    delayed: Callable[[float], np.ndarray]
    lagged: Callable[[float], np.ndarray]

    def brush(self, alpha=None, stiffer=1.0, rougher=1.0):
        """Force of the brush in the formula of its textbook, [N]."""
        slip = np.tan(self.alpha if alpha is None else alpha)
        limit = rougher * self.mu * self.fz
        share = np.minimum(2 * stiffer * self.cpa2 * np.abs(slip) / (3 * limit), 1.0)
        return np.sign(slip) * limit * (3 * share - 3 * share**2 + share**3)


def _steps(drive: Drive):
    entries = np.linspace(-0.4, 0.4, 21)
    return drive.brush(entries[np.argmin(abs(drive.alpha[:, None] - entries), axis=1)])


class Fault(NamedTuple):
    """Forces of a simulator with a known fault. It is found as a ``structure`` (an id), as a
    ``parameter`` that is ``factor`` times that of the brush, or as an ``effect`` of its own."""

    forces: Callable[[Drive], np.ndarray]
    structure: str = ""
    parameter: str = ""
    factor: float = 1.0
    effect: str = ""
    size: float = 0.0


SIMULATORS = {
    "linear": Fault(lambda d: 2.4 * d.cpa2 * d.alpha, "no_saturation", SLOPE, 1.2),
    "steep": Fault(lambda d: 8.0 * d.cpa2 * d.alpha, "no_saturation", SLOPE, 4.0),
    "clipped": Fault(
        lambda d: np.clip(2 * d.cpa2 * d.alpha, -d.mu * d.fz, d.mu * d.fz), "clipped", SLOPE
    ),
    "steps": Fault(_steps, "steps"),
    "late": Fault(lambda d: d.brush(d.delayed(0.1)), "own_delay"),
    "slow": Fault(lambda d: d.brush(d.lagged(0.15)), "own_lag"),
    "stiff": Fault(lambda d: d.brush(stiffer=1.3), parameter="cpa2", factor=1.3),
    "rough": Fault(lambda d: d.brush(rougher=1.3), parameter="mu", factor=1.3),
    "twice": Fault(lambda d: 2 * d.brush(), parameter="mu", factor=2.0),
    "degrees": Fault(lambda d: d.brush(np.rad2deg(d.alpha)), "always_sliding"),
    "offset": Fault(lambda d: d.brush(d.alpha + 0.02), effect="slip_offset", size=0.02),
    "speed": Fault(
        lambda d: d.brush(rougher=1 - 0.05 * (d.v - d.v.mean())), effect="friction_speed_linear"
    ),
}


FAR = {
    f"{word}_{factor:g}": Fault(
        lambda d, key=key, factor=factor: d.brush(**{key: factor}),
        parameter=parameter,
        factor=factor,
    )
    for word, key, parameter, factors in (
        ("friction", "rougher", "mu", (0.2, 0.5, 2.0, 4.0)),
        ("stiffness", "stiffer", "cpa2", (0.2, 0.5, 2.0, 5.0)),
    )
    for factor in factors
}
"""Parameters far from those of the drive; run by name."""


SAID = {
    "no_saturation": "proportional",
    "clipped": "sharp corner",
    "steps": "different values",
    "own_delay": " late",
    "own_lag": "time constant",
    "always_sliding": "at its limit",
}
"""Words on a structure in the refusal of a simulator that no tire follows."""

COARSE = "too far apart"
"""Words on rows that cannot show an own delay or lag."""


MADE = 900  # rows of the drive that is made


def made_up() -> tuple[TireData, Drive]:
    """Rows of a brush with noise, and the brush: no measured drive."""
    rng = np.random.default_rng(56)
    time = 0.05 * np.arange(MADE)
    alpha = 0.16 * np.sin(2 * np.pi * time / 7.0) * np.sin(2 * np.pi * time / 31.0)
    fz = 4000 * (1 + 0.2 * np.sin(2 * np.pi * time / 11.0))
    v = 15 + 2 * np.sin(2 * np.pi * time / 17.0)
    drive = Drive(alpha, fz, v, 4e4, 0.9, None, None)
    fy = drive.brush() + rng.normal(0, 60.0, MADE)
    return as_data({"time": time, "alpha": alpha, "fz": fz, "v": v, "fy": fy}), drive


def driven(name: str) -> tuple[TireData, Drive]:
    """A measured drive and its plain brush, or the one that is made."""
    if name == "made":
        return made_up()
    made = table((DRIVES | ON_REQUEST)[name])
    rows = data(made, name)
    fitted = tirefit.fit(rows, "brush").parameters

    def lagged(constant: float):
        moved = np.array(made.columns["alpha"])
        for part in made.parts:
            time = made.columns["time"][part]
            for before, row, step in zip(part[:-1], part[1:], np.diff(time), strict=True):
                keep = np.exp(-step / constant)
                moved[row] = keep * moved[before] + (1 - keep) * moved[row]
        return moved[made.kept]

    cpa2, mu = fitted["cpa2"].value, fitted["mu"].value
    delayed = lambda delay: made.late("alpha", delay)[made.kept]  # noqa: E731
    return rows, Drive(made["alpha"], made["fz"], made["v"], cpa2, mu, delayed, lagged)


def judged(fault: Fault, drive: Drive, found: Diagnosis) -> dict:
    """Whether the fault is named or said, with its size."""
    both = found.simulator.readings
    structures = {one.id: one for one in both.structure}
    truth = fault.factor * {"mu": drive.mu}.get(fault.parameter, drive.cpa2)
    own = both.simulator
    right, size, times = True, "", None
    if fault.parameter in both.measured.parameters and own:
        # What the answer compares: the simulator's parameter over the measured one.
        here, there = (side.parameters[fault.parameter] for side in (both.measured, own))
        times = there.value / here.value
        error = times * np.hypot(here.std / here.value, there.std / there.value)
        times = [round(float(times), 3), round(float(error), 3)]
    if fault.structure:
        right = fault.structure in structures
        if right and fault.parameter:
            size = structures[fault.structure].slope / drive.cpa2 / 2
            right = abs(size / fault.factor - 1) < 0.02
    elif fault.parameter:
        size = own.parameters[fault.parameter].value / truth * fault.factor if own else ""
        right = own is not None and abs(size / fault.factor - 1) < 0.05
    else:
        effect = own.effects.get(fault.effect) if own else None
        right = effect is not None and effect.probability >= 0.5
        if effect is not None:
            size = effect.value
            right = right and (not fault.size or abs(abs(size) / fault.size - 1) < 0.05)
    best = min(both.rms_changed, both.measured.rms_left_out)
    told = both.rms_changed if both.first == "changed" else both.measured.rms_left_out
    return {
        "right": bool(right),
        "said": fault.structure.startswith("own_") and "own_time" in structures,
        "size": round(float(size), 4) if size != "" else None,
        "times_measured": times,
        "structure": sorted(structures),
        "own": {k: round(e.probability, 2) for k, e in own.effects.items()} if own else None,
        "first": both.first,
        "told_rms": round(told, 4),
        "best_rms": round(best, 4),
        "verdict": [*found.verdict.effects],
        "probability": {k: round(e.probability, 2) for k, e in found.verdict.each.items()},
    }


def main() -> None:
    """Runs the asked pairs and writes ``table.json``."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--drive", action="append", choices=[*DRIVES, *ON_REQUEST, "made"])
    parser.add_argument("--simulator", action="append", choices=[*SIMULATORS, *FAR])
    asked = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    asked.out.mkdir(parents=True, exist_ok=True)
    for name in asked.drive or DRIVES:
        rows, drive = driven(name)
        for simulator in asked.simulator or SIMULATORS:
            fault = (SIMULATORS | FAR)[simulator]
            try:
                line = judged(fault, drive, tirefit.diagnose(rows, sim={"fy": fault.forces(drive)}))
            except DataError as error:
                words = SAID.get(fault.structure, "-"), COARSE
                said = any(one in str(error) for one in words)
                line = {"right": False, "said": bool(said), "refused": str(error)}
            line = {"drive": name, "simulator": simulator, **line}
            print(json.dumps(line), flush=True)
            with (asked.out / "table.jsonl").open("a") as file:
                file.write(json.dumps(line) + "\n")


if __name__ == "__main__":
    main()
