"""Waves in time that are faster than the patterns of :mod:`rows.patterns`:
the hum of the mains, chatter, a resonance.

There may be as many as half the rows, and each is as probable as one of so many. Only
those that stand out in a periodogram of what is left are drawn and compared.
"""

from dataclasses import replace

import numpy as np
from scipy.fft import next_fast_len, rfft

from tirefit.diagnosis.rows.patterns import PHASES, Over, Patterns, phased, turns

_FINER = 4
"""Lines of the periodogram for each that a record has: between two of them a wave loses
a fiftieth of its square at most."""

_DRAWN = 2
"""Strongest lines that are drawn, of each parameter."""

_SPARSE = 4
"""Places of the sampling for each row from which it is none."""


def with_fast_waves(among: Patterns, time, residual) -> Patterns:
    """The patterns, and as those of one quantity more the strongest fast waves in time
    of what is left; the same where the record has no sampling that shows any.

    Args:
        time: (n,) of the rows [s].
        residual: (m,) whitened, the fit taken out.
    """
    slow = next((one for one in among.over if one.covariate == "time"), None)
    moments = np.unique(time)
    if slow is None or len(moments) < 2:
        return among
    low, span = moments[0], moments[-1] - moments[0]
    step = float(np.median(np.diff(moments)))
    places = np.rint((time - low) / step).astype(int)
    count = int(places.max()) + 1
    if count > _SPARSE * len(time):
        return among
    size = next_fast_len(_FINER * count, real=True)
    cycles = np.arange(size // 2) * span / (step * size)
    there = [span / at for shape, at, _ in slow.listed if shape == "wave"]
    fast = cycles > max(there, default=1.0)
    if not fast.any():
        return among
    weights, channels = among.weights, len(among.weights)
    chosen: set[float] = set()
    for column in slow.weights.values():
        each = np.sum(weights[:, :, column] * residual.reshape(channels, -1), axis=0)
        power = np.abs(rfft(np.bincount(places, each, count), size)[: size // 2])
        power *= fast
        for _ in range(_DRAWN):
            line = int(np.argmax(power))
            if power[line] <= 0:
                break
            chosen.add(float(cycles[line]))
            power[max(line - 2 * _FINER, 0) : line + 2 * _FINER + 1] = 0.0
    counts = np.array(sorted(chosen))
    share = (time - low) / span
    waves = np.concatenate([turns(share, np.array([c])) for c in counts], axis=1)
    listed = [("wave", span / c, 0.0) for c in counts for _ in range(PHASES)]
    lines = np.count_nonzero(fast) / _FINER * PHASES
    drawn = Over(
        "time", phased(waves).astype(np.float32), listed,
        np.full(len(listed), -np.log(lines)), slow.weights,
    )  # fmt: skip
    return replace(among, over=(*among.over, drawn))
