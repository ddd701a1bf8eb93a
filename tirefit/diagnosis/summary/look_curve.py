"""What is left of a gap as a figure shows it: the change of one quantity of the tire
over one that was measured, in bins, and the shape that it looks like."""

from typing import NamedTuple

import numpy as np

from tirefit.diagnosis.decide.verdict import Verdict
from tirefit.diagnosis.evidence.base import Base
from tirefit.diagnosis.evidence.forms import PLACE
from tirefit.diagnosis.evidence.linear_fit import LinearFit, linear_at
from tirefit.diagnosis.rows.basis import without
from tirefit.diagnosis.rows.patterns import (
    PARAMETERS,
    Look,
    Pattern,
    is_mirrored,
    quantities,
    settings_of,
)

_PERIODS = 6
"""Periods of a wave up to which each is shown; of more, all lie over one another."""

_BINS, _OF_A_PERIOD, _IN_A_BIN = (8, 30), 6, 5
"""Bins, fewest and most; at least so many for a period; rows of one at least."""

_SURE = 0.5
"""Standard error of a bin over the rms of the shape that is wanted, at most."""

_POINTS = 400


class LookCurve(NamedTuple):
    """The local change of the parameter of a :class:`Look` over its covariate.

    ``center``, ``change``, ``std`` (k,) are bins: the covariate, the estimate and its
    standard error; ``x``, ``shape`` (p,) the fitted shape, whose size is that of the
    look: of a wave the amplitude, of a kink what it comes to at the end. Changes are
    shares of stiffness or friction, slips, or forces as shares of the load;
    ``is_mirrored`` says that they count in the direction of the slip. ``is_folded``:
    the covariate is shown within one period, from 0; ``at_settings``: the bins are
    settings of the rig.
    """

    look: Look
    center: np.ndarray
    change: np.ndarray
    std: np.ndarray
    x: np.ndarray
    shape: np.ndarray
    is_mirrored: bool
    is_folded: bool
    at_settings: bool


def shape_of(one: Pattern | Look, values, low: float, span: float) -> np.ndarray:
    """The shape of a pattern at values of its covariate: (n, 1); of a wave sine and
    cosine, (n, 2).

    Args:
        low, span: least value of the covariate in the data, and its range.
    """
    values = np.asarray(values, float)
    if one.shape == "kink":
        columns = [np.maximum(values - one.at, 0.0) / span]
    elif one.shape == "threshold":
        columns = [(values > one.at) - 0.5]
    elif one.shape == "wave":
        angle = 2 * np.pi * (values - low) / one.at
        columns = [np.sin(angle), np.cos(angle)]
    elif one.width:
        columns = [np.exp(-0.5 * ((values - one.at) / one.width) ** 2)]
    else:
        columns = [1.0 * np.isclose(values, one.at)]
    return np.stack(columns, axis=1)


def look_curve(verdict: Verdict, base: Base, look: Look) -> LookCurve:
    """The picture of what a verdict leaves.

    The points are partial residuals (Larsen and McCleary, 1972, Technometrics 14:781):
    what the shape and the base's parameters leave when they are fitted together, with
    the shape put back; else the base would hide the part that it has taken up.
    """
    values = quantities(base.rows, base.slip_fraction)[look.covariate]
    linear = linear_at(base, verdict.chosen)
    return curve_of(look, np.asarray(values, float), _field(base, look), linear)


def curve_of(look: Look, values, field, linear: LinearFit) -> LookCurve:
    """The picture of a look.

    Args:
        values: the covariate (n,).
        field: whitened force of a unit change of the parameter, (channels, n).
        linear: what the fit leaves, and what it has used up.
    """
    low, span = float(values.min()), float(np.ptp(values))
    settings = settings_of(look.covariate, values)
    if settings is not None:
        values = settings.center[settings.code]
    shapes = shape_of(look, values, low, span)
    coefficient, left = _fitted(field, shapes, linear)
    information = np.sum(field**2, axis=0)
    estimate = information * (shapes @ coefficient) + np.sum(field * left, axis=0)

    is_folded = look.shape == "wave" and span > _PERIODS * look.at
    place = np.mod(values - low, look.at) if is_folded else values
    if settings is None:
        periods = span / look.at if look.shape == "wave" and not is_folded else 1
        energy = float(np.sum(information * (shapes @ coefficient) ** 2))
        codes = _bins(place, information, _bin_count(energy, periods, len(values)))
        x = _grid(look, 0.0 if is_folded else low, look.at if is_folded else span)
    else:
        codes, x = settings.code, settings.center
    total = np.bincount(codes, information)
    there = total > 0
    center, change = (
        np.bincount(codes, part)[there] / total[there]
        for part in (information * place, estimate)
    )
    curve = shape_of(look, x, 0.0 if is_folded else low, span) @ coefficient
    sizes = {"wave": np.linalg.norm(coefficient), "kink": curve[-1]}
    whole = float(sizes.get(look.shape, coefficient[0]))
    return LookCurve(
        look._replace(size=whole), center, change, 1 / np.sqrt(total[there]), x, curve,
        is_mirrored(look.parameter, look.covariate), is_folded, settings is not None,
    )  # fmt: skip


def _field(base: Base, look: Look) -> np.ndarray:
    """Whitened force of a unit change of the parameter, (channels, n)."""
    name, _ = PARAMETERS[look.parameter]
    field = np.asarray(base.at_null.fields)[:, PLACE[name]].reshape(-1, base.rows.n)
    if look.parameter == "force":
        field = field * np.asarray(base.rows.inputs.fz)
    if is_mirrored(look.parameter, look.covariate):
        field = field * np.where(base.slip_fraction < 0, -1.0, 1.0)
    return field


def _fitted(field, shapes, linear: LinearFit) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (q,) of the shapes (n, q), and what they leave (channels, n)."""
    columns = (field[:, :, None] * shapes).reshape(-1, shapes.shape[1])
    lone = without(columns, linear.used_up)
    residual = without(linear.residual, linear.used_up)
    coefficient = np.linalg.lstsq(lone, residual, rcond=None)[0]
    return coefficient, (residual - lone @ coefficient).reshape(field.shape)


def _bin_count(energy: float, periods: float, n: int) -> int:
    """As many bins as show the shape, unless each is then too unsure.

    Args:
        energy: of the shape, in squares of the noise's standard deviation.
    """
    count = np.clip(_SURE**2 * energy, *_BINS)
    return int(min(max(count, _OF_A_PERIOD * periods), max(n // _IN_A_BIN, 1)))


def _bins(place, information, count: int) -> np.ndarray:
    """Bins (n,) along the place in which the parameter is known equally well."""
    order = np.argsort(place, kind="stable")
    known = np.cumsum(information[order])
    middle = (known - 0.5 * information[order]) / known[-1]
    codes = np.empty(len(place), int)
    codes[order] = np.minimum(count * middle, count - 1).astype(int)
    return codes


def _grid(look: Look, low: float, span: float) -> np.ndarray:
    x = np.linspace(low, low + span, _POINTS)
    if look.shape != "threshold":
        return x
    # A step is upright.
    return np.sort(np.append(x, [look.at, np.nextafter(look.at, np.inf)]))
