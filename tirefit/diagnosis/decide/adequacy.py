"""What a good engineer would still see in the residual plots of an explanation.

Every statistic is compared with its values for noise that went through the same fit, on
these very rows: no table of critical values, no assumption on the design. Residuals
are whitened; only their shape is judged, so a noise level that is off by a factor is no
finding here. Noise with a memory is granted as far as it was judged to have one.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.fft import rfft
from scipy.signal import lfilter
from scipy.sparse import csr_array

from tirefit.diagnosis.negligible import ROUNDING
from tirefit.diagnosis.noise.memory import Memory

_PRECISION = np.float32
"""Of the simulated residuals: a thousand draws of all rows are read many times over,
and a p-value counts in thousandths."""

_LEAST_SIZE = 1e-30
"""Divisor in the place of zero, in that precision."""

DRAWS = 999
"""Simulated residuals."""

_TAIL = 0.9
"""Quantile of the draws beyond which their tail is taken as exponential."""

LEAST_P = 1e-6
"""Smallest p-value of a channel that is told: farther out nobody knows the tail."""

_WIDEST = 4.0
"""Residuals are cut at so many standard deviations: one stray row is no structure."""

_RUNS = (2, 4, 8, 16, 32, 64, 128)
"""Neighbours whose residuals are added up: a smooth miss adds up, noise does not."""

_FIRST_LINES = 16
"""Slowest lines of a periodogram that are compared with one another."""

_LOCAL = (6, 12, 24)
"""Rows of a local block, which multiples of half the shortest are: what sits in one
region shows there first."""

_LEFT_OUT = 12
"""Rows of a group that is left out, at least; blocks of its prediction error are half
as long."""

_BLOCKS_LEFT_OUT = 12
"""Blocks of the prediction error of a large group, at most."""

_FEWEST_SUMS = 4
"""Sums of neighbours whose mean square says something."""

_WITH_NEIGHBOURS = 3
"""Rows of a setting from which one has a neighbour on either side."""

_UNSUPPORTED = 0.02
"""A direction of the fit of which so little remains without a group rests on it alone:
nothing can be predicted there."""

LEVEL = 0.005
"""A p-value below which a remainder is said to be there: noise fails each test once in
200 files, and one of the six in 34 files at most."""


class Adequacy(NamedTuple):
    """p-value of what an explanation leaves, by test; None where the rows have no such
    order. ``passed`` is False where one of them is below :data:`LEVEL`."""

    time: float | None
    slip_order: float | None
    line: float | None
    pure_error: float | None
    local: float | None
    held_out: float | None
    passed: bool


UNTESTED = Adequacy(None, None, None, None, None, None, passed=True)
"""Of a verdict whose remainder was not looked at yet."""

Statistic = Callable[[np.ndarray], np.ndarray]
"""(n, draws) residuals -> (draws,): the larger, the more structure."""


def refused(adequacy: Adequacy) -> list[str]:
    """Names of the tests that are failed, the smallest p-value first."""
    values = {
        name: p
        for name, p in adequacy._asdict().items()
        if name != "passed" and p is not None and p < LEVEL
    }
    return sorted(values, key=lambda name: values[name])


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


def _left_out(group: np.ndarray, unit: np.ndarray) -> Callable | None:
    """Errors of predicting a group from the fit to all other rows: a function of all
    residuals, or None where the fit rests on the group.

    Exact for a linear fit: e_G without G = (1 - H_GG)^-1 e_G, H = ``unit`` unit^T.
    """
    here = unit[group]
    rest = np.eye(here.shape[1]) - here.T @ here
    values, vectors = np.linalg.eigh(rest)
    if values.min() < _UNSUPPORTED:
        return None
    back = here @ (vectors / values) @ vectors.T

    def predicted(parts):
        own = parts[group]
        return own + back.astype(own.dtype) @ (here.T.astype(own.dtype) @ own)

    return predicted


def _regimes(groups: Sequence[np.ndarray], unit: np.ndarray) -> Statistic | None:
    """Mean square of summed prediction errors of the group that is predicted worst.

    Args:
        groups: rows to leave out together, each in the order of the slip.
        unit: (n, p) orthonormal columns of the fit.
    """
    predictions = [(len(g), _left_out(g, unit)) for g in groups if len(g) >= _LEFT_OUT]
    able = [(size, predict) for size, predict in predictions if predict is not None]
    if not able:
        return None

    def statistic(parts):
        values = []
        for size, predicted in able:
            length = max(_LEFT_OUT // 2, size // _BLOCKS_LEFT_OUT)
            sums = _sums(predicted(parts), length)
            values.append(_mean_square([sums], len(sums)))
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


class Null(NamedTuple):
    """Noise that went through a fit of all channels together: ``draws`` (m, DRAWS),
    and the orthonormal columns ``unit`` (m, p) of the fit."""

    draws: np.ndarray
    unit: np.ndarray


def null(
    used_up: np.ndarray,
    doubt: np.ndarray,
    parts: Sequence[np.ndarray],
    sizes: Sequence[float],
    memories: Sequence[Sequence[Memory]],
    in_time: Sequence[np.ndarray] | None,
    generator: np.random.Generator,
) -> Null:
    """What the fit leaves of noise alone.

    Args:
        used_up: (m, p) whitened columns of everything that was fitted.
        doubt: (m, k) directions in which the rows may be off together, by independent
            unit normal numbers, beside the noise.
        parts: rows of each channel among the m: index arrays.
        sizes, memories: standard deviation of the noise of each channel, and what its
            memory may be.
        in_time: rows of a channel, in each unbroken stretch in the order of time
            (index arrays); None where the time is not known.
        generator: of the noise.
    """
    unit, _ = np.linalg.qr(used_up)
    noise = np.empty((len(used_up), DRAWS))
    for part, size, memory in zip(parts, sizes, memories, strict=True):
        noise[part] = size * _noise(len(part), memory, in_time, generator)
    noise += doubt @ generator.standard_normal((doubt.shape[1], DRAWS))
    noise, taken = noise.astype(_PRECISION), unit.astype(_PRECISION)
    return Null(noise - taken @ (taken.T @ noise), unit)


def adequacy(
    residual: np.ndarray,
    of_noise: Null,
    in_time: Sequence[np.ndarray] | None,
    in_slip: Sequence[np.ndarray],
    groups: Sequence[np.ndarray],
    orders: Sequence[np.ndarray] = (),
) -> Adequacy:
    """Tests of one channel's residual.

    Args:
        residual: (n,) whitened, of the explanation that is judged.
        of_noise: what :func:`null` says of these n rows.
        in_time: see :func:`null`.
        in_slip: rows of each setting (load, speed, direction) in the order of slip.
        groups: regimes to leave out in turn: rows in the order of slip.
        orders: place of each row in the order of time, rows set aside counted, and in
            others in which a wave may lie; by default the order of time alone.
    """
    settings = [s for s in in_slip if len(s) >= _WITH_NEIGHBOURS]
    observed = residual[:, None].astype(_PRECISION)
    together = _unit(np.concatenate([observed, of_noise.draws], axis=1))

    def p_value(statistic: Statistic | None) -> float | None:
        if statistic is None:
            return None
        observed, *drawn = statistic(together)
        return _p_value(observed, np.array(drawn))

    ordered = [np.arange(0)] if in_time is None else in_time
    timed = (
        in_time is not None and max(len(s) for s in ordered) >= _FEWEST_SUMS * _RUNS[1]
    )
    if not orders or not timed:
        only = ordered if timed else in_slip
        orders = [np.argsort(np.concatenate(only))]
    dense = sum(len(s) for s in settings) >= 0.5 * len(residual)
    longest = max((len(s) for s in settings), default=0)
    tests = {
        "time": _persistence(ordered) if timed else None,
        "slip_order": _persistence([np.concatenate(in_slip)]) if dense else None,
        "line": _lines(orders),
        "pure_error": _pure_error(settings) if dense else None,
        "local": _local(settings) if dense and longest >= _LOCAL[0] else None,
        "held_out": _regimes(groups, of_noise.unit),
    }
    values = {name: p_value(statistic) for name, statistic in tests.items()}
    passed = all(p is None or p >= LEVEL for p in values.values())
    return Adequacy(**values, passed=passed)
