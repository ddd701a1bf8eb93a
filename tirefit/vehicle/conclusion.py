"""What the errors of a replay say of the tires, of effects and of the steering:
:func:`conclusions`."""

import numpy as np

from tirefit.diagnosis.engine.left_out import jackknife_error
from tirefit.vehicle.errors import QUANTITIES
from tirefit.vehicle.replay import Replay

AHEAD = 0.5
"""Horizon [s] at which models are compared; the nearest one is used."""

_AS_WELL = 1.05
"""Ratio of two rms errors up to which one model predicts as well as the other."""

_ABOVE = 2.0
"""Rms error over that of the noise from which models can be compared."""

_OFF, _SURE = 0.05, 3.0
"""Smallest error of the turning that is told, and its standard errors."""

_BLOCKS = 8
"""Number of parts of the starts; their spread gives the error of a ratio."""

_FEWEST = 16
"""Smallest number of starts for that, and for a horizon at which models are compared."""


def place_of(result: Replay) -> int:
    """Number of the horizon at which models are compared."""
    reached = result.horizons[: sum(count > 0 for count in result.windows)]
    return int(np.argmin([abs(h - AHEAD) for h in reached]))


def turning(result: Replay) -> tuple[float, float] | None:
    """Measured over predicted yaw rate, by least squares over all starts, with its standard
    error between parts of the starts; None with few starts or hardly any turning."""
    horizon, pairs = result.horizons[place_of(result)], []
    for fan in result.fans.values():
        step = round(horizon / float(fan.time[0, 1] - fan.time[0, 0]))
        pairs.append([of["yaw_rate"][:, step] for of in (fan.measured, fan.predicted)])
    true, predicted = (np.concatenate(part) for part in zip(*pairs, strict=True))
    there = np.isfinite(true) & np.isfinite(predicted)
    if there.sum() < _FEWEST or not np.any(predicted[there]):
        return None
    parts = np.array_split(np.flatnonzero(there), _BLOCKS)
    products = np.array([(true[p] @ predicted[p], predicted[p] @ predicted[p]) for p in parts])
    whole, left = products.sum(axis=0), products.sum(axis=0) - products
    return float(whole[0] / whole[1]), float(jackknife_error(left[:, 0] / left[:, 1]))


_NAMES = {"yaw_rate": "yaw rate", "lateral": "lateral position"}


def _worse(result: Replay, model: str, other: str) -> str:
    """Where a model predicts worse than another one by the largest ratio, such as ``the yaw rate
    after 5 s by 23 rad/s instead of 0.57``; empty if it is nowhere worse."""
    found, most = "", _AS_WELL
    own, than = (result.models[k].rms() for k in (model, other))
    for name, words in _NAMES.items():
        for horizon, count, wrong, less in zip(
            result.horizons, result.windows, own[name], than[name], strict=True
        ):
            if count >= _FEWEST and wrong and less and wrong > most * less:
                most = wrong / less
                found = f"the {words} after {horizon:g} s by {wrong:.2g} {QUANTITIES[name]}"
                found += f" instead of {less:.2g}"
    return found


def conclusions(result: Replay) -> list[str]:
    """Sentences on what predicts better, and on what limits the prediction; empty where nothing
    can be said."""
    said = []
    if worse := _worse(result, "tire", "linear tire"):
        said.append(f"The tires predict worse than linear tires: they miss {worse}.")
    if "with the effects" in result.models:
        if worse := _worse(result, "with the effects", "tire"):
            said.append(f"The effects make the prediction worse: with them it misses {worse}.")
    return [*said, *_limits(result)]


def _limits(result: Replay) -> list[str]:
    """Sentences on what limits the prediction at one horizon."""
    place = place_of(result)
    rms = {k: errors.rms()["yaw_rate"][place] or 0.0 for k, errors in result.models.items()}
    if rms["tire"] < _ABOVE * rms["floor"]:
        return []
    said = []
    if rms["no slip"] <= _AS_WELL * rms["tire"]:
        said.append("The tires are not what limits: a car without slip predicts as well.")
    elif rms["linear tire"] <= _AS_WELL * rms["tire"]:
        said.append("The tires' bend is not what limits: linear tires predict as well.")
    ratio = turning(result)
    if ratio is not None and abs(ratio[0] - 1) > max(_OFF, _SURE * ratio[1]):
        text = f"The car turns {ratio[0]:.2f} ± {ratio[1]:.2f} times as much as predicted:"
        text += " `tirefit diagnose --vehicle` tells steering, masses and tires apart."
        said.append(text)
    return said
