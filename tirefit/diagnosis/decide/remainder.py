"""Tests of the remainder: what an engineer would still see in the residual plots.

Every statistic is compared with its values for noise that went through the same fit, on
these very rows: no table of critical values, no assumption on the design. Residuals
are whitened and only their shape is judged, so a noise level that is off by a factor
does not count. Autocorrelated noise is granted as far as it was judged to be there.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.fft import rfft
from scipy.signal import lfilter
from scipy.sparse import csr_array

from tirefit.diagnosis.decide.verdict import Tests
from tirefit.diagnosis.evidence.base import Base
from tirefit.diagnosis.evidence.posterior import Key, Weighed, linear_at
from tirefit.diagnosis.negligible import ROUNDING, SILENT
from tirefit.diagnosis.noise import Memory, correlation
from tirefit.diagnosis.rows.basis import without
from tirefit.diagnosis.rows.patterns import travelled
from tirefit.diagnosis.rows.prepared import Prepared, neighbours
from tirefit.diagnosis.rows.slips import segments

_PRECISION = np.float32
"""Of the simulated residuals, which are read many times over."""

_LEAST_SIZE = 1e-30
"""Divisor in the place of zero, in that precision."""

DRAWS = 199
"""Simulated residuals."""

_TAIL = 0.9
"""Quantile of the draws beyond which their tail is taken as exponential."""

LEAST_P = 1e-6
"""Smallest p-value of a channel that is told: farther out nobody knows the tail."""

LEVEL = 0.005
"""A p-value below which a test is reported to see a remainder: noise fails each test
once in 200 files."""

_WIDEST = 4.0
"""Residuals are cut at so many standard deviations: one stray row is no structure."""

_RUNS = (2, 4, 8, 16, 32, 64, 128)
"""Neighbours whose residuals are added up: a smooth miss adds up, noise does not."""

_FIRST_LINES = 16
"""Slowest lines of a periodogram that are compared with one another."""

_LOCAL = (6, 12, 24)
"""Rows of a local block, which multiples of half the shortest are: what sits in one
region shows there first."""

_FEWEST_SUMS = 4
"""Sums of neighbours whose mean square says something."""

_WITH_NEIGHBOURS = 3
"""Rows of a setting from which one has a neighbour on either side."""

Statistic = Callable[[np.ndarray], np.ndarray]
"""(n, draws) residuals -> (draws,): the larger, the more structure."""


def _unit(parts: np.ndarray) -> np.ndarray:
    """Columns of mean square one, cut at :data:`_WIDEST`."""
    scaled = np.clip(parts / _size(parts), -_WIDEST, _WIDEST)
    return scaled / _size(scaled)


def _size(parts) -> np.ndarray:
    return np.maximum(np.sqrt(_mean_square([parts], len(parts))), _LEAST_SIZE)


def _sums(parts: np.ndarray, length: int) -> np.ndarray:
    """Sums of so many consecutive rows, from one to the next: (blocks, draws)."""
    whole = len(parts) // length * length
    return parts[:whole].reshape(-1, length, parts.shape[1]).sum(axis=1)


def _largest(values: Sequence[np.ndarray]) -> np.ndarray:
    """Largest of several statistics (draws,), each in units of its own scatter."""
    stacked = np.array(values)
    center = np.median(stacked, axis=1, keepdims=True)
    spread = stacked.std(axis=1, keepdims=True)
    return np.max((stacked - center) / np.maximum(spread, ROUNDING), axis=0)


def _mean_square(blocks: Sequence[np.ndarray], count: int) -> np.ndarray:
    """Of the rows (count in all) of several blocks: (draws,)."""
    return np.sum([np.einsum("bd,bd->d", b, b) for b in blocks], axis=0) / count


def _persistence(stretches: Sequence[np.ndarray]) -> Statistic:
    """Mean square of sums of neighbours over that of independent rows, at the length
    where it stands out most. ``stretches`` are rows in order: index arrays."""

    def statistic(parts):
        values = []
        blocks, before = [parts[s] for s in stretches], 1
        for length in _RUNS:
            # Each length is a multiple of the one before.
            blocks = [_sums(block, length // before) for block in blocks]
            before, count = length, sum(len(b) for b in blocks)
            if count >= _FEWEST_SUMS:
                values.append(_mean_square(blocks, count) / length)
        return _largest(values)

    return statistic


def _medians(values: np.ndarray) -> np.ndarray:
    """Along the first axis, of finite values: by one partition, where ``np.median``
    makes three."""
    half = len(values) // 2
    parted = np.partition(values, half, axis=0)
    if len(values) % 2:
        return parted[half]
    return (parted[:half].max(axis=0) + parted[half]) / 2


def _lines(orders: Sequence[np.ndarray]) -> Statistic:
    """Largest line of a periodogram over the median, of all lines and of its octave:
    noise with a memory is stronger where it is slower, a wave at its period.

    Args:
        orders: place of each row in each of them; of a place without a row nothing is
            known, and those after it keep theirs: a wave keeps its phase.
    """

    def statistic(parts):
        values, rows = [], np.arange(len(parts))
        for places in orders:
            shape = (1 + places.max(), len(parts))
            one = np.ones(len(parts), parts.dtype)
            ordered = csr_array((one, (places, rows)), shape) @ parts
            power = np.abs(rfft(ordered, axis=0)[1:]) ** 2
            count = len(power)
            first = min(_FIRST_LINES, count)
            octaves = int(np.log2(count / first))
            ends = [first * 2**k for k in range(octaves)]
            bands = [power, *np.split(power, ends)]
            # In logarithms: of few lines the ratio is large by chance.
            values += [np.log(b.max(axis=0) / _medians(b)) for b in bands]
        return _largest(values)

    return statistic


def _pure_error(stretches: Sequence[np.ndarray]) -> Statistic:
    """Mean square over half that of differences of neighbours."""
    count = sum(len(s) - 1 for s in stretches)

    def statistic(parts):
        steps = _mean_square([np.diff(parts[s], axis=0) for s in stretches], count)
        whole = _mean_square([parts], len(parts))
        return whole / np.maximum(steps / 2, ROUNDING)

    return statistic


def _local(stretches: Sequence[np.ndarray]) -> Statistic:
    """Largest mean of a block of neighbours in its own standard errors."""

    piece = _LOCAL[0] // 2

    def statistic(parts):
        values, pieces = [], [_sums(parts[s], piece) for s in stretches]
        for length in _LOCAL:
            for shift in (0, length // 2):
                sums = [_sums(p[shift // piece :], length // piece) for p in pieces]
                largest = [np.abs(each).max(axis=0) for each in sums if len(each)]
                if largest:
                    values.append(np.max(largest, axis=0) / np.sqrt(length))
        return _largest(values)

    return statistic


def _noise(n: int, memory: Sequence[Memory], stretches, generator) -> np.ndarray:
    """Draws (n, DRAWS) of unit noise, part of it with a memory along the stretches:
    of each memory that may be, in proportion to its probability."""
    white = generator.standard_normal((n, DRAWS))
    if stretches is None or not any(np.any(one.share) for one in memory):
        return white
    coloured = generator.standard_normal((n, DRAWS))
    ends = np.rint(DRAWS * np.cumsum([one.chance for one in memory])).astype(int)
    for one, begin, end in zip(memory, [0, *ends[:-1]], ends, strict=True):
        own, fade = coloured[:, begin:end], one.fade
        for rows in stretches:
            own[rows] = lfilter(
                [np.sqrt(1 - fade**2)], [1.0, -fade], own[rows], axis=0,
                zi=own[rows[0]][None] * fade,
            )[0]  # fmt: skip
        share = np.broadcast_to(one.share, n)[:, None]
        white[:, begin:end] *= np.sqrt(1 - share)
        white[:, begin:end] += np.sqrt(share) * own
    return white


def _p_value(observed: float, drawn: np.ndarray) -> float:
    """Share of draws (the observation among them) that are as large; beyond all of them
    by the mean excess over their quantile :data:`_TAIL`, as of an exponential tail
    (peaks over threshold; Pickands, 1975)."""
    among = (1 + np.sum(drawn >= observed)) / (1 + len(drawn))
    if observed <= drawn.max():
        return float(among)
    threshold = np.quantile(drawn, _TAIL)
    excess = np.mean(drawn[drawn > threshold]) - threshold
    beyond = (1 - _TAIL) * np.exp(-(observed - threshold) / max(excess, ROUNDING))
    return float(np.clip(beyond, LEAST_P, among))


def _p_values(residual, draws, in_time, in_slip, orders) -> Tests:
    """The tests of one channel.

    Args:
        residual: (n,) whitened.
        draws: (n, DRAWS) of noise that went through the same fit.
        in_time: rows of each unbroken stretch in the order of time: index arrays; None
            where the time is not known.
        in_slip: rows of each setting (load, speed, direction) in the order of slip.
        orders: place of each row in every order in which a wave may lie.
    """
    settings = [s for s in in_slip if len(s) >= _WITH_NEIGHBOURS]
    observed = residual[:, None].astype(_PRECISION)
    together = _unit(np.concatenate([observed, draws], axis=1))

    def p_value(statistic: Statistic | None) -> float | None:
        if statistic is None:
            return None
        observed, *drawn = statistic(together)
        return _p_value(observed, np.array(drawn))

    ordered = [np.arange(0)] if in_time is None else in_time
    timed = max(len(s) for s in ordered) >= _FEWEST_SUMS * _RUNS[1]
    if not orders or not timed:
        orders = [np.argsort(np.concatenate(ordered if timed else in_slip))]
    dense = sum(len(s) for s in settings) >= 0.5 * len(residual)
    longest = max((len(s) for s in settings), default=0)
    return Tests(
        time=p_value(_persistence(ordered) if timed else None),
        slip_order=p_value(_persistence([np.concatenate(in_slip)]) if dense else None),
        line=p_value(_lines(orders)),
        pure_error=p_value(_pure_error(settings) if dense else None),
        local=p_value(_local(settings) if dense and longest >= _LOCAL[0] else None),
    )


def _orders(prepared: Prepared, stretches: list[np.ndarray]) -> list[np.ndarray]:
    """Places of the rows in time and along the distance travelled: what turns with the
    wheel repeats with that.

    Args:
        stretches: rows in the order of time, see :func:`segments`.
    """
    orders = [np.argsort(np.concatenate(stretches))]
    if "speeds" in prepared.has:
        way = travelled(prepared)
        if np.ptp(way) > 0:
            steps = (prepared.n - 1) / np.ptp(way)
            orders.append(np.rint((way - way.min()) * steps).astype(int))
    return orders


def remainder_tests(
    base: Base, weighed: Weighed, key: Key, generator: np.random.Generator
) -> Tests:
    """Tests of what a set of effects leaves: the smallest p-value of the channels times
    their number (Bonferroni).

    Args:
        generator: of the noise.
    """
    linear = linear_at(base, weighed.best_of[key])
    if key in weighed.other_form:
        linear = linear.in_other_form()
    prepared, n, used_up = base.rows, base.rows.n, linear.used_up
    residual = without(linear.residual, used_up)
    keep = np.asarray(base.design.keep[:n]) > 0
    index = np.cumsum(keep) - 1

    def kept(groups):
        parts = [index[group[keep[group]]] for group in groups]
        return [part for part in parts if len(part)]

    in_time, orders = None, []
    if prepared.time is not None:
        stretches = segments(prepared.time, prepared.run)
        in_time = kept(stretches)
        orders = [places[keep] for places in _orders(prepared, stretches)]
    in_slip, count = kept(neighbours(prepared)), int(keep.sum())
    unit, _ = np.linalg.qr(used_up)
    noise, sizes = [], []
    for k, channel in enumerate(prepared.channels):
        part = residual[np.flatnonzero(keep) + k * n]
        memory = base.noise[channel].memory
        sizes.append(float(np.sqrt(np.mean(part**2))))
        noise.append(sizes[-1] * _noise(count, memory, in_time, generator))
    rows = np.concatenate(
        [np.flatnonzero(keep) + k * n for k in range(len(prepared.channels))]
    )
    doubt = base.doubt[rows]
    draws = np.concatenate(noise)
    draws += doubt @ generator.standard_normal((doubt.shape[1], DRAWS))
    draws, taken = draws.astype(_PRECISION), unit[rows].astype(_PRECISION)
    draws -= taken @ (taken.T @ draws)
    each = [
        _p_values(
            residual[rows[part]], draws[part], in_time, in_slip, orders
        )
        for part, size in zip(
            np.split(np.arange(len(rows)), len(sizes)), sizes, strict=True
        )
        if size > SILENT
    ]  # fmt: skip
    return Tests(
        *(
            min(1.0, len(each) * min(found)) if (found := _made(values)) else None
            for values in zip(*each, strict=True)
        )
    )


def _made(values) -> list[float]:
    return [p for p in values if p is not None]


def widening(base: Base, residual) -> float:
    """Factor on the variance of amplitudes: mean square of what a set leaves, times the
    rows that count as one there; one where the noise is all that it leaves. The noise's
    own correlation is in the weights of the rows already.

    Args:
        residual: (m,) whitened, of all channels.
    """
    prepared, n = base.rows, base.rows.n
    rows_each = max(
        correlation(residual[k * n : (k + 1) * n], prepared.time, prepared.run)
        for k in range(len(prepared.channels))
    )
    return max(float(np.mean(residual**2)) * rows_each, 1.0)
