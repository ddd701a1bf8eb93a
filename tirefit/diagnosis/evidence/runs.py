"""Offsets of single runs: how far the logs of a file differ beyond their noise."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from tirefit.diagnosis.effects.per_run import OFFSETS, RELATIVE
from tirefit.diagnosis.evidence.forms import PLACE
from tirefit.diagnosis.negligible import NONZERO
from tirefit.diagnosis.rows.basis import without
from tirefit.diagnosis.rows.rates import shown_runs
from tirefit.padding import pad_rows

_STEPS, _NINETY = 400, 1.353
"""Spreads that are tried, from none to three times the range of the runs; and the fall
of the log likelihood at the ends of a 90 % interval of one parameter."""

_UNKNOWN = 1e6
"""Error of a run's offset, in those of the best known one, that says nothing."""


class Shrunk(NamedTuple):
    """Runs as draws from one law: its ``common`` value with ``std``, the ``spread``
    between runs with its 90 % interval, ``p_value`` of no spread, and each run's own
    value and standard error, shrunk towards the common one, (R,) each."""

    common: float
    std: float
    spread: float
    spread_ci: tuple[float, float]
    p_value: float
    values: np.ndarray
    errors: np.ndarray


class RunOffsets(NamedTuple):
    """One kind of offset over the runs of a file, in its own unit: :class:`Shrunk`,
    with (value, standard error) of each run by its name."""

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
    tried = np.linspace(0.0, 3 * max(np.ptp(values), NONZERO), _STEPS)
    # In the axes of the errors the values are independent: (spreads, R).
    sharp = 1 / np.maximum(error + tried[:, None] ** 2, NONZERO)
    weight = sharp @ one**2
    common = sharp @ (one * along) / weight
    off = along - common[:, None] * one
    square = np.sum(sharp * off**2, axis=1)
    logs = 0.5 * (np.sum(np.log(sharp), axis=1) - np.log(weight) - square)
    best = int(np.argmax(logs))
    inside = tried[logs > logs[best] - _NINETY]
    far = tried[best] ** 2 * sharp[best]
    own = common[best] + axes @ (far * off[best])
    # The common value is no better known than the runs tell of it.
    pull = 1 - axes @ (far * one)
    errors = np.sqrt(axes**2 @ (far * error) + pull**2 / weight[best])
    return Shrunk(
        float(common[best]), float(weight[best] ** -0.5), float(tried[best]),
        (float(inside[0]), float(inside[-1])),
        float(chdtrc(len(own) - 1, square[0])), own, errors,
    )  # fmt: skip


def _estimates(base, kind: str, hypothesis=None):
    """Each run's own offset beside the rest of a hypothesis, None for the base fit, to
    first order.

    Returns:
        (codes, values (R,), covariance (R, R)) in the units of the field; None where
        fewer than two runs are long enough, or nothing tells them apart.
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
        there = _already(base, kind, {ids[k]: amplitudes[k] for k in atoms})
    run, field = np.tile(rows.run, len(rows.channels)), PLACE[offset.field]
    slope = linear.fields[:, field]
    if offset.unit == RELATIVE:
        slope = slope * np.tile(np.exp(there), len(rows.channels))
    own = np.stack([np.where(run == code, slope, 0.0) for code in codes], axis=1)
    left = without(own, used_up)
    value, vector = np.linalg.eigh(left.T @ left)
    if value[-1] <= 0:
        return None
    inverse = (vector / np.maximum(value, value[-1] / _UNKNOWN)) @ vector.T
    first = [int(np.argmax(rows.run == code)) for code in codes]
    own = inverse @ (left.T @ linear.residual) + there[first]
    if offset.unit == RELATIVE:
        # What the runs have in common is the tire's own parameter.
        one = np.full((len(codes), len(codes)), 1 / len(codes))
        own = own - own.mean()
        inverse = inverse - one @ inverse - inverse @ one + one @ inverse @ one
        inverse = inverse + one * np.trace(inverse) / max(len(codes) - 1, 1)
    # What a few large residuals would do to the error, every row does here.
    return codes, own, max(level.inflation for level in base.noise.values()) * inverse


def _already(base, kind: str, amplitudes: Mapping[str, float]) -> np.ndarray:
    """The offset of every row that a hypothesis has of this kind: (n,)."""
    offset = OFFSETS[kind]
    own = np.asarray(getattr(base.design.rows, offset.pattern))[: base.rows.n]
    there = amplitudes.get(kind, 0.0) + amplitudes.get(f"{kind}_run", 0.0) * own
    if offset.of_load:
        there = there * 1e-3 * base.rows.covariates.load
    return np.broadcast_to(there, base.rows.n)


def offsets_of_runs(base, hypothesis) -> dict[str, RunOffsets]:
    """How the runs differ beside a hypothesis, by kind; empty for a single run."""
    offsets = {}
    for kind, offset in OFFSETS.items():
        if (seen := _estimates(base, kind, hypothesis)) is not None:
            law = shrunk(*seen[1:])
            names = [base.rows.data.runs[code] for code in seen[0]]
            own = zip(law.values.tolist(), law.errors.tolist(), strict=True)
            offsets[kind] = RunOffsets(
                offset.unit, law.common, law.std, law.spread, law.spread_ci,
                law.p_value, dict(zip(names, own, strict=True)),
            )  # fmt: skip
    return offsets


def _pattern(base, kind: str) -> np.ndarray:
    """How the runs differ, less what is common, of unit rms over the rows: (n,); zero
    where they do not."""
    pattern, seen = np.zeros(base.rows.n), _estimates(base, kind)
    if seen is None or (law := shrunk(*seen[1:])).spread == 0:
        return pattern
    for code, value in zip(seen[0], law.values, strict=True):
        pattern[base.rows.run == code] = value
    pattern -= pattern.mean()
    size = np.sqrt(np.mean(pattern**2))
    return pattern / size if size > 0 else pattern


def with_runs(base):
    """The same base with how its runs differ, where there are several."""
    if "runs" not in base.rows.has:
        return base
    size, rows = len(base.design.keep), base.design.rows
    patterns = {
        offset.pattern: pad_rows(_pattern(base, kind), size)
        for kind, offset in OFFSETS.items()
    }
    return base.on(base.design._replace(rows=rows._replace(**patterns)))
