"""Brake controllers by name in one visible dict."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from tirefit.online.braking.abs import ConventionalABS
from tirefit.online.braking.controller import AbstractController, NoController
from tirefit.online.braking.xbs_servo import XbsServo
from tirefit.results import UsageError

CONTROLLERS: dict[str, type[AbstractController]] = {
    kind.name: kind for kind in (XbsServo, ConventionalABS, NoController)
}
"""Controller name -> its record."""


def controller_of(
    kind: str | type[AbstractController],
    car: Mapping[str, Any],
    settings: Mapping[str, float] | None = None,
) -> AbstractController:
    """The record of a controller, ready to run: its leaves are arrays.

    Args:
        kind: a key of :data:`CONTROLLERS`, or a controller of your own.
        car: what it may know of the car, by the names of its fields: scalars or (w,).
        settings: values of its own fields, which win.

    Raises:
        UsageError: the settings break a condition of the controller.
    """
    kind = CONTROLLERS[kind] if isinstance(kind, str) else kind
    template = kind()
    fields = set(vars(template))
    values = {key: value for key, value in car.items() if key in fields}
    try:
        made = dataclasses.replace(template, **values | dict(settings or {}))
    except ValueError as error:
        raise UsageError(str(error), f"choose other settings of {kind.name}") from None
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), made)
