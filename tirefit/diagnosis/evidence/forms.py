"""Free forms: of a listed effect, of a sudden change, of the error of a stand-in, of a
remainder; and offsets of single runs."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.fft import next_fast_len, rfft
from scipy.linalg import block_diag
from scipy.special import chdtrc

from tirefit.diagnosis.effects.per_run import OFFSETS, RELATIVE
from tirefit.diagnosis.effects.state import State
from tirefit.diagnosis.evidence.forward import Design
from tirefit.diagnosis.negligible import FLAT, NONZERO, UNSEEN
from tirefit.diagnosis.rows import basis, patterns
from tirefit.diagnosis.rows.prepared import Prepared, coincides
from tirefit.diagnosis.rows.slips import shown_runs
from tirefit.padding import pad_rows

PLACE = {name: k for k, name in enumerate(State._fields)}
"""Column of each field of the state in :class:`evidence.forward.Linear`."""

_WIDTHS, _TIMES = (0.004, 0.02, 0.05, 0.1), np.linspace(-0.46, 0.46, 93)
"""Widths and times of a change that are tried, as shares of the record; times are
relative to its middle."""

_LENGTHS = (0.08, 0.12, 0.17, 0.24, 0.34, 0.48)
"""Lengths of a change that ends, in the same unit."""

_AROUND = 4
"""Number of rows on either side for the slope of the error of a stand-in."""

_FINER = 4
"""Oversampling of a periodogram: a wave between two lines loses at most a fiftieth of
its square. A record with as many sampling times for each row is not sampled evenly."""


def form_columns(effects, fields, prepared, slip_fraction) -> np.ndarray:
    """Columns of the free forms of these effects, in units of their priors: (m, k).

    Args:
        effects: records of a hypothesis.
        fields: (m, F) of :class:`tirefit.diagnosis.evidence.forward.Linear`.
        slip_fraction: signed slip over that of full sliding, (n,).
    """
    rows, channels = prepared.covariates, len(prepared.channels)
    blocks = [np.zeros((len(fields), 0))]
    # Effects of one family share their forms, which count once.
    for form in dict.fromkeys(f for effect in effects for f in effect.forms):
        if form.needs and form.needs not in prepared.has:
            continue
        if form.by and follows(getattr(rows, form.by), slip_fraction):
            continue
        shapes = np.tile(form.size * form.shapes(rows, slip_fraction), (channels, 1))
        blocks.append(fields[:, PLACE[form.field], None] * shapes)
    return np.concatenate(blocks, axis=1)


def follows(values, slip_fraction) -> bool:
    """Whether a covariate (n,), such as the load under braking, is a function of the
    slip: 12 bumps over the slip explain nine tenths of its variance."""
    inside = np.clip(slip_fraction, -basis.FULL_SLIDING, basis.FULL_SLIDING)
    shapes = np.column_stack([np.ones(len(values)), basis.bumps(inside, 12)])
    own = basis.without(values - values.mean(), shapes)
    return bool(0 < np.sum(own**2) <= 0.1 * len(values) * np.var(values))


def shape_of_change(time, friction, used_up, residual, blocks) -> np.ndarray:
    """Step or stretch of the friction at the time and of the width that explain most: (n,).

    Args:
        time: (n,) from -1/2 to 1/2.
        friction: (m,) d force / d friction, whitened.
        used_up: (m, p) columns of the other parts of the hypothesis.
        residual: (m,) of the hypothesis without the step.
        blocks: (k, 2) stretches of a setting, see
            :func:`rows.prepared.blocks_of_settings`, which are not tried.
    """
    repeats = len(friction) // len(time)
    residual = basis.without(residual, used_up)
    best, best_gain = np.zeros(len(time)), 0.0
    for width, length in product(_WIDTHS, (None, *_LENGTHS)):
        if length is not None and length < 2 * width:
            continue
        begin = _TIMES[~coincides(_TIMES, _TIMES + (length or np.inf), blocks)]
        shapes = 0.5 * np.tanh((time[:, None] - begin) / width)
        if length is not None:
            shapes -= 0.5 * np.tanh((time[:, None] - begin - length) / width) + 0.5
        columns = friction[:, None] * np.tile(shapes, (repeats, 1))
        columns = basis.without(columns, used_up)
        size = np.sum(columns**2, axis=0)
        gain = (columns.T @ residual) ** 2 / np.maximum(size, FLAT)
        if gain.max() > best_gain:
            best, best_gain = shapes[:, int(np.argmax(gain))], gain.max()
    return best


def not_followed(missed, slip, groups, changed: float) -> np.ndarray:
    """Changes of a simulator beyond those of its stand-in: columns (n, 2), to first
    order. If the stand-in has the error e, friction times 1 + a and stiffness times 1 + b
    add a (e - slip e') + b slip e' to the change of the stand-in.

    Args:
        missed: e, simulated force minus that of the stand-in, (n,).
        groups: index arrays of like rows in the order of their slip.
        changed: typical size of a and b, at least a tenth.
    """
    steep, wide = np.zeros(len(slip)), 2 * _AROUND + 1
    for rows in (rows for rows in groups if len(rows) >= wide):
        x, y = (
            np.lib.stride_tricks.sliding_window_view(np.pad(v, _AROUND, "edge"), wide)
            for v in (slip[rows], missed[rows])
        )
        x, y = (view - view.mean(axis=1, keepdims=True) for view in (x, y))
        steep[rows] = np.sum(x * y, axis=1) / np.maximum(np.sum(x * x, axis=1), NONZERO)
    return max(changed, 0.1) * np.stack([missed, slip * steep], axis=1)


def whitened_generic(
    rows: Prepared, design: Design, slip_fraction, fields: np.ndarray
) -> basis.Generic:
    """Generic functions of a remainder for each channel, whitened (m, b). Arguments are
    those of :func:`form_columns`; each smooth function needs three rows or more."""
    keep, bases = np.asarray(design.keep)[: rows.n, None], []
    for channel in rows.channels:
        typical = rows.inputs.fz / np.asarray(design.scale[channel])[: rows.n]
        smooth = basis.smooth_basis(rows, slip_fraction, typical, rows.n // 3)
        bases.append([b * keep for b in (smooth, basis.wave_basis(rows, typical))])
    smooth, waves = (block_diag(*each) for each in zip(*bases, strict=True))
    by_name = {name: fields[:, PLACE[field]] for name, (field, _) in patterns.PARAMETERS.items()}
    return basis.Generic(smooth, waves, patterns.patterns(rows, slip_fraction, by_name))


def with_fast_waves(among: patterns.Patterns, time, residual) -> patterns.Patterns:
    """The patterns with the strongest faster waves in time, two for each parameter, such
    as mains hum, chatter or a resonance. Each has the probability of one of all fast
    waves. The patterns are unchanged if the sampling shows no faster waves.

    Args:
        time: (n,) of the rows [s].
        residual: (m,) whitened, after the fit.
    """
    slow = next((one for one in among.over if one.covariate == "time"), None)
    moments = np.unique(time)
    if slow is None or len(moments) < 2:
        return among
    low, span = moments[0], moments[-1] - moments[0]
    step = float(np.median(np.diff(moments)))
    places = np.rint((time - low) / step).astype(int)
    count = int(places.max()) + 1
    if count > _FINER * len(time):
        return among
    size = next_fast_len(_FINER * count, real=True)
    cycles = np.arange(size // 2) * span / (step * size)
    there = [span / at for shape, at, _ in slow.listed if shape == "wave"]
    fast = cycles > max(there, default=1.0)
    if not fast.any():
        return among
    weights, chosen = among.weights, set[float]()
    for column in slow.weights.values():
        each = weights[:, :, column] * residual.reshape(len(weights), -1)
        each = np.bincount(places, np.sum(each, axis=0), count)
        power = np.abs(rfft(each, size)[: size // 2]) * fast
        for _ in range(2):
            line = int(np.argmax(power))
            if power[line] <= 0:
                break
            chosen.add(float(cycles[line]))
            power[max(line - 2 * _FINER, 0) : line + 2 * _FINER + 1] = 0.0
    share, counts = (time - low) / span, np.array(sorted(chosen))
    waves = np.concatenate([patterns.turns(share, np.array([c])) for c in counts], axis=1)
    listed = [("wave", span / c, 0.0) for c in counts for _ in range(patterns.PHASES)]
    rare = -np.log(np.count_nonzero(fast) / _FINER * patterns.PHASES)
    prior, drawn = np.full(len(listed), rare), patterns.phased(waves).astype(np.float32)
    more = patterns.Over("time", drawn, listed, prior, slow.weights)
    return replace(among, over=(*among.over, more))


class Shrunk(NamedTuple):
    """Normal law of the runs: its ``common`` value with ``std``, the ``spread`` between
    runs with its 90 % interval, ``p_value`` of no spread, and each run's value and
    standard error, shrunk towards the common one, (R,) each."""

    common: float
    std: float
    spread: float
    spread_ci: tuple[float, float]
    p_value: float
    values: np.ndarray
    errors: np.ndarray


class RunOffsets(NamedTuple):
    """:class:`Shrunk` of one kind of offset, in its unit; ``values`` are (value,
    standard error) by the name of the run."""

    unit: str
    common: float
    std: float
    spread: float
    spread_ci: tuple[float, float]
    p_value: float
    values: Mapping[str, tuple[float, float]]


def shrunk(values, covariance) -> Shrunk:
    """A normal law of the runs' true values, by restricted maximum likelihood.

    Values ~ N(common, covariance + spread^2 I); see DerSimonian and Laird 1986 for the
    model, Morris 1983 for the values that shrink to it.

    Args:
        values: (R,) estimates, two or more.
        covariance: (R, R) of their errors.
    """
    error, axes = np.linalg.eigh(covariance)
    along, one = axes.T @ values, np.sum(axes, axis=0)
    tried = np.linspace(0.0, 3 * max(np.ptp(values), NONZERO), 400)
    # In the principal axes of the errors the values are independent: (spreads, R).
    sharp = 1 / np.maximum(error + tried[:, None] ** 2, NONZERO)
    weight = sharp @ one**2
    common = sharp @ (one * along) / weight
    off = along - common[:, None] * one
    square = np.sum(sharp * off**2, axis=1)
    logs = 0.5 * (np.sum(np.log(sharp), axis=1) - np.log(weight) - square)
    best = int(np.argmax(logs))
    inside = tried[logs > logs[best] - 1.353]  # half of chi-squared at 90 %
    far = tried[best] ** 2 * sharp[best]
    own = common[best] + axes @ (far * off[best])
    pull = 1 - axes @ (far * one)
    errors = np.sqrt(axes**2 @ (far * error) + pull**2 / weight[best])
    return Shrunk(
        float(common[best]),
        float(weight[best] ** -0.5),
        float(tried[best]),
        (float(inside[0]), float(inside[-1])),
        float(chdtrc(len(own) - 1, square[0])),
        own,
        errors,
    )


def _estimates(base, kind: str, hypothesis=None):
    """First-order offset of each run in addition to a hypothesis (None: the base fit).

    Returns:
        (codes, values (R,), covariance (R, R)) in the units of the field; None with
        fewer than two long runs, or without any slope.
    """
    rows, offset = base.rows, OFFSETS[kind]
    codes = shown_runs(rows.run, rows.data.runs)
    if len(codes) < 2:
        return None
    linear, used_up, there = base.at_null, base.at_null.jacobian, np.zeros(rows.n)
    if hypothesis is not None and hypothesis.atoms:
        atoms = list(hypothesis.atoms)
        amplitudes = base.amplitudes(atoms, hypothesis.amplitude)
        linear = base.linearised(hypothesis.z, amplitudes)
        ids = {k: base.atoms[k].effect.id for k in atoms}
        other = [k for k in atoms if ids[k] not in (kind, f"{kind}_run")]
        used_up = np.concatenate([linear.jacobian, linear.columns[:, other]], axis=1)
        # The offset of every row that the hypothesis has of this kind.
        sizes = {ids[k]: amplitudes[k] for k in atoms}
        own = np.asarray(getattr(base.design.rows, offset.pattern))[: rows.n]
        there = sizes.get(kind, 0.0) + sizes.get(f"{kind}_run", 0.0) * own
        if offset.of_load:
            there = there * 1e-3 * rows.covariates.load
    run, field = np.tile(rows.run, len(rows.channels)), PLACE[offset.field]
    slope = linear.fields[:, field]
    if offset.unit == RELATIVE:
        slope = slope * np.tile(np.exp(there), len(rows.channels))
    own = np.stack([np.where(run == code, slope, 0.0) for code in codes], axis=1)
    left = basis.without(own, used_up)
    value, vector = np.linalg.eigh(left.T @ left)
    if value[-1] <= 0:
        return None
    inverse = (vector / np.maximum(value, value[-1] * UNSEEN)) @ vector.T
    first = [int(np.argmax(rows.run == code)) for code in codes]
    own = inverse @ (left.T @ linear.residual) + there[first]
    if offset.unit == RELATIVE:
        # The common offset of the runs belongs to the parameter of the tire.
        one = np.full((len(codes), len(codes)), 1 / len(codes))
        own = own - own.mean()
        inverse = inverse - one @ inverse - inverse @ one + one @ inverse @ one
        inverse = inverse + one * np.trace(inverse) / max(len(codes) - 1, 1)
    return codes, own, max(level.inflation for level in base.noise.values()) * inverse


def offsets_of_runs(base, hypothesis) -> dict[str, RunOffsets]:
    """Differences of the runs in addition to a hypothesis, by kind; empty for one run."""
    offsets = {}
    for kind, offset in OFFSETS.items():
        if (seen := _estimates(base, kind, hypothesis)) is not None:
            law = shrunk(*seen[1:])
            names = [base.rows.data.runs[code] for code in seen[0]]
            own = zip(law.values.tolist(), law.errors.tolist(), strict=True)
            by_name = dict(zip(names, own, strict=True))
            offsets[kind] = RunOffsets(offset.unit, *law[:5], by_name)
    return offsets


def _pattern(base, kind: str) -> np.ndarray:
    """Offsets of the runs minus their mean, scaled to unit rms over the rows: (n,)."""
    pattern, seen = np.zeros(base.rows.n), _estimates(base, kind)
    if seen is None or (law := shrunk(*seen[1:])).spread == 0:
        return pattern
    for code, value in zip(seen[0], law.values, strict=True):
        pattern[base.rows.run == code] = value
    pattern -= pattern.mean()
    size = np.sqrt(np.mean(pattern**2))
    return pattern / size if size > 0 else pattern


def with_runs(base):
    """The base with the patterns of the offsets of its runs, if there are several."""
    if "runs" not in base.rows.has:
        return base
    size, rows = len(base.design.keep), base.design.rows
    differences = {
        offset.pattern: pad_rows(_pattern(base, kind), size) for kind, offset in OFFSETS.items()
    }
    return base.on(base.design._replace(rows=rows._replace(**differences)))
