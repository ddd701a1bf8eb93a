"""Offsets of single runs: how far the logs of a file differ beyond their noise."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from tirefit.diagnosis.effects.per_run import OFFSETS, RELATIVE
from tirefit.diagnosis.evidence.forms import PLACE
from tirefit.diagnosis.rows.basis import without
from tirefit.diagnosis.rows.rates import shown_runs
from tirefit.padding import pad_rows

KINDS = tuple(OFFSETS)
"""What may be each run's own: ids of effects less ``_run``."""

_STEPS = 400
"""Spreads that are tried, from none to three times the range of the runs."""

_NINETY = 1.353
"""Fall of the log likelihood at the ends of a 90 % interval of one parameter."""

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
    """One kind of offset over the runs of a file, in its own unit.

    ``values`` are each run's own with its standard error, by the run's name.
    """

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
    values, ones = np.asarray(values, float), np.ones(len(values))
    tried = np.linspace(0.0, 3 * max(np.ptp(values), 1e-300), _STEPS)

    def at(spread):
        inverse = np.linalg.pinv(covariance + spread**2 * np.eye(len(values)))
        weight = float(ones @ inverse @ ones)
        common = float(ones @ inverse @ values) / weight
        off = values - common
        log = np.linalg.slogdet(inverse)[1] - np.log(weight) - off @ inverse @ off
        return 0.5 * log, common, weight, inverse

    logs = np.array([at(spread)[0] for spread in tried])
    best = int(np.argmax(logs))
    spread = float(tried[best])
    inside = tried[logs > logs[best] - _NINETY]
    _, common, weight, inverse = at(spread)
    own = common + spread**2 * inverse @ (values - common)
    kept = np.linalg.pinv(inverse) - spread**2 * np.eye(len(values))
    variance = spread**2 * np.diag(inverse @ kept)
    # The common value is no better known than the runs tell of it.
    pull = 1 - spread**2 * inverse @ ones
    errors = np.sqrt(np.maximum(variance + pull**2 / weight, 0.0))
    _, middle, _, sharp = at(0.0)
    q = float((values - middle) @ sharp @ (values - middle))
    return Shrunk(
        common, weight**-0.5, spread, (float(inside[0]), float(inside[-1])),
        float(chdtrc(len(values) - 1, q)), own, errors,
    )  # fmt: skip


def estimates(base, kind: str, hypothesis=None):
    """Each run's own offset beside the rest of a hypothesis, to first order.

    Args:
        base: the base fit (:class:`tirefit.diagnosis.evidence.base.Base`).
        kind: of :data:`KINDS`.
        hypothesis: with z, atoms and amplitude; None for the base fit itself.

    Returns:
        (codes, values (R,), covariance (R, R)) in the units of the field; None where
        fewer than two runs are long enough, or nothing tells them apart.
    """
    rows, names = base.rows, base.rows.data.runs
    codes = shown_runs(rows.run, names)
    if len(codes) < 2:
        return None
    linear, used_up = base.at_null, base.at_null.jacobian
    there = np.zeros(rows.n)
    if hypothesis is not None and hypothesis.atoms:
        atoms = list(hypothesis.atoms)
        amplitudes = base.amplitudes(atoms, hypothesis.amplitude)
        linear = base.linearised(hypothesis.z, amplitudes)
        ids = {k: base.atoms[k].effect.id for k in atoms}
        other = [k for k in atoms if ids[k] not in (kind, f"{kind}_run")]
        used_up = np.concatenate([linear.jacobian, linear.columns[:, other]], axis=1)
        there = _already(base, kind, {ids[k]: amplitudes[k] for k in atoms})
    run, offset = np.tile(rows.run, len(rows.channels)), OFFSETS[kind]
    field = linear.fields[:, PLACE[offset.field]]
    if offset.unit == RELATIVE:
        field = field * np.tile(np.exp(there), len(rows.channels))
    own = np.stack([np.where(run == code, field, 0.0) for code in codes], axis=1)
    left = without(own, used_up)
    normal = left.T @ left
    # What a few large residuals would do to the error, every row does here.
    wide = max(noise.inflation for noise in base.noise.values())
    value, vector = np.linalg.eigh(normal)
    if value[-1] <= 0:
        return None
    known = np.maximum(value, value[-1] / _UNKNOWN)
    inverse = (vector / known) @ vector.T
    first = [int(np.argmax(rows.run == code)) for code in codes]
    own = inverse @ (left.T @ linear.residual) + there[first]
    if offset.unit == RELATIVE:
        # What the runs have in common is the tire's own parameter.
        one = np.full((len(codes), len(codes)), 1 / len(codes))
        own = own - own.mean()
        inverse = inverse - one @ inverse - inverse @ one + one @ inverse @ one
        inverse = inverse + one * np.trace(inverse) / max(len(codes) - 1, 1)
    return codes, own, wide * inverse


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
    for kind in KINDS:
        seen = estimates(base, kind, hypothesis)
        if seen is None:
            continue
        codes, values, covariance = seen
        law = shrunk(values, covariance)
        names = [base.rows.data.runs[code] for code in codes]
        own = zip(law.values.tolist(), law.errors.tolist(), strict=True)
        offsets[kind] = RunOffsets(
            OFFSETS[kind].unit, law.common, law.std, law.spread,
            law.spread_ci, law.p_value, dict(zip(names, own, strict=True)),
        )  # fmt: skip
    return offsets


def pattern_of_runs(base, kind: str) -> np.ndarray:
    """How the runs differ, less what is common, of unit rms over the rows: (n,); zero
    where they do not."""
    pattern, seen = np.zeros(base.rows.n), estimates(base, kind)
    if seen is None:
        return pattern
    codes, values, covariance = seen
    law = shrunk(values, covariance)
    if law.spread == 0:
        return pattern
    for code, value in zip(codes, law.values, strict=True):
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
        offset.pattern: pad_rows(pattern_of_runs(base, kind), size)
        for kind, offset in OFFSETS.items()
    }
    rows = rows._replace(**patterns)
    return base.on(base.design._replace(rows=rows))
