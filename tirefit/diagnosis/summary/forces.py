"""Forces of several tires over their common range of slip and load, with bands."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtri

from tirefit.data.tir.tir_keys import LIMITS
from tirefit.fitting.mf.parts import SLIPS_OF
from tirefit.fitting.source import GivenTire
from tirefit.fitting.tir import TIR_SIGNS
from tirefit.models import AbstractTire, TireInputs, forces, modelled
from tirefit.models.relaxation import Relaxed
from tirefit.slip import CONVENTIONS, sigma_from_kappa

_SLIPS, _DRAWS = 61, 100  # number of slips of a curve, and of draws of its parameters

_Place = tuple[np.ndarray, tuple[float, ...], float]
"""Slips, loads [N] and speed [m/s] at which forces are compared."""

_USUAL_SPEED = 10.0  # speed [m/s] where no source states one

_ONE_LOAD = 1.2
"""Ratio of the ends of the common loads up to which the middle stands for all; two ranges that
are not farther apart are compared between them."""


class ForceCurve(NamedTuple):
    """Forces (loads, slips) of a source, their standard errors, and, unless it is the first
    source, where it differs most from the first in errors (in force if none has errors)."""

    force: np.ndarray
    std: np.ndarray | None
    slip: float | None = None
    load: float | None = None
    difference: float | None = None
    error: float | None = None  # standard error of ``difference``
    differs: bool = False
    rms_share: float | None = None  # rms difference from the first over its largest force


class ForceDifference(NamedTuple):
    """A force at common slips (n,) and loads [N]; ``curves`` by source."""

    force: str
    slip: str
    slips: np.ndarray
    loads: tuple[float, ...]
    speed: float
    curves: Mapping[str, ForceCurve]


def differing_forces(
    tires: Mapping[str, GivenTire], level: float
) -> tuple[tuple[ForceDifference, ...], tuple[str, ...]]:
    """Forces of the tires over the common range, and notes on what cannot be compared.

    A force differs if it does so in errors beyond the band that holds all slips and loads
    together (Scheffe) at ``level``, shared among the forces.
    """
    steady = {name: _steady(given.tire) for name, given in tires.items()}
    if moving := [name for name, tire in steady.items() if tire.transient]:
        return (), tuple(f"{name}: no forces in steady state" for name in moving)
    if len(tires) < 2:
        return (), ()
    each = [given.content.get("forces") or modelled(given.tire) for given in tires.values()]
    names = [x for x in each[0] if x in ("fx", "fy", "mz") and all(x in other for other in each)]
    limits = [_ranges(given) for given in tires.values()]
    speeds = [np.mean(limit["v"]) for limit in limits if "v" in limit]
    speed = float(np.mean(speeds)) if speeds else _USUAL_SPEED
    differences, notes = [], []
    for name in names:
        slip = SLIPS_OF[name][0]
        slips, loads = (_common(limits, key) for key in (slip, "fz"))
        if slips is None or loads is None or slips[0] >= slips[1]:
            what = "slip" if loads is not None else "load"
            notes.append(f"{name} is not compared: the sources have no common range of {what}")
            continue
        low, high = loads
        levels: tuple[float, ...] = ((low + high) / 2,)
        if high > _ONE_LOAD * max(low, 0.0):
            levels = max(low, 0.1 * high), *levels, high
        at = np.linspace(*slips, _SLIPS), levels, speed
        differences.append(_force(name, slip, at, tires, steady, level / len(names)))
    return tuple(differences), tuple(notes)


def _steady(tire: AbstractTire) -> AbstractTire:
    """The tire without relaxation."""
    return tire.tire if isinstance(tire, Relaxed) else tire


def _ranges(given: GivenTire) -> dict[str, tuple[float, float]]:
    """Canonical range of each input that the source states."""
    if given.content:
        return {k: (low, high) for k, (low, high) in given.content["data"]["range"].items()}
    ranges: dict[str, tuple[float, float]] = {}
    numbers, signs = given.tir.numbers if given.tir else {}, CONVENTIONS[TIR_SIGNS]
    for name, (least, most) in LIMITS.items():
        if least in numbers and most in numbers:
            sign = getattr(signs, {"kappa": "slip"}.get(name, name), 1)
            low, high = sorted((sign * numbers[least], sign * numbers[most]))
            ranges[name] = low, high
    if "kappa" in ranges:
        low, high = np.clip(ranges.pop("kappa"), -0.99, 0.99)
        ranges["sigma_x"] = float(sigma_from_kappa(low)), float(sigma_from_kappa(high))
    return ranges


def _common(
    limits: Iterable[Mapping[str, tuple[float, float]]], key: str
) -> tuple[float, float] | None:
    """The common range of an input, of the sources that state one; None if there is none."""
    known = [limit[key] for limit in limits if key in limit]
    if not known:
        return None
    low, high = max(low for low, _ in known), min(high for _, high in known)
    if key == "fz" and high < low <= _ONE_LOAD * high:
        low = high = float(np.sqrt(low * high))
    return (low, high) if low <= high else None


def _force(
    name: str,
    slip: str,
    at: _Place,
    tires: Mapping[str, GivenTire],
    steady: Mapping[str, Any],
    level: float,
) -> ForceDifference:
    slips, loads, speed = at
    curves, free = {}, {}
    for k, (source, given) in enumerate(tires.items()):
        force = _at(steady[source], name, slip, at)
        std = None
        if given.fit is not None:
            drawn = given.drawn(np.random.default_rng(k), _DRAWS)
            std = np.std([_at(_steady(tire), name, slip, at) for tire in drawn], axis=0)
        free[source] = () if given.fit is None else given.fit[0].labels
        curves[source] = ForceCurve(force, std)
    first, *others = curves
    for source in others:
        both = len(free[first]), len(free[source])
        count = both[0] if free[first] == free[source] else sum(both)
        reach = np.sqrt(chdtri(max(count, 1), level / len(others)))
        curves[source] = _differing(curves[first], curves[source], slips, loads, float(reach))
    return ForceDifference(name, slip, slips, loads, speed, curves)


def _at(tire: AbstractTire, name: str, slip: str, at: _Place) -> np.ndarray:
    """The force (loads, slips) of a tire."""
    slips, loads, speed = at
    fz = np.repeat(loads, len(slips))
    at_slip: dict[str, Any] = {slip: np.tile(slips, len(loads))}
    inputs = TireInputs(fz=fz, v=speed, **at_slip)
    return np.asarray(getattr(forces(tire, inputs), name)).reshape(len(loads), len(slips))


def _differing(
    first: ForceCurve, second: ForceCurve, slips: np.ndarray, loads: Sequence[float], reach: float
) -> ForceCurve:
    away = second.force - first.force
    stds = [curve.std for curve in (first, second) if curve.std is not None]
    size, error = np.abs(away), None
    if stds:
        error = np.sqrt(np.sum(np.square(stds), axis=0))
        # A difference below rounding is none, where a band has no width as at zero slip.
        size = size / np.maximum(error, 1e-9 * np.max(np.abs(second.force)))
    row, column = np.unravel_index(int(np.argmax(size)), size.shape)
    return second._replace(
        slip=float(slips[column]),
        load=float(loads[int(row)]),
        difference=float(away[row, column]),
        error=None if error is None else float(error[row, column]),
        differs=error is not None and bool(size[row, column] > reach),
        rms_share=float(np.sqrt(np.mean(away**2)) / np.max(np.abs(first.force))),
    )
