"""Arguments of a diagnosis as Python gives them: one of a kind stands for a list of it.
All raise UsageError for what cannot be meant."""

from collections.abc import Iterable
from os import PathLike
from typing import Any

import numpy as np

from tirefit.diagnosis.effects import Effect
from tirefit.diagnosis.rows.rig import Rig, load_rig
from tirefit.results import UsageError


def _wrong(reason: str, remedy: str) -> UsageError:
    return UsageError(reason, remedy)


def names(given: Any, argument: str) -> tuple[str, ...]:
    """Names; a single one is no sequence of letters."""
    several = (given,) if isinstance(given, str) else given
    if isinstance(several, Iterable):
        several = tuple(several)
        if all(isinstance(one, str) for one in several):
            return several
    raise _wrong(f"{argument} = {given!r}", "give a name, or several")


def the_effects(given: Any) -> tuple[Effect, ...]:
    """Effects to look for, at least one."""
    several = tuple(given) if isinstance(given, Iterable) else ()
    if several and all(isinstance(one, Effect) for one in several):
        return several
    reason = f"effects = {given!r}" if several else "effects: none to look for"
    remedy = "leave the argument out for all of the library, or give Effect records: "
    remedy += "(*EFFECTS, mine) adds one, without=... leaves single ones out"
    raise _wrong(reason, remedy)


def a_model(given: Any) -> str | None:
    """Name of a model, or none."""
    if given is None or isinstance(given, str):
        return given
    remedy = "give a model's name; a tire model with its values is a simulator: sim=..."
    raise _wrong(f"model is of type {type(given).__name__}", remedy)


def several(given: Any) -> list:
    """Data of each of several, of one, or of none."""
    every = given if isinstance(given, list | tuple) else [given]
    return [one for one in every if one is not None]


def a_rig(given: Any) -> Rig:
    """What is known of the rig: nothing, a record of it, or a file ``rig.toml``."""
    if given is None or isinstance(given, Rig):
        return given or Rig()
    if isinstance(given, str | PathLike):
        return load_rig(str(given))
    remedy = "give a Rig(...), or the path of a rig.toml"
    raise _wrong(f"rig is of type {type(given).__name__}", remedy)


def a_seed(given: Any) -> int:
    """A seed of everything random."""
    if isinstance(given, int | np.integer) and 0 <= given < 2**32:
        return int(given)
    raise _wrong(f"seed = {given!r}", "give a whole number from 0 to 2^32 - 1")
