"""Brake controllers by name: one visible dict."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from tirefit.online.abs import ConventionalABS
from tirefit.online.controller import AbstractController, NoController
from tirefit.online.slip_control import SlipControl
from tirefit.online.xbs_servo import XbsServo
from tirefit.params import check_names, specs
from tirefit.results import InputProblem, UsageError

__all__ = ["CONTROLLERS", "controller_of", "controllers_named", "tuned"]

CONTROLLERS: dict[str, type[AbstractController]] = {
    each.name: each for each in (XbsServo, ConventionalABS, SlipControl, NoController)
}
"""Controller name -> its record."""


def controllers_named(names: str | Sequence[str]) -> tuple[str, ...]:
    """Names of controllers, given as one text with commas or one by one.

    Raises:
        UsageError: no name, a name twice, or one that is not known.
    """
    return check_names("controller", names, CONTROLLERS)


def tuned(
    settings: Mapping[str, float], names: Sequence[str]
) -> dict[str, dict[str, float]]:
    """``{"abs.slip": 0.1, "rise": 4e7}`` -> settings of each controller.

    A name without a controller goes to all that have it.

    Raises:
        UsageError: a controller that is not asked for, a name that none has, or a value
            outside its bounds; all of them.
    """
    chosen: dict[str, dict[str, float]] = {name: {} for name in names}
    problems = []
    known = {name: specs(CONTROLLERS[name]()) for name in names}
    for key, value in settings.items():
        owner, dot, setting = key.rpartition(".")
        takers = [owner] if dot else list(names)
        takers = [n for n in takers if setting in known.get(n, {})]
        if not takers:
            reason = f"setting {key!r}: none of {', '.join(names)} has it"
            listed = "; ".join(f"{n}: {', '.join(known[n]) or 'none'}" for n in names)
            problems.append(InputProblem(reason, f"settings of {listed}"))
        for name in takers:
            spec = known[name][setting]
            if not spec.lower <= value <= spec.upper:
                low, high = spec.bounds
                reason = f"{name}.{setting} = {value:g} is out of range"
                remedy = f"{spec.meaning}: {low:g} to {high:g} {spec.unit}"
                problems.append(InputProblem(reason, remedy))
            chosen[name][setting] = value
    if problems:
        raise UsageError(problems)
    return chosen


def controller_of(
    name: str, car: Mapping[str, Any], settings: Mapping[str, float] | None = None
) -> AbstractController:
    """The record of a controller, ready to run: its leaves are arrays.

    Args:
        name: a key of :data:`CONTROLLERS`.
        car: what it may know of the car, by the names of its fields: scalars or (w,).
        settings: values of its own fields, which win.

    Raises:
        UsageError: the settings break a condition of the controller.
    """
    template = CONTROLLERS[name]()
    fields = set(vars(template))
    values = {key: value for key, value in car.items() if key in fields}
    try:
        made = dataclasses.replace(template, **values | dict(settings or {}))
    except ValueError as error:
        remedy = f"choose other settings of {name}"
        raise UsageError(InputProblem(str(error), remedy)) from None
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), made)
