"""Check the signs of the data pair by pair, and find the conventions that fit them.

In the canonical signs of :mod:`tirefit.slip`, physics determines how some columns are
related: the force rises with the slip, the aligning moment reduces a small slip angle, a
tire pushes to the side to which it leans, and a brake slows the wheel.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tirefit.data.units import slip_from_sigma
from tirefit.slip import CONVENTIONS, slip_ratio_from_sigma

_SMALL_ANGLE = np.radians(4.0)
"""Slip angle up to which the aligning moment does not change its sign."""

_SMALL_SLIP = 0.03  # largest longitudinal slip of rows that show the effect of alpha

_LEAST_CAMBER = np.radians(1.0)
_LEAST_BRAKING = 0.5  # acceleration [m/s2] above the noise of its sensor


class Evidence(NamedTuple):
    """Two related columns. ``trend`` is 1 if they are related as physics requires in
    canonical signs, -1 if in the opposite way, 0 if the data do not determine it."""

    fields: tuple[str, ...]  # fields of a convention whose signs multiply in the trend
    columns: tuple[str, str]  # the canonical columns
    trend: int
    rule: str  # the relation that must hold, for messages


def trend(x: np.ndarray, y: np.ndarray, least: float) -> int:
    """Sign of a significant straight line through zero; 0 if there is none.

    Significant: correlation above 0.25, t above 5, and some |x| above ``least``.
    """
    energy = np.sum(x * x) * np.sum(y * y)
    if len(x) < 3 or energy == 0 or np.max(abs(x)) < least:
        return 0
    correlation = np.clip(np.sum(x * y) / np.sqrt(energy), -1, 1)
    unexplained = max(1 - correlation**2, 1e-12)
    t = correlation * np.sqrt((len(x) - 1) / unexplained)
    return int(np.sign(correlation)) if abs(t) > 5 and abs(correlation) > 0.25 else 0


def evidence_of(columns: Mapping[str, np.ndarray], definition: str = "kappa") -> list[Evidence]:
    """The evidence of the columns on their signs.

    Args:
        columns: (n,) canonical columns, finite, used rows only.
        definition: of the file's slip column, a key of ``slip.SLIP_DEFINITIONS``.
    """
    return [
        *_of_forces(columns),
        *_of_moment(columns),
        *_of_camber(columns),
        *_of_brakes(columns),
        *_of_slip(columns, definition),
    ]


def _of_forces(columns) -> Iterator[Evidence]:
    for end in ("", "_sim"):
        if {"sigma_x", f"fx{end}"} <= columns.keys():
            slip = slip_ratio_from_sigma(columns["sigma_x"])
            sign = trend(slip, columns[f"fx{end}"], 0.005)
            rule = "the force rises with the slip"
            yield Evidence(("slip", "fx"), ("sigma_x", f"fx{end}"), sign, rule)
        if {"alpha", f"fy{end}"} <= columns.keys():
            sign = trend(columns["alpha"], columns[f"fy{end}"], np.radians(0.5))
            rule = "the side force rises with the slip angle"
            yield Evidence(("alpha", "fy"), ("alpha", f"fy{end}"), sign, rule)


def _of_moment(columns) -> Iterator[Evidence]:
    """Evidence of the aligning moment, in rows of small slip angle and no other slip."""
    if not {"alpha", "mz"} <= columns.keys():
        return
    alpha, moment = columns["alpha"], columns["mz"]
    rows = (abs(alpha) < _SMALL_ANGLE) & _rolls_freely(columns)
    if rows.any():
        alpha, moment = alpha[rows], moment[rows]
        sign = -trend(alpha - alpha.mean(), moment - moment.mean(), np.radians(0.5))
        rule = "the aligning moment reduces a small slip angle"
        yield Evidence(("alpha", "mz"), ("alpha", "mz"), sign, rule)


def _rolls_freely(columns) -> np.ndarray:
    if "sigma_x" not in columns:
        return np.ones(len(next(iter(columns.values()))), bool)
    return abs(columns["sigma_x"]) < _SMALL_SLIP


def _of_camber(columns) -> Iterator[Evidence]:
    """Evidence of camber thrust: the part of F_y / F_z that alpha does not explain."""
    if not {"alpha", "fy", "fz", "gamma"} <= columns.keys():
        return
    rows = (abs(columns["alpha"]) < _SMALL_ANGLE / 2) & _rolls_freely(columns)
    gamma = columns["gamma"][rows]
    if np.count_nonzero(rows) < 10 or np.ptp(gamma) < _LEAST_CAMBER:
        return
    share = columns["fy"][rows] / columns["fz"][rows]
    others = np.stack([np.ones(len(gamma)), columns["alpha"][rows]], axis=1)
    both = np.stack([gamma, share], axis=1)
    left = both - others @ np.linalg.lstsq(others, both)[0]
    sign = trend(left[:, 0], left[:, 1], _LEAST_CAMBER / 4)
    rule = "a tire pushes to the side that it leans to"
    yield Evidence(("gamma", "fy"), ("gamma", "fy"), sign, rule)


def _of_brakes(columns) -> Iterator[Evidence]:
    """Evidence of the brake pressure and of the acceleration of the vehicle."""
    if {"brake_pressure", "fx"} <= columns.keys():
        pressure, force = columns["brake_pressure"], columns["fx"]
        sign = trend(pressure - pressure.mean(), force - force.mean(), 1.0)
        rule = "the braking force rises with the brake pressure"
        yield Evidence(("fx",), ("brake_pressure", "fx"), sign, rule)
    if {"a_x", "fx"} <= columns.keys():
        sign = -trend(columns["a_x"], columns["fx"], _LEAST_BRAKING)
        rule = "a force that brakes slows the vehicle"
        yield Evidence(("fx",), ("a_x", "fx"), sign, rule)


def _of_slip(columns, definition: str) -> Iterator[Evidence]:
    """Evidence of the speeds of wheel and vehicle, and of a locked wheel."""
    if "sigma_x" not in columns:
        return
    rule = "a braked wheel turns slower than a freely rolling one (omega / v)"
    yield Evidence(("slip",), ("omega", "sigma_x"), -turning(columns), rule)
    if definition in ("kappa", "s") and len(columns["sigma_x"]):
        slip = slip_from_sigma(columns["sigma_x"], definition, columns.get("alpha"))
        low, high = np.percentile(slip, [1, 99])
        sign = int(high > 0.98 and low > -0.9) - int(low < -0.98 and high < 0.9)
        rule = "a slip of 1 is that of a wheel locked by its brake"
        yield Evidence(("slip",), ("sigma_x", "sigma_x"), sign, rule)


def turning(columns: Mapping[str, np.ndarray]) -> int:
    """Sign of the trend of omega / v over the slip; 0 if there is none."""
    if not {"omega", "v"} <= columns.keys():
        return 0
    moving = columns["v"] > 0
    if not moving.any():
        return 0
    slip = slip_ratio_from_sigma(columns["sigma_x"][moving])
    wheel = columns["omega"][moving] / columns["v"][moving]
    return trend(slip - slip.mean(), wheel - wheel.mean(), 0.005)


def fitting_conventions(evidence: Sequence[Evidence], convention: str, load: int = 1) -> list[str]:
    """Conventions in which all evidence, and the load, would have the right sign.

    Args:
        evidence: of columns that were read in ``convention``.
        convention: a key of ``slip.CONVENTIONS``.
        load: 1 if the loads read are positive, -1 if they are negative.
    """
    read = CONVENTIONS[convention]
    fitting = []
    for name, other in CONVENTIONS.items():
        turned = {f: getattr(read, f) * getattr(other, f) for f in read._fields[1:]}
        signs = [
            item.trend * int(np.prod([turned[field] for field in item.fields])) for item in evidence
        ]
        if turned["fz"] == load and min(signs, default=1) >= 0:
            fitting.append(name)
    return fitting
