"""Does one size fit all? The size of an effect in each group of the data.

A cause has the same size at every load, speed, slip and time; an effect that stands in for
another one needs other sizes in other places.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from tirefit.diagnosis.engine.fit import Fit, without
from tirefit.diagnosis.negligible import NONZERO, ROUNDING, UNSEEN

GROUPS = 4
"""Number of groups of a covariate, of as many values each."""

_KNOWN = 3.0
"""A group whose size is known to worse than this many times the size itself says nothing."""


class SizeByGroup(NamedTuple):
    """The size of an effect in groups of one covariate, in ascending order of the covariate.

    Attributes:
        covariate: of the groups; ``at`` its median in each.
        size: in the unit of the amplitude; ``std`` their standard errors.
        spread: standard deviation of the sizes beyond that of their errors, over the size
            that fits all: near zero for a cause, often a quarter and more for an effect that
            stands in for another one.
        explains: share of the mean square of the remainder that unequal sizes explain.
    """

    covariate: str
    at: tuple[float, ...]
    size: tuple[float, ...]
    std: tuple[float, ...]
    spread: float
    explains: float = 0.0


def grouped(values: np.ndarray) -> np.ndarray:
    """Group (n,) of each value: its settings if there are few, else parts of equal number."""
    settings = np.unique(values)
    if len(settings) <= GROUPS:
        return np.searchsorted(settings, values)
    edges = np.unique(np.quantile(values, np.arange(1, GROUPS) / GROUPS))
    return np.searchsorted(edges, values, side="right")


def sizes_by_group(
    fit: Fit, atom: int, groups: Mapping[str, np.ndarray], noise: float = 1.0, unit: float = 1.0
) -> list[SizeByGroup]:
    """The size of one effect of a fit in the groups of each covariate, most unequal first.

    Args:
        atom: number of the effect's atom in the fit.
        groups: values (m,) of each covariate for the residuals.
        noise: mean square of the remainder, at least one, that widens the errors.
        unit: prior scale of the amplitude in its own unit.
    """
    found = [
        one
        for name, values in groups.items()
        if (one := _sizes(fit, fit.atoms.index(atom), name, values, noise, unit)) is not None
    ]
    return sorted(found, key=lambda one: -one.spread)


def _sizes(
    fit: Fit, place: int, name: str, values: np.ndarray, noise: float, unit: float
) -> SizeByGroup | None:
    """:func:`sizes_by_group` for one covariate; None for a single group."""
    code, own = grouped(values), len(fit.z) + place
    whole, amplitude = fit.columns[:, own], float(fit.amplitude[place])
    felt = np.bincount(code, whole**2) > UNSEEN * float(whole @ whole)
    groups = np.flatnonzero(felt)
    if len(groups) < 2:
        return None
    split = whole[:, None] * (code[:, None] == groups)
    # Unequal sizes beside everything that is in the fit.
    left, rest = fit.remainder(split), fit.remainder()
    score = left.T @ rest
    gained = score @ np.linalg.pinv(left.T @ left, hermitian=True, rcond=UNSEEN) @ score
    # Each size, beside the others of the set.
    others = np.concatenate(
        [np.delete(fit.columns, own, axis=1), np.diag(np.delete(fit.pull, own))]
    )
    target = np.concatenate([fit.residual + whole * amplitude, np.zeros(len(fit.pull) - 1)])
    split = np.concatenate([split, np.zeros((len(fit.pull) - 1, len(groups)))])
    split = without(split, others)
    inverse = np.linalg.inv(split.T @ split + ROUNDING * np.eye(len(groups)))
    size = inverse @ (split.T @ target)
    std = np.sqrt(np.maximum(np.diag(inverse), 0.0) * max(noise, 1.0))
    return SizeByGroup(
        name,
        tuple(float(np.median(values[code == k])) for k in groups),
        tuple((unit * size).tolist()),
        tuple((abs(unit) * std).tolist()),
        _spread(size, std, amplitude),
        float(gained) / max(float(rest @ rest), NONZERO),
    )


def _spread(size: np.ndarray, std: np.ndarray, whole: float) -> float:
    """Spread of sizes beyond their errors over the whole size; by the groups that know it."""
    known = (std > 0) & (std < _KNOWN * max(abs(whole), NONZERO))
    if known.sum() < 2:
        return 0.0
    weight = 1 / std[known] ** 2
    mean = float(weight @ size[known]) / float(weight.sum())
    # DerSimonian and Laird (1986): variance between groups beyond their errors.
    square = float(weight @ (size[known] - mean) ** 2)
    scale = weight.sum() - np.sum(weight**2) / weight.sum()
    between = max(square - (known.sum() - 1), 0.0) / max(float(scale), NONZERO)
    return float(np.sqrt(between)) / max(abs(whole), NONZERO)
