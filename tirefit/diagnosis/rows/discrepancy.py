"""The unlisted effect of rows of forces: a parameter of the tire, its slip or its force as a
function of one covariate. It represents any gap while the noise is estimated, too."""

from typing import TYPE_CHECKING

import numpy as np

from tirefit.data.rig.levels import levels
from tirefit.diagnosis.effects.state import State
from tirefit.diagnosis.engine import FLAT
from tirefit.diagnosis.engine.discrepancy import Cell, Discrepancy, Wave, places_of
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.diagnosis.rows.slips import segments

if TYPE_CHECKING:
    from tirefit.diagnosis.rows.subject import Base

FULL_SLIDING = 3.0
"""Slip over that of full sliding above which the force no longer depends on it."""

PARAMETERS = {
    "stiffness": ("stiffness", 0.06),
    "friction": ("friction", 0.03),
    "slip": ("shift", 0.002),
    "force": ("force", 0.01),
}
"""Field of each parameter; usual change (relative, a slip, or force over load)."""

PLACE = {name: k for k, name in enumerate(State._fields)}
"""Column of each field of the state in :class:`rows.forces.Linear`."""


def travelled(prepared: Prepared) -> np.ndarray:
    """Distance since the start of each unbroken stretch [m]: (n,)."""
    way = np.zeros(prepared.n)
    if prepared.time is None:
        return way
    for rows in segments(prepared.time, prepared.run):
        pace = np.abs(prepared.covariates.v[rows])
        steps = 0.5 * (pace[1:] + pace[:-1]) * np.diff(prepared.time[rows])
        way[rows[1:]] = np.cumsum(steps)
    return way


def quantities(prepared: Prepared, slip_fraction: np.ndarray) -> dict[str, np.ndarray]:
    """Covariates that vary: (n,) each. ``slip_fraction`` is signed."""
    has, rows = prepared.has, prepared.covariates
    signed = np.clip(slip_fraction, -FULL_SLIDING, FULL_SLIDING)
    values = {"slip_fraction": np.abs(signed)}
    if "signs" in has:
        values["slip"] = signed
    if "loads" in has:
        values["fz"] = np.asarray(prepared.inputs.fz)
    if "speeds" in has:
        values["v"] = rows.v
    if "time" in has:
        values["time"] = prepared.time
    if "time" in has and "speeds" in has:  # at constant speed, distance is time
        values["distance"] = travelled(prepared)
    if "sweeps" in has:
        values["direction"] = np.sign(rows.turning)
    named = ("temperature", "gamma", "pressure")
    return values | {name: prepared.column(name) for name in named if name in has}


def is_mirrored(parameter: str, covariate: str) -> bool:
    """Whether the change has the sign of the slip."""
    return covariate == "slip_fraction" and parameter in ("force", "slip")


def discrepancy_of(base: "Base") -> Discrepancy:
    """The cells of every parameter with every covariate that varies."""
    rows, fields = base.rows, np.asarray(base.at_null.fields)
    channels, load = len(rows.channels), np.asarray(rows.inputs.fz)
    side = np.where(base.slip_fraction < 0, -1.0, 1.0)
    weights = {}
    for name, (field, usual) in PARAMETERS.items():
        weight = usual * fields[:, PLACE[field]]
        weights[name] = weight * np.tile(load, channels) if field == "force" else weight
    columns: list[np.ndarray] = [np.zeros((len(fields), 0))]
    cells, first = [], 0
    # Numbers of places at which a function has its values: 20 or 28, 12 for what a rig sets.
    counts = {"slip_fraction": 20, "slip": 28, "time": 28, "distance": 28}
    varying = quantities(rows, base.slip_fraction)
    for covariate, values in varying.items():
        settings, count = levels(np.asarray(values)), counts.get(covariate, 12)
        few = covariate not in counts and settings.few()  # each setting with a value of its own
        centers = settings.center if few else None
        shapes, places = places_of(np.asarray(values, float), centers, count)
        for parameter, weight in weights.items():
            signed = shapes * side[:, None] if is_mirrored(parameter, covariate) else shapes
            columns.append(weight[:, None] * np.tile(signed, (channels, 1)))
            cells.append(Cell(parameter, covariate, first, first + len(places), places, few))
            first += len(places)
    waves = _waves(rows, varying, weights)
    return Discrepancy(np.concatenate(columns, axis=1), tuple(cells), waves)


def _waves(
    rows: Prepared, varying: dict[str, np.ndarray], weights: dict[str, np.ndarray]
) -> tuple[Wave, ...]:
    """Waves of the force over the slip; of friction and force over time, and over distance where
    the speed varies: of mains hum, chatter or an uneven road, and of the turning wheel."""
    # The place of each row in even steps: 96 of the slip, whose shortest wave has two.
    steps = {"signed_slip": (rows.slip, max(float(np.ptp(rows.slip)), FLAT) / 96)}
    for name in ("time", "distance") if not rows.random_order else ():
        if name in varying:
            moments = np.unique(varying[name])
            tick = float(np.median(np.diff(moments))) if len(moments) > 1 else 1.0
            # A record of more than four median steps for each row is not sampled evenly.
            if np.ptp(moments) < 4 * len(rows.slip) * tick:
                steps[name] = varying[name], tick
    waves = []
    for covariate, (values, tick) in steps.items():
        clock = np.tile(np.rint((values - values.min()) / tick).astype(int), len(rows.channels))
        of = ("force",) if covariate == "signed_slip" else ("friction", "force")
        waves += [Wave(name, covariate, weights[name], clock, tick) for name in of]
    return tuple(waves)
