"""Predict loads that a fit has not seen, for tires that it does not know.

``python -m fits.rig_test.loads`` simulates a test of each tire, fits it without its
smallest, middle or largest load, and prints the share of the rows at that load in the
95 % band, by force. Some tires depend on load as the formula does. In the others, friction
and slip stiffness have factors of load that no Magic Formula can describe. The priors for
a published tire are made without its family.
"""

import argparse
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

import jax
import numpy as np

import tirefit
from fits.magic_formula_priors.make_priors import FAMILIES, TIRES, priors_without
from fits.rig_test.generate import DEG, LOADS, SMALL, recordings
from fits.rig_test.tire import NOMINAL, TRUE, RigTire
from tirefit.data.tir.tir import read_tir
from tirefit.fitting.mf.parts import coefficients_of
from tirefit.fitting.mf.priors import published_priors
from tirefit.fitting.problem.config import load_config

__all__ = ["CASES", "CHOSEN", "Case", "Share", "main", "shares"]

FORCES = ("fx", "fy", "mz", "mx")
STATES = ((82.7e3,), (0.0, 3 * DEG))
"""Pressure [Pa] and cambers [rad] of a test: 40 settings."""
_IN_95 = 1.96
_CHANGED, _CHANGED_WITH_LOAD = 0.15, 0.4
"""Relative standard deviations of changed coefficients: of all, and of those of load,
camber and pressure of friction, stiffness and trail."""


def _laws() -> dict[str, Callable]:
    """Name -> factors of friction and slip stiffness with the load [N]."""

    def over(fz):
        return np.maximum(fz, 20.0) / NOMINAL["FNOMIN"]

    return {
        "formula": lambda fz: (1.0, 1.0),
        "power": lambda fz: (over(fz) ** -0.12, over(fz) ** 0.15),
        "quadratic": lambda fz: (1 + 0.25 * (over(fz) - 0.6) ** 2, 1 - 0.4 * (over(fz) - 0.6) ** 2),
        "step": lambda fz: (
            1 - 0.08 * np.tanh((fz - 500) / 150),
            1 + 0.12 * np.tanh((fz - 700) / 200),
        ),
        "decay": lambda fz: (1 + 0.3 * np.exp(-fz / 250), 1 - 0.35 * np.exp(-fz / 300)),
        "knee": lambda fz: (
            1 - 0.25 * np.maximum(over(fz) - 0.7, 0),
            1 - 0.5 * np.maximum(over(fz) - 0.6, 0),
        ),
    }


LAWS = _laws()


class Case(NamedTuple):
    """A tire, and the law of its load dependence (a key of :data:`LAWS`)."""

    base: str  # "racing", "racing SEED" (changed at random), or a published file
    law: str

    @property
    def tire(self) -> RigTire:
        version, values = _base(self.base)
        return RigTire({**NOMINAL, **values}, version, LAWS[self.law])

    @property
    def family(self) -> str:
        """The family of published tires that it belongs to; empty for the racing tires."""
        return next((name for name, files in FAMILIES.items() if self.base in files), "")

    @property
    def name(self) -> str:
        return f"{Path(self.base).stem}, {self.law}"


_CHRONO = "chrono/335_65R22_5_G275MSA_{}psi.tir"
_MFEVAL = "mfeval_julia/MagicFormula{}_Parameters.tir"
CHOSEN = (
    Case("racing", "formula"),
    Case("racing", "power"),
    Case(_CHRONO.format(70), "formula"),
    Case("racing 1", "quadratic"),
    Case("racing 2", "formula"),
)
"""Tires on which the error beyond the loads of ``left_out.py`` was chosen."""

CASES = (
    Case(_MFEVAL.format(61), "formula"),
    Case(_MFEVAL.format(52), "formula"),
    Case("racing 5", "knee"),
    Case("racing 4", "decay"),
    Case(_MFEVAL.format(62), "step"),
    Case("racing 6", "formula"),
    Case(_CHRONO.format(95), "decay"),
    Case("racing 7", "step"),
)
"""Tires that were not used in that choice."""


def _base(name: str) -> tuple[str, dict[str, float]]:
    """Version and coefficients."""
    if name.endswith(".tir"):
        tir = read_tir(TIRES / name)
        names = coefficients_of(tir.version)
        return tir.version, {k: v for k, v in tir.numbers.items() if k in names}
    values = {k: v for k, v in TRUE.items() if k not in NOMINAL}
    if name != "racing":
        generator = np.random.default_rng([77, int(name.split()[1])])
        for key in values:
            of_load = key[:3] in ("PDX", "PDY", "PKX", "PKY", "QDZ", "QBZ") and key[-1] != "1"
            spread = _CHANGED_WITH_LOAD if of_load else _CHANGED
            values[key] *= 1 + spread * generator.standard_normal()
    return "6.1", values


def _tables(case: Case, seed: int, thin: int) -> list[dict[str, np.ndarray]]:
    """The columns of each recording, without its warm-up."""
    tables = []
    for one in recordings(seed, thin, tire=case.tire, states=STATES):
        columns = {name: values[one.warm] for name, values in one.measured.items()}
        sigma_x = columns["kappa"] / (1 - columns["kappa"])
        names = ("alpha", "fz", "gamma", "pressure", "v", *FORCES)
        tables.append({"sigma_x": sigma_x} | {name: columns[name] for name in names})
    return tables


def _at(table: Mapping[str, np.ndarray], load: float) -> np.ndarray:
    """The rows (n,) whose nearest load is this one."""
    loads = np.array(LOADS)
    return loads[np.argmin(np.abs(table["fz"][:, None] / loads - 1), axis=1)] == load


class Share(NamedTuple):
    """The rows of a force at a load that was left out."""

    rows: int
    within: float  # share in their 95 % band
    width: float  # median half width of the band over the load [-, m]


def shares(
    case: Case, load: float, seed: int = 1, thin: int = SMALL
) -> tuple[dict[str, Share], float]:
    """Fit a test without one load and predict that load.

    Returns:
        By force the rows at the load; and the share of fitted rows in their band, the
        smallest of the forces.
    """
    tables = _tables(case, seed, thin)
    fitted, left = [], []
    for number, table in enumerate(tables):
        out = _at(table, load)
        for chosen, parts in ((~out, fitted), (out, left)):
            part = {name: column[chosen] for name, column in table.items()}
            parts.append(tirefit.read_frame(part, name=f"recording {number}"))
    priors = partial(priors_without, case.family) if case.family else published_priors
    config = load_config(Path(__file__).with_name("fit.toml"))
    with patch("tirefit.fitting.mf.fit.published_priors", priors):
        fit = tirefit.fit_magic_formula(fitted, "mf61", config=config)
    inside = _counted(fit, fitted)
    return _counted(fit, left), min(share.within for share in inside.values())


def _counted(fit, tables) -> dict[str, Share]:
    found: dict[str, list] = {force: [] for force in FORCES}
    for table in tables:
        given = tirefit.predict(fit, table)
        for force in FORCES:
            half = _IN_95 * given[f"{force}_std"]
            inside = np.abs(given[force] - table[force]) <= half
            found[force].append(np.stack([inside, half / table["fz"]]))
    joined = {force: np.concatenate(parts, axis=1) for force, parts in found.items()}
    return {
        force: Share(len(inside), float(np.mean(inside)), float(np.median(width)))
        for force, (inside, width) in joined.items()
    }


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--chosen", action="store_true", help="the tires of CHOSEN")
    given = parser.parse_args()
    loads = sorted(LOADS)
    for case in CHOSEN if given.chosen else CASES:
        for load in (loads[0], loads[2], loads[-1]):
            found, inside = shares(case, load, given.seed)
            texts = (f"{f} {s.within:.0%} ±{s.width:.2g}" for f, s in found.items())
            rows = next(iter(found.values())).rows
            print(
                f"{case.name:<38} {load:6.0f} N {rows:5} rows  {'  '.join(texts)}"
                f"  fitted rows {inside:.0%}",
                flush=True,
            )


if __name__ == "__main__":
    main()
