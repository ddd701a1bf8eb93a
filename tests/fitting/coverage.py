"""Coverage of the 95 % intervals on synthetic data of known truth.

An interval holds the truth where the profile deviance at the true value is below the
level of the interval; the posterior's central interval holds it where the posterior
probability below the truth lies between 2.5 and 97.5 %. Both are computed with the
functions that make the intervals of a fit. Run as a script:

    python tests/fitting/coverage.py brush-d rig 1600
"""

import sys
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.data.table import TireData
from tirefit.fitting.estimate import fit
from tirefit.fitting.problem.build import build
from tirefit.fitting.problem.config import parse_config
from tirefit.fitting.solve.inference import deviance, minima
from tirefit.fitting.solve.multistart import solve_problem
from tirefit.fitting.uncertainty.importance import draw_weighted
from tirefit.fitting.uncertainty.posterior import _density, _draw, _Run, _whitening
from tirefit.models import MODELS, TireInputs, forces
from tirefit.params import with_values


class Setting(NamedTuple):
    """Tire, load and noise of one kind of measurement."""

    cpa2: float
    mu: float
    fz: float
    slip_std: float
    force_std: float


SETTINGS = {
    "rig": Setting(5e4, 1.0, 4000.0, 0.001, 40.0),
    # S section 5.1: the printed noise figures are variances.
    "seed": Setting(2.5e5, 0.98, 27e3, np.sqrt(0.2e-4), np.sqrt(0.2e-2) * 27e3),
    "plain": Setting(5e4, 1.0, 4000.0, 0.0, 40.0),
}
EXTRA = {"d": 0.2, "m": 0.8, "n": 0.01, "h": 0.5}
SPEEDS = np.array([10.0, 20.0, 30.0])


def truth_of(model: str, setting: Setting) -> dict[str, float]:
    letters = model.partition("-")[2]
    extra = {k: v for k, v in EXTRA.items() if k in letters}
    return {"cpa2": setting.cpa2, "mu": setting.mu} | extra


def synthetic(model, setting: Setting, rows: int, reach: float, seed: int) -> TireData:
    """Slips uniform from 0 to ``reach`` times the slip of full sliding at d = 0."""
    generator = np.random.default_rng(seed)
    truth = truth_of(model, setting)
    top = reach * 1.5 * setting.mu * setting.fz / setting.cpa2
    slip = generator.uniform(0, top, rows)
    speed = SPEEDS[generator.integers(0, len(SPEEDS), rows)]
    tire = with_values(MODELS[model], truth)
    force = np.asarray(forces(tire, TireInputs(slip, 0.0, setting.fz, speed)).fx)
    columns = {
        "sigma_x": slip + setting.slip_std * generator.standard_normal(rows),
        "fx": force + setting.force_std * generator.standard_normal(rows),
        "fz": np.full(rows, setting.fz),
        "v": speed,
    }
    return TireData("synthetic", columns, np.ones(rows, bool), np.zeros(rows, int), ("r",))


def config_of(setting: Setting, estimated: bool):
    noise = {} if estimated else {"fx": setting.force_std}
    if setting.slip_std > 0:
        noise["sigma_x"] = setting.slip_std
    # One start: it lies near the truth, and a far minimum would show as not covered.
    return parse_config({"noise": noise, "solver": "gauss-newton", "starts": 1})


def holds(model, setting: Setting, data, estimated: bool, seed: int, posterior: bool):
    """Whether the intervals of profile and posterior contain the truth: (p,) each."""
    config = config_of(setting, estimated)
    solved = solve_problem(build(data, model, config), config)
    problem = solved.problem
    z_true = np.asarray(problem.layout.unconstrained(truth_of(model, setting)))
    size = len(z_true)
    base = deviance(problem, jnp.asarray(solved.z))
    ends = minima(problem, np.tile(solved.z, (size, 1)), np.arange(size), z_true)
    inside = ends.deviance - float(base) < solved.level
    if not posterior:
        return inside, np.full(size, np.nan)
    return inside, _posterior_holds(solved, z_true, seed)


def _posterior_holds(solved, z_true, seed: int):
    """Weighted points, fast enough for thousands of data sets; if they are refused,
    ensembles of emcee, as in a fit."""
    density, (center, root) = _density(solved), _whitening(solved)
    weighted = draw_weighted(density, center, root, seed, 3000)
    draws = weighted.draws
    if weighted.refused:
        samples, *_ = _draw(density, len(z_true), _Run(seed, 32, 10**9, 600, None))
        draws = samples[:, 200:].reshape(-1, len(z_true))
    below = np.mean(center + draws @ root.T < z_true, axis=0)
    return (below > 0.025) & (below < 0.975)


def holds_or_says(model: str, setting: Setting, data) -> bool:
    """Whether every interval of a fit contains the truth or is reported as open."""
    found = fit(data, model, config=config_of(setting, estimated=False))
    return all(
        not found.least_squares[label].identified
        or found.least_squares[label].ci95[0] <= value <= found.least_squares[label].ci95[1]
        for label, value in truth_of(model, setting).items()
    )


def coverage(
    model, name: str, count: int, *, first=0, rows=400, reach=1.6, estimated=False, posterior=False
):
    """Share of ``count`` data sets, of seeds from ``first`` on, whose intervals hold
    the truth.

    Returns (profile, posterior), each by parameter label.
    """
    setting = SETTINGS[name]
    inside = np.array(
        [
            holds(
                model,
                setting,
                synthetic(model, setting, rows, reach, seed),
                estimated,
                seed,
                posterior,
            )
            for seed in range(first, first + count)
        ]
    )
    labels = list(truth_of(model, setting))
    profile, posterior = inside.mean(axis=0)
    return dict(zip(labels, profile, strict=True)), dict(zip(labels, posterior, strict=True))


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    model, name, count = sys.argv[1], sys.argv[2], int(sys.argv[3])
    print(
        model,
        name,
        *coverage(model, name, count, estimated="est" in sys.argv, posterior="post" in sys.argv),
    )
