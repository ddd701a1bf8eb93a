"""Arguments of a diagnosis as Python gives them: one of a kind stands for a list of it,
and what cannot be meant is said."""

from collections.abc import Iterable
from os import PathLike
from typing import Any

import numpy as np

from tirefit.data.accept import as_data
from tirefit.data.table import TireData
from tirefit.diagnosis.effects import Effect
from tirefit.diagnosis.rows.rig import Rig, load_rig
from tirefit.results import InputProblem, UsageError

_SEEDS = 2**32


def names(given: Any, argument: str) -> tuple[str, ...]:
    """Names; a single one is no sequence of letters.

    Raises:
        UsageError: something else; names the argument.
    """
    several = (given,) if isinstance(given, str) else given
    if isinstance(several, Iterable):
        several = tuple(several)
        if all(isinstance(one, str) for one in several):
            return several
    raise UsageError(InputProblem(f"{argument} = {given!r}", "give a name, or several"))


def the_effects(given: Any) -> tuple[Effect, ...]:
    """Effects to look for.

    Raises:
        UsageError: none, or something that is no effect.
    """
    several = tuple(given) if isinstance(given, Iterable) else ()
    if several and all(isinstance(one, Effect) for one in several):
        return several
    reason = f"effects = {given!r}" if several else "effects: none to look for"
    remedy = "leave the argument out for all of the library, or give Effect records: "
    remedy += "(*EFFECTS, mine) adds one, without=... leaves single ones out"
    raise UsageError(InputProblem(reason, remedy))


def a_model(given: Any) -> str | None:
    """Name of a model, or none.

    Raises:
        UsageError: neither.
    """
    if given is None or isinstance(given, str):
        return given
    reason = f"model is of type {type(given).__name__}"
    remedy = "give a model's name; a tire model with its values is a simulator: sim=..."
    raise UsageError(InputProblem(reason, remedy))


def tables(given: Any, otherwise: tuple[str, str] | None = None) -> list[TireData]:
    """Data of each of several; of one, where it is no list or tuple; none of None.
    ``otherwise`` is that of ``tirefit.read``.

    Raises:
        UsageError, DataError: as :func:`tirefit.data.accept.as_data`.
    """
    if given is None:
        return []
    several = given if isinstance(given, list | tuple) else [given]
    return [as_data(one, otherwise=otherwise) for one in several]


def a_rig(given: Any) -> Rig:
    """What is known of the rig: nothing, a record of it, or a file ``rig.toml``.

    Raises:
        UsageError: none of these, or a file that says something else.
    """
    if given is None or isinstance(given, Rig):
        return given or Rig()
    if isinstance(given, str | PathLike):
        return load_rig(str(given))
    reason = f"rig is of type {type(given).__name__}"
    raise UsageError(InputProblem(reason, "give a Rig(...), or the path of a rig.toml"))


def a_seed(given: Any) -> int:
    """A seed of everything random.

    Raises:
        UsageError: no whole number from 0 to 2^32 - 1.
    """
    if isinstance(given, int | np.integer) and 0 <= given < _SEEDS:
        return int(given)
    reason = f"seed = {given!r}"
    raise UsageError(InputProblem(reason, "give a whole number from 0 to 2^32 - 1"))
