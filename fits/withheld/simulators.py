"""Trials with a simulator: a plain brush with wrong parameters.

Each parameter is off by 5 to 25 % of the true one, independently up or down. The
simulated forces have no noise and use the slip as logged. The label holds what a
diagnosis should find: the true parameters, and the budget of the error.
"""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from fits.withheld.effects import EFFECTS
from fits.withheld.library import Inputs, base_fit
from fits.withheld.measure import NOISE, logged_slip
from fits.withheld.patch import World, forces, plain_brush

__all__ = ["at_other_values", "true_budget", "with_simulator"]

LEAST, MOST = 0.05, 0.25  # of a parameter
TRIED = 14  # evaluations to find the factor of the effects alone


def at_other_values(plain: World, changes: list[tuple]) -> Callable:
    """(c, mu, factor) -> the world with these parameters and the changes times factor.

    Args:
        plain: before any change.
        changes: (form, amplitude, generator as it was when the form was applied).
    """

    def again(c: float, mu: float, factor: float) -> World:
        world, ones = deepcopy(plain), np.ones(len(plain.slip))
        world.c, world.mu = c, mu
        world.stiffness, world.mu_s, world.mu_k = c * ones, mu * ones, mu * ones
        for form, amplitude, generator in changes:
            form(world, factor * amplitude, deepcopy(generator))
        return world

    return again


def with_simulator(trial, draw):
    """The trial (of ``trials.py``) with the forces of a simulator in its file."""
    label, columns, g = trial.label, dict(trial.columns), draw.generator
    c, mu = (label[name] * (1 + g.choice([-1, 1]) * g.uniform(LEAST, MOST)) for name in ("c", "mu"))
    force = label["force"]
    slip = columns["sigma_x"] if force == "fx" else np.tan(columns["alpha"])
    along, moment = plain_brush(slip, columns["fz"], c, mu)
    columns[f"{force}_sim"] = along
    if "mz" in columns:
        columns["mz_sim"] = moment
    label = label | {
        "set": "simulators",
        "of": label["set"],
        "parameters": _parameters(label, float(c), float(mu)),
        "budget": true_budget(trial, slip, along, float(c), float(mu)),
    }
    return replace(trial, columns=columns, label=label)


def _parameters(label: dict, c: float, mu: float) -> dict:
    """Simulated and true value of each, and whether the true one can be scored.

    If an effect scales a parameter by a covariate, the true value depends on the chosen
    reference (a load, a time, a temperature); with an unlisted effect it is not
    defined. Neither is scored.
    """
    known = label["set"] in ("singles", "null")
    scales = [family.split(" x ")[0] for family in label["families"]]
    if "force x load" in label["families"]:  # a share of the load is friction, too
        scales.append("friction")
    return {
        "cpa2": {"simulated": c, "true": label["c"], "scored": known and "stiffness" not in scales},
        "mu": {"simulated": mu, "true": label["mu"], "scored": known and "friction" not in scales},
    }


def true_budget(trial, slip, simulated, c: float, mu: float) -> dict[str, float]:
    """Shares of the energy of (measured - simulated force), first channel; they sum to one.

    Parameters and effects are refitted to the noise-free force, alone and together; the
    share of each is the mean of its closures as first and as second (Shapley). Together
    they close all, except with an unlisted effect: the remainder is then "unexplained".

    Args:
        trial: as measured.
        slip, simulated: of the simulator (n,).
        c, mu: its parameters.
    """
    label, force = trial.label, trial.label["force"]
    truth, fz, n = trial.truth[force], trial.columns["fz"], len(slip)
    slip_std, share, moment = NOISE[label["noise"]]
    x = Inputs(
        trial.columns["time"],
        np.zeros(n, int),
        slip,
        fz,
        trial.columns["v"],
        force,
        (slip_std, share * fz, moment * fz),
        moment="mz" in trial.truth,
    )
    whole = [truth, *([trial.truth["mz"]] if x.moment else [])]
    _, misses, std = base_fit(x, np.concatenate(whole), label["c"], label["mu"])
    nothing = float(np.mean((truth - simulated) ** 2))
    tuned = float(np.mean((misses * std)[:n] ** 2))
    noise = float(np.mean((trial.columns[force] - truth) ** 2))
    parts = {"parameters": nothing - tuned, "effects": 0.0, "unexplained": tuned}
    if label["effects"]:
        alone = min(nothing, _by_effects_alone(trial, x, std[:n], c, mu))
        parts["parameters"] = max((nothing - tuned + alone) / 2, 0.0)
        parts["effects"] = max((nothing - alone + tuned) / 2, 0.0)
        parts["unexplained"] = 0.0
    parts["noise"] = noise
    total = sum(parts.values())
    return {name: round(value / total, 5) for name, value in parts.items()}


def _by_effects_alone(trial, x: Inputs, std, c: float, mu: float) -> float:
    """Least mean square [N^2] over a common factor of the effects, at fixed c and mu."""
    truth = trial.truth[x.force]

    def left(factor: float) -> np.ndarray:
        world = trial.again(c, mu, factor)
        moved = plain_brush(x.slip, x.fz, c, mu)[0]
        moved = moved - plain_brush(logged_slip(world), x.fz, c, mu)[0]
        return np.nan_to_num(truth - forces(world)[x.force] - moved, nan=1e9)

    either = all(EFFECTS[effect].sign == 0 for effect in trial.label["effects"])
    found = minimize_scalar(
        lambda factor: np.mean((left(factor) / std) ** 2),
        method="bounded",
        bounds=(-2 if either else 0.02, 3),
        options={"maxiter": TRIED},
    )
    return float(np.mean(left(found.x) ** 2))
