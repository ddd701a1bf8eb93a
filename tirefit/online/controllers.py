"""Brake controllers by name: one visible dict."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from tirefit.online.abs import ConventionalABS
from tirefit.online.controller import AbstractController, NoController
from tirefit.online.slip_control import SlipControl
from tirefit.online.xbs_servo import XbsServo
from tirefit.results import UsageError

CONTROLLERS: dict[str, type[AbstractController]] = {
    each.name: each for each in (XbsServo, ConventionalABS, SlipControl, NoController)
}
"""Controller name -> its record."""


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
        raise UsageError(str(error), f"choose other settings of {name}") from None
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), made)
