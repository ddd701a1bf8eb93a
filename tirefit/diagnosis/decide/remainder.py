"""Tests for structure in the remainder, as an engineer would see it in residual plots.

Every statistic is compared with its values for simulated noise after the same fit of the
same rows; there are no tables of critical values and no assumption on the design.
Residuals are whitened and only their shape is tested, so a wrong noise level does not
matter. The simulated noise has the autocorrelation that was estimated.
"""

from collections.abc import Sequence

import numpy as np
from scipy.fft import rfft
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

DRAWS = 199
"""Number of simulated residuals."""

LEAST_P = 1e-6
"""Smallest p-value of a channel that is reported, as the tail beyond it is unknown."""

LEVEL = 0.005
"""A test with a p-value below this is reported to find a remainder; noise fails each test
once in 200 files."""

_TAIL = 0.9
"""Quantile of the draws beyond which an exponential tail is assumed."""

_PRECISION = np.float32
"""Float type of the simulated residuals; a small one, as they are read many times."""

_WIDEST = 4.0
"""Residuals are clipped at this many standard deviations: outliers are not structure."""

_RUNS = tuple(2**power for power in range(1, 8))
"""Numbers of neighbours whose residuals are summed: smooth misfit adds up, noise does not."""

_FIRST_LINES = 16
"""Number of the lowest frequencies of a periodogram that are compared."""

_LOCAL = (6, 12, 24)
"""Numbers of rows of a local block, multiples of half the shortest; they detect a misfit
of one region."""

_FEWEST_SUMS = 4
"""Smallest number of sums of neighbours whose mean square is used."""

_WITH_NEIGHBOURS = 3
"""Smallest number of rows of a setting for one to have a neighbour on either side."""


def _mean_square(blocks: Sequence[np.ndarray]) -> np.ndarray:
    """The statistic over the rows of several blocks: (draws,)."""
    squares = np.sum([np.einsum("bd,bd->d", b, b) for b in blocks], axis=0)
    return squares / sum(map(len, blocks))


def _unit(parts: np.ndarray) -> np.ndarray:
    """Columns scaled to mean square one and clipped at :data:`_WIDEST`."""

    def scaled(parts):
        size = np.sqrt(_mean_square([parts]))
        return parts / np.maximum(size, np.finfo(_PRECISION).tiny)

    return scaled(np.clip(scaled(parts), -_WIDEST, _WIDEST))


def _sums(parts: np.ndarray, length: int) -> np.ndarray:
    """Sums of consecutive blocks of ``length`` rows: (blocks, draws)."""
    whole = len(parts) // length * length
    return parts[:whole].reshape(-1, length, parts.shape[1]).sum(axis=1)


def _largest(values: Sequence[np.ndarray]) -> np.ndarray:
    """Largest of several statistics (draws,), each in units of its scatter."""
    stacked = np.array(values)
    center = np.median(stacked, axis=1, keepdims=True)
    spread = stacked.std(axis=1, keepdims=True)
    return np.max((stacked - center) / np.maximum(spread, ROUNDING), axis=0)


# A statistic of residuals (n, draws) is (draws,); a larger one means more structure.
# Stretches are index arrays of rows in order.


def _persistence(parts, stretches: Sequence[np.ndarray]) -> np.ndarray:
    """Mean square of sums of neighbours over that of independent rows, at the length with
    the most significant ratio."""
    values = []
    blocks, before = [parts[s] for s in stretches], 1
    for length in _RUNS:
        # Each length is a multiple of the one before.
        blocks, before = [_sums(b, length // before) for b in blocks], length
        if sum(map(len, blocks)) >= _FEWEST_SUMS:
            values.append(_mean_square(blocks) / length)
    return _largest(values)


def _lines(parts, orders: Sequence[np.ndarray]) -> np.ndarray:
    """Largest line of a periodogram over the median of all lines and of its octave.
    Correlated noise has more power at low frequencies, a wave at its own.

    Args:
        orders: place of each row in each of them. A place without a row counts as
            zero, and those after it keep theirs: a wave keeps its phase.
    """
    values, rows = [], np.arange(len(parts))
    for places in orders:
        shape = (1 + places.max(), len(parts))
        one = np.ones(len(parts), parts.dtype)
        ordered = csr_array((one, (places, rows)), shape) @ parts
        power = np.abs(rfft(ordered, axis=0)[1:]) ** 2
        first = min(_FIRST_LINES, len(power))
        octaves = int(np.log2(len(power) / first))
        bands = [power, *np.split(power, [first * 2**k for k in range(octaves)])]
        # In logarithms, as the ratio is large by chance if there are few lines.
        values += [np.log(b.max(axis=0) / np.median(b, axis=0)) for b in bands]
    return _largest(values)


def _pure_error(parts, stretches: Sequence[np.ndarray]) -> np.ndarray:
    """Mean square over half the mean square of differences of neighbours."""
    steps = _mean_square([np.diff(parts[s], axis=0) for s in stretches])
    return _mean_square([parts]) / np.maximum(steps / 2, ROUNDING)


def _local(parts, stretches: Sequence[np.ndarray]) -> np.ndarray:
    """Largest mean of a block of neighbours in its standard errors."""
    piece = _LOCAL[0] // 2
    values, pieces = [], [_sums(parts[s], piece) for s in stretches]
    for length in _LOCAL:
        for shift in (0, length // 2):
            sums = [_sums(p[shift // piece :], length // piece) for p in pieces]
            largest = [np.abs(each).max(axis=0) for each in sums if len(each)]
            if largest:
                values.append(np.max(largest, axis=0) / np.sqrt(length))
    return _largest(values)


def _noise(n: int, memory: Sequence[Memory], stretches, generator) -> np.ndarray:
    """Draws (n, DRAWS) of unit noise with the possible correlations along the stretches,
    each in proportion to its probability."""
    white = generator.standard_normal((n, DRAWS))
    if not stretches or not any(np.any(one.share) for one in memory):
        return white
    from scipy.signal import lfilter  # 0.4 s, and other data need nothing of it

    coloured = generator.standard_normal((n, DRAWS))
    ends = np.rint(DRAWS * np.cumsum([one.chance for one in memory])).astype(int)
    for one, begin, end in zip(memory, [0, *ends[:-1]], ends, strict=True):
        own, fade = coloured[:, begin:end], one.fade
        for rows in stretches:
            own[rows] = lfilter(
                [np.sqrt(1 - fade**2)],
                [1.0, -fade],
                own[rows],
                axis=0,
                zi=own[rows[0]][None] * fade,
            )[0]
        share = np.broadcast_to(one.share, n)[:, None]
        white[:, begin:end] *= np.sqrt(1 - share)
        white[:, begin:end] += np.sqrt(share) * own
    return white


def _p_value(observed: float, drawn: np.ndarray) -> float:
    """p-value: the share of draws (and the observation) that are as large. For larger
    observations, an exponential tail is fitted to the excesses over the quantile
    :data:`_TAIL` (peaks over threshold; Pickands, 1975)."""
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
        draws: (n, DRAWS) of noise after the same fit.
        in_time: rows of each unbroken stretch in the order of time: index arrays; empty
            if the time is not known.
        in_slip: rows of each setting (load, speed, direction) in the order of slip.
        orders: place of each row in every order in which a wave may lie.
    """
    observed = residual[:, None].astype(_PRECISION)
    together = _unit(np.concatenate([observed, draws], axis=1))

    def p_value(statistic, *given) -> float:
        observed, *drawn = statistic(together, *given)
        return _p_value(observed, np.array(drawn))

    tests, by_slip = {}, np.concatenate(in_slip)
    timed = max(map(len, in_time), default=0) >= _FEWEST_SUMS * _RUNS[1]
    if timed:
        tests["time"] = p_value(_persistence, in_time)
    if not orders or not timed:
        orders = [np.argsort(np.concatenate(in_time) if timed else by_slip)]
    settings = [s for s in in_slip if len(s) >= _WITH_NEIGHBOURS]
    if sum(map(len, settings)) >= 0.5 * len(residual):
        tests["slip_order"] = p_value(_persistence, [by_slip])
        tests["pure_error"] = p_value(_pure_error, settings)
        if max(map(len, settings)) >= _LOCAL[0]:
            tests["local"] = p_value(_local, settings)
    return Tests(line=p_value(_lines, orders), **tests)


def _orders(prepared: Prepared, stretches: list[np.ndarray]) -> list[np.ndarray]:
    """Places of the rows in time and along the distance travelled, with which effects of
    the turning wheel repeat.

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
    """Tests of the remainder of a set of effects; a p-value is the smallest of the
    channels times their number (Bonferroni).

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

    in_time, orders = [], []
    if prepared.time is not None:
        stretches = segments(prepared.time, prepared.run)
        in_time = kept(stretches)
        orders = [places[keep] for places in _orders(prepared, stretches)]
    in_slip, channels = kept(neighbours(prepared)), len(prepared.channels)
    rows = np.flatnonzero(np.tile(keep, channels))
    parts = np.split(residual[rows], channels)
    sizes = [float(np.sqrt(np.mean(part**2))) for part in parts]
    draws = np.concatenate(
        [
            size * _noise(int(keep.sum()), base.noise[channel].memory, in_time, generator)
            for channel, size in zip(prepared.channels, sizes, strict=True)
        ]
    )
    doubt = base.doubt[rows]
    draws += doubt @ generator.standard_normal((doubt.shape[1], DRAWS))
    unit, _ = np.linalg.qr(used_up)
    draws, taken = draws.astype(_PRECISION), unit[rows].astype(_PRECISION)
    draws -= taken @ (taken.T @ draws)
    each = [
        _p_values(part, drawn, in_time, in_slip, orders)
        for part, drawn, size in zip(parts, np.split(draws, channels), sizes, strict=True)
        if size > SILENT
    ]
    found = {}
    for name, values in zip(Tests._fields, zip(*each, strict=True), strict=False):
        if made := [p for p in values if p is not None]:
            found[name] = min(1.0, len(each) * min(made))
    return Tests(**found)


def widening(base: Base, residual) -> float:
    """Factor on the variance of amplitudes: mean square of the remainder of a set, times
    its rows per independent row; one if the remainder is noise. The weights of the rows
    include the correlation of the noise.

    Args:
        residual: (m,) whitened, of all channels.
    """
    prepared, n = base.rows, base.rows.n
    rows_each = max(
        correlation(residual[k * n : (k + 1) * n], prepared.time, prepared.run)
        for k in range(len(prepared.channels))
    )
    return max(float(np.mean(residual**2)) * rows_each, 1.0)
