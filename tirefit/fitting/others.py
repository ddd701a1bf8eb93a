"""Fits of other models to the rows of a fit, with its settings."""

from collections.abc import Sequence
from typing import NamedTuple

from tirefit.fitting.config import FitConfig, ParameterConfig
from tirefit.fitting.identified import profile_estimates
from tirefit.fitting.problem import FitTask, build
from tirefit.fitting.profile import profile_all
from tirefit.fitting.result import Estimate
from tirefit.fitting.solve import Solved, solve_problem
from tirefit.models import MODELS, modelled
from tirefit.params import specs
from tirefit.results import DataError, UsageError

_PEAK = ("mu", "mu_peak", "D", "Dx", "Dy")
"""Peak force over load, by the name that it has in a model."""

_SLOPE = ("cpa2", "B", "Bx", "By")
"""Parameters that set the slope at zero slip; their units differ."""


class Other(NamedTuple):
    """Another model, solved on the rows of a fit."""

    name: str
    task: FitTask
    solved: Solved


def solved_as(name: str, task: FitTask, config: FitConfig) -> Other | None:
    """Another model solved on the rows of a task, with the settings that apply to it.

    None if the model lacks a force or an input, or if the settings do not suit it.
    """
    forces = [channel.name for channel in task.problem.channels]
    if not {*forces} <= {*modelled(MODELS[name])}:
        return None
    chosen = {"model": name, "force": forces, "parameters": _parameters(name, config)}
    config = config.model_copy(update=chosen)
    try:
        other = build(task.data, name, config, len(task.problem.rows.weight))
        return Other(name, other, solve_problem(other, config))
    except (DataError, UsageError):
        return None


def _parameters(name: str, config: FitConfig) -> dict[str, ParameterConfig]:
    """Settings of the parameters that the model has, or has under another name."""
    known = specs(MODELS[name])
    settings: dict[str, ParameterConfig] = {}
    for key, one in config.parameters.items():
        names: Sequence[str] = (key,) if key in known else ()
        if key in _PEAK and not names:
            names = [k for k in _PEAK if k in known]
        elif key in _SLOPE and not names and one.per_run:
            names, one = [k for k in _SLOPE if k in known], ParameterConfig(per_run=True)
        if one.tied is None or one.tied in known:
            settings |= dict.fromkeys(names, one)
    return settings


def estimates_of(solved: Solved) -> tuple[list, dict[str, Estimate]]:
    """Profiles and estimates of the parameters of a solved problem."""
    profiles = profile_all(solved.problem, solved.z, solved.covariance, solved.level)
    return profiles, profile_estimates(solved, profiles)[0]
