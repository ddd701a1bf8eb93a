"""A rig test of the tire of a ``.tir`` file."""

from pathlib import Path

import numpy as np

from tirefit.data.tir.tir import read_tir
from tirefit.models import TireInputs, forces
from tirefit.models.mf import mf_tire

FOLDER = Path(__file__).parents[1] / "data" / "tir"
TIRES = sorted(FOLDER.glob("*/*.tir"))
MF52, MF61, MF62 = (FOLDER / f"mfeval_julia/MagicFormula{n}_Parameters.tir" for n in (52, 61, 62))
TRUCK = FOLDER / "chrono/335_65R22_5_G275MSA_70psi.tir"
FAMILY = {"335": "truck", "MagicFormula52": "mf52", "MagicFormula6": "mf6"}

NOISE = 0.01
"""Noise over the load; of M_z over the load and the longest arm that it has."""


def family_of(path) -> str:
    return next(name for start, name in FAMILY.items() if path.name.startswith(start))


def tire_of(path):
    tir = read_tir(path)
    return mf_tire(tir.version, tir.numbers)


class Plan:
    """Ranges of a test: those of the file, limited to those of a rig."""

    def __init__(self, path):
        numbers = read_tir(path).numbers
        nominal, most = numbers["FNOMIN"], numbers["FZMAX"]
        self.top = most if family_of(path) == "truck" else min(1.5 * nominal, most)
        self.least = max(0.3 * nominal, numbers["FZMIN"])
        self.kappa = max(-0.35, numbers["KPUMIN"]), min(0.35, numbers["KPUMAX"])
        self.alpha = max(-0.22, numbers["ALPMIN"]), min(0.22, numbers["ALPMAX"])
        self.gamma = max(-0.08, numbers["CAMMIN"]), min(0.08, numbers["CAMMAX"])
        nominal_pressure = numbers.get("NOMPRES", 0.0)
        self.pressures = [nominal_pressure * x for x in (0.85, 1.0, 1.2)]
        self.pressures = self.pressures if nominal_pressure else [0.0]


def rows(parts):
    """Inputs (n,) and the run of each from (kappa, alpha, fz, gamma, pressure)."""
    cells = [np.broadcast_arrays(*part) for part in parts]
    kappa, alpha, fz, gamma, pressure = np.concatenate(cells, axis=1)
    run = np.repeat(np.arange(len(cells)), [len(cell[0]) for cell in cells])
    sigma_x = -kappa / (1 + kappa)
    v, time = np.full(len(fz), 16.0), np.zeros(len(fz))
    return TireInputs(sigma_x, alpha, fz, v, gamma, pressure, time), run


def sweeps(plan: Plan, seed: int, n: int = 60, loads: int = 5):
    """Pure and combined sweeps over loads, cambers and pressures, each a run."""
    generator = np.random.default_rng(seed)
    kappa, alpha = np.linspace(*plan.kappa, n), np.linspace(*plan.alpha, n)
    cambers, parts = (plan.gamma[0], 0.0, plan.gamma[1]), []
    for fz in np.linspace(plan.least, plan.top, loads):
        for pressure in plan.pressures:
            for gamma in cambers:
                parts.append((kappa, 0.0, fz, gamma, pressure))
                parts.append((0.0, alpha, fz, gamma, pressure))
            for at in (-0.12, -0.05, 0.05, 0.12):
                parts.append((kappa, at, fz, generator.choice(cambers), pressure))
    return rows(parts)


def points(plan: Plan, seed: int, over: float = 1.0, n: int = 60):
    """Other points: pure and combined slip at random, within the plan or at a load of
    ``over`` times the largest."""
    generator = np.random.default_rng([seed, 1])
    draw = generator.uniform
    loads = draw(plan.least, plan.top, 6) if over == 1 else [over * plan.top]
    parts = []
    for fz in loads:
        for pressure in plan.pressures:
            gamma = draw(*plan.gamma, n)
            parts.append((draw(*plan.kappa, n), 0.0, fz, gamma, pressure))
            parts.append((0.0, draw(*plan.alpha, n), fz, gamma, pressure))
            both = draw(*plan.kappa, n), 0.7 * draw(*plan.alpha, n)
            parts.append((*both, fz, gamma, pressure))
    return rows(parts)


def noise_of(inputs, mz) -> dict[str, np.ndarray]:
    """Standard deviation (n,) of each force; ``mz`` (n,) is the moment."""
    arm = float(np.max(np.abs(mz) / inputs.fz))
    fz = np.asarray(inputs.fz)
    return {"fx": NOISE * fz, "fy": NOISE * fz, "mz": NOISE * fz * arm}


def measured(path, seed: int = 0, n: int = 60, loads: int = 5) -> dict[str, np.ndarray]:
    """Columns of a test of this tire, with noise; ``run`` numbers its sweeps."""
    inputs, run = sweeps(Plan(path), seed, n, loads)
    true = forces(tire_of(path), inputs)._asdict()
    generator = np.random.default_rng([seed, 2])
    noisy = {
        name: np.asarray(true[name]) + std * generator.standard_normal(len(run))
        for name, std in noise_of(inputs, np.asarray(true["mz"])).items()
    }
    columns = {
        name: np.asarray(column)
        for name, column in inputs._asdict().items()
        if name not in ("v", "time") and (name != "pressure" or column[0] > 0)
    }
    return columns | noisy | {"run": run}
