"""Parameters as fields: each carries its unit, bounds, default, meaning and source.

The same metadata feeds the solver (bounds as a bijection), the prior, the tables and
the report. A model is an ``equinox.Module``; a parameter is a field made by
:func:`par`, in the model itself or in one of its parts (a pressure or friction law).
"""

import dataclasses
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import ModuleType
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from tirefit.arrays import Kept, Numbers
from tirefit.results import InputProblem, UsageError, did_you_mean

Model = TypeVar("Model", bound=eqx.Module)

Values = Array | np.ndarray
"""Arrays that programs take and return: NumPy on the host, JAX inside a program."""


class Spec(NamedTuple):
    """The definition of a parameter."""

    default: float
    lower: float
    upper: float
    unit: str
    meaning: str
    source: str
    symbol: str
    free: bool
    scale: str

    @property
    def bounds(self) -> tuple[float, float]:
        return self.lower, self.upper


def par(
    default: float,
    bounds: tuple[float, float],
    unit: str,
    meaning: str,
    source: str = "",
    symbol: str = "",
    *,
    free: bool = True,
    scale: str = "linear",
) -> Any:
    """A parameter field of a model.

    Args:
        default: value used if none is given.
        bounds: smallest and largest allowed value; a fit stays strictly inside.
        unit: SI unit, ``-`` for none.
        meaning: one line for tables and reports.
        source: the equation that defines it, for the table of models.
        symbol: TeX symbol for figures of fits; settings of online methods need neither.
        free: whether a fit estimates it by default.
        scale: ``linear``, or ``log`` for a positive scale over many decades.

    Raises:
        ValueError: the bounds are empty or do not hold the default.
    """
    lower, upper = bounds
    if not lower <= default <= upper or lower == upper:
        raise ValueError(f"default {default} outside the bounds [{lower}, {upper}]")
    spec = Spec(default, lower, upper, unit, meaning, source, symbol, free, scale)
    return eqx.field(default=default, metadata={"spec": spec})


def _parameters(model: eqx.Module) -> Iterator[tuple[dataclasses.Field[Any], Any]]:
    """(field, value) of each parameter, in the order of the fields, parts included."""
    for field in dataclasses.fields(model):
        value = getattr(model, field.name)
        if "spec" in field.metadata:
            yield field, value
        for part in value if isinstance(value, tuple) else (value,):
            if isinstance(part, eqx.Module):
                yield from _parameters(part)


def specs(model: eqx.Module) -> dict[str, Spec]:
    """Parameter name -> :class:`Spec`, in the order of the fields, parts included."""
    return {field.name: field.metadata["spec"] for field, _ in _parameters(model)}


def parameter_values(model: eqx.Module) -> dict[str, float]:
    """Return the values of a model's parameters.

    Args:
        model: a tire model or another record with parameters.

    Returns:
        Name -> value in SI units, in the order of the fields.

    Example:
        >>> parameter_values(MODELS["brush"])
        {'cpa2': 50000.0, 'mu': 1.0, 'half_length': 0.1}
    """
    return {field.name: value for field, value in _parameters(model)}


def check_values(
    model: eqx.Module, owner: str, values: Mapping[str, float], *, noun: str = "parameter"
) -> None:
    """Check that values given by the user are fields of a model and within bounds.

    Args:
        owner: name of the model in messages.
        noun: name of its fields in messages.

    Raises:
        UsageError: unknown names or values out of bounds; it lists all of them.
    """
    known, problems = specs(model), []
    for key, value in values.items():
        if key not in known:
            reason = f"{owner} has no {noun} {key!r}"
            problems.append(InputProblem(reason, f"it has {', '.join(known)}"))
        else:
            problems += _out_of_bounds(key, value, known[key])
    UsageError.raise_for(problems)


def _out_of_bounds(key: str, value: float, spec: Spec) -> list[InputProblem]:
    """A problem if the value is outside the bounds of its parameter, else empty."""
    low, high = spec.bounds
    if low <= value <= high:
        return []
    reason = f"{key} = {value} is outside its bounds [{low:.6g}, {high:.6g}]"
    unit = "" if spec.unit == "-" else f" {spec.unit}"
    return [InputProblem(reason, f"{spec.meaning}: {low:.6g} to {high:.6g}{unit}")]


def check_names(noun: str, names: str | Sequence[str], known: Iterable[str]) -> tuple[str, ...]:
    """Split and check names given by the user, as one text with commas or as a list.

    Args:
        noun: what messages call one of them.
        known: all valid names.

    Raises:
        UsageError: no name, repeated or unknown names; it lists all problems.
    """
    listed = names.split(",") if isinstance(names, str) else list(names)
    asked = [name.strip() for name in listed if name.strip()]
    there, problems = list(known), []
    all_known = ", ".join(there)
    if not asked:
        problems.append(InputProblem(f"no {noun} given", f"choose one of {all_known}"))
    for name in dict.fromkeys(asked):
        if asked.count(name) > 1:
            problems.append(InputProblem(f"{noun} {name!r} is given twice", "give it once"))
        if name not in there:
            remedy = f"{did_you_mean(name, there)}known: {all_known}"
            problems.append(InputProblem(f"there is no {noun} {name!r}", remedy))
    UsageError.raise_for(problems)
    return tuple(asked)


def by_owner(
    settings: Mapping[str, float], owners: Mapping[str, eqx.Module]
) -> dict[str, dict[str, float]]:
    """Split ``{"rls.d": 0.1, "mu": 0.9}`` into the settings of each owner.

    A setting without the name of an owner applies to all owners that have it.

    Raises:
        UsageError: owners that were not chosen, settings that no owner has, or values
            out of bounds; it lists all of them.
    """
    chosen: dict[str, dict[str, float]] = {name: {} for name in owners}
    known = {name: specs(owner) for name, owner in owners.items()}
    problems, asked = [], ", ".join(owners)
    for key, value in settings.items():
        owner, dot, setting = key.rpartition(".")
        if dot and owner not in known:
            reason = f"setting {key!r}: {owner!r} is not chosen"
            problems.append(InputProblem(reason, f"chosen: {asked}"))
            continue
        takers = [n for n in ([owner] if dot else known) if setting in known[n]]
        if not takers:
            reason = f"setting {key!r}: none of {asked} has it"
            if dot:
                reason = f"{owner!r} has no setting {setting!r}"
            listed = "; ".join(f"{n}: {', '.join(known[n]) or 'none'}" for n in known)
            problems.append(InputProblem(reason, f"settings of {listed}"))
        for name in takers:
            problems += _out_of_bounds(f"{name}.{setting}", value, known[name][setting])
            chosen[name][setting] = value
    UsageError.raise_for(problems)
    return chosen


def with_values(model: Model, values: Mapping[str, Numbers]) -> Model:
    """Return the same model with other parameter values.

    Args:
        model: a tire model or another record with parameters.
        values: name -> value in SI units; the others are kept.

    Returns:
        A new model.

    Raises:
        KeyError: a name that the model does not have.

    Example:
        >>> tire = with_values(MODELS["brush"], {"mu": 0.7})
        >>> parameter_values(tire)["mu"]
        0.7
    """
    unknown = set(values) - set(specs(model))
    if unknown:
        raise KeyError(f"{type(model).__name__} has no parameter {sorted(unknown)}")
    return _replace(model, values)


def _replace(model: Model, values: Mapping[str, Any]) -> Model:
    changes = {}
    for field in dataclasses.fields(model):
        value = getattr(model, field.name)
        if "spec" in field.metadata and field.name in values:
            changes[field.name] = values[field.name]
        elif isinstance(value, eqx.Module):
            changes[field.name] = _replace(value, values)
        elif isinstance(value, tuple) and any(isinstance(part, eqx.Module) for part in value):
            changes[field.name] = tuple(_replace(part, values) for part in value)
    return dataclasses.replace(model, **changes)


def _interval(spec: Spec) -> tuple[float, float]:
    if spec.scale == "log":
        return math.log(spec.lower), math.log(spec.upper)
    return spec.bounds


def _library(value: Numbers) -> ModuleType:
    """``jax.numpy`` inside a trace and for JAX arrays; NumPy on the host, where JAX would
    compile each operation by itself."""
    return jnp if isinstance(value, jax.Array) else np


def constrain(z: Kept, spec: Spec) -> Kept:
    """Map the real line to the open interval of the bounds, elementwise (any shape).

    It is a sigmoid over the interval, or over its logarithms on a ``log`` scale.
    """
    library = _library(z)
    lower, upper = _interval(spec)
    # tanh, not 1 / (1 + exp(-z)), which overflows or loses its slope.
    x = lower + (upper - lower) * (0.5 + 0.5 * library.tanh(0.5 * z))
    return library.exp(x) if spec.scale == "log" else x


def unconstrain(x: Kept, spec: Spec) -> Kept:
    """Inverse of :func:`constrain`; a value at a bound is moved just inside it."""
    library = _library(x)
    lower, upper = _interval(spec)
    x = library.log(x) if spec.scale == "log" else library.asarray(x, float)
    unit = library.clip((x - lower) / (upper - lower), 1e-9, 1 - 1e-9)
    return library.log(unit) - library.log1p(-unit)


def log_jacobian(z: Kept, spec: Spec) -> Kept:
    """log |dx/dz| of :func:`constrain` (any shape)."""
    library = _library(z)
    lower, upper = _interval(spec)
    # log of sigmoid(z) sigmoid(-z), stable in both tails.
    size = library.abs(z)
    log_slope = -size - 2 * library.log1p(library.exp(-size))
    log_slope = log_slope + math.log(upper - lower)
    if spec.scale == "log":
        return log_slope + library.log(constrain(z, spec))
    return log_slope
