"""Stretches of the record for which one setting was held: what differs during one of
them may be an effect of the time or of the setting, and no fit can tell."""

import numpy as np

from tirefit.data.levels import levels
from tirefit.diagnosis.rows.prepared import Prepared

_SAME, _NEAR = 0.8, 0.02
"""Share of two stretches together that both have, from which they are one, and distance
of a step from a change of run, as a share of the record, within which it is that."""


def blocks_of_settings(prepared: Prepared) -> np.ndarray:
    """Begin and end (k, 2) of the stretches for which a load, a speed or both were held
    that are there at no other time, in shares of the record about its middle. Those at
    the begin and the end of the record are none: what differs there is a step. Of a
    change from one run to the next, the end is infinite: a step there is of the runs.
    """
    rows = prepared.covariates
    found = [levels(values) for values in (rows.fz, rows.v)]
    codes = [one.code for one in found if one.few() and len(one.center) > 1]
    if len(codes) == 2:
        codes.append(codes[0] * (1 + codes[1].max()) + codes[1])
    if "time" not in prepared.has:
        return np.zeros((0, 2))
    order = np.argsort(rows.time, kind="stable")
    time = np.asarray(rows.time)[order]
    blocks: set[tuple[float, float]] = set()
    run = prepared.run[order]
    for at in np.flatnonzero(np.diff(run)) + 1 if "runs" in prepared.has else ():
        if not np.intersect1d(run[:at], run[at:]).size:
            pause = time[at] - time[at - 1]
            within = np.linspace(time[at - 1], time[at], 2 + int(pause / _NEAR))
            blocks.update((begin, np.inf) for begin in within.tolist())
    for code in codes:
        sequence = code[order]
        ends = np.flatnonzero(np.diff(sequence)) + 1
        for begin, end in zip(ends[:-1], ends[1:], strict=True):
            if np.count_nonzero(sequence == sequence[begin]) == end - begin:
                edges = (time[begin - 1] + time[begin], time[end - 1] + time[end])
                blocks.add((edges[0] / 2, edges[1] / 2))
    return np.array(sorted(blocks)).reshape(-1, 2)


def coincides(begin, end, blocks: np.ndarray) -> np.ndarray | np.bool:
    """Whether stretches (...,) are one with any of the blocks (k, 2)."""
    begin, end = np.asarray(begin)[..., None], np.asarray(end)[..., None]
    both = np.minimum(end, blocks[:, 1]) - np.maximum(begin, blocks[:, 0])
    either = np.maximum(end, blocks[:, 1]) - np.minimum(begin, blocks[:, 0])
    of_runs = np.isinf(blocks[:, 1]) & (np.abs(begin - blocks[:, 0]) <= _NEAR)
    return np.any((both > _SAME * either) | (of_runs & (end > 0.5)), axis=-1)
