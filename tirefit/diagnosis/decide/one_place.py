"""Gaps in one place, which a judge of the noise takes for noise: many outliers side by
side, or a level that changes at once, as a long memory never does."""

import numpy as np

from tirefit.diagnosis.evidence.base import Base
from tirefit.diagnosis.evidence.search import Hypothesis, amplitudes_of
from tirefit.diagnosis.negligible import NONZERO
from tirefit.diagnosis.rows.prepared import neighbours
from tirefit.diagnosis.rows.rates import segments

_BESIDE_A_ROW = 2
"""Rows on either side whose misfit says whether a row that was set aside is alone."""

_SHARED = 2.0
"""Median misfit of these rows, in standard deviations of the noise, from which they are
not: four times that of a median of noise."""

_TOGETHER = 0.03
"""Share of the rows, set aside beside neighbours that miss alike, from which they are
no outliers: of a normal noise of any memory one row in a hundred is as far off."""

_LEVEL = 7
"""Rows of which the median is a level of the noise."""

_STEP = 10.0
"""Change of that level over its usual one, from which it is none of a noise: of 2,000
normal rows of any memory, growing with the force too, the largest is 8."""

_LONG = 5.0
"""Rows that count as one from which a memory may hide such a step."""


def hidden_by_noise(base: Base, nothing: Hypothesis) -> bool:
    """Whether what counts as noise beside no effect at all is a gap in one place."""
    shared = set_aside_together(base, nothing).values()
    if max(float(np.mean(shown)) for _, shown in shared) >= _TOGETHER:
        return True
    remembers = max(level.inflation for level in base.noise.values()) > _LONG
    return remembers and largest_step(base, nothing) > _STEP


def set_aside_together(
    base: Base, hypothesis: Hypothesis
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Median misfit of each row and those beside it (n,), and whether the row was set
    aside as an outlier while they miss alike (n,), by channel."""
    out = np.asarray(base.design.keep)[: base.rows.n] == 0
    believed = base.forces(hypothesis.z, amplitudes_of(base, hypothesis))
    groups, found = neighbours(base.rows), {}
    for channel, values in believed.items():
        typical = typical_of_neighbours(base.rows.observed[channel] - values, groups)
        shown = out & (np.abs(typical) > _SHARED * base.noise[channel].std)
        found[channel] = typical, shown
    return found


def typical_of_neighbours(missed, groups) -> np.ndarray:
    """Median of each row's misfit and of the rows beside it in its group: (n,); zero in
    groups that have fewer rows than that takes.

    Args:
        groups: index arrays in the order in which rows are neighbours.
    """
    typical, wide = np.zeros(len(missed)), 2 * _BESIDE_A_ROW + 1
    for rows in groups:
        if len(rows) >= wide:
            around = np.pad(missed[rows], _BESIDE_A_ROW, mode="reflect")
            near = np.lib.stride_tricks.sliding_window_view(around, wide)
            typical[rows] = np.median(near, axis=1)
    return typical


def largest_step(base: Base, hypothesis: Hypothesis) -> float:
    """Largest change in time of the level that a fit leaves, over its usual change
    (1.48 times the median); zero without time."""
    rows, n = base.rows, base.rows.n
    if rows.time is None:
        return 0.0
    residual = base.residual(hypothesis.z, amplitudes_of(base, hypothesis))
    kept, largest = np.asarray(base.design.keep)[:n] > 0, 0.0
    for k in range(len(rows.channels)):
        left, steps = residual[k * n : (k + 1) * n], []
        for stretch in segments(rows.time, rows.run):
            values = left[stretch[kept[stretch]]]
            if len(values) >= 2 * _LEVEL:
                near = np.lib.stride_tricks.sliding_window_view(values, _LEVEL)
                level = np.median(near, axis=1)
                steps.append(np.abs(level[_LEVEL:] - level[:-_LEVEL]))
        if steps:
            every = np.concatenate(steps)
            usual = 1.4826 * max(float(np.median(every)), NONZERO)
            largest = max(largest, float(every.max()) / usual)
    return largest
