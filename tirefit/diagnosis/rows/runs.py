"""Differences between the runs of a file: offsets of slip and force, factors on friction and
stiffness; and the parts of a file that are left out in turn."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtrc

from tirefit.data.rig.levels import levels
from tirefit.diagnosis.effects.measurement import RELATIVE, RUN_OFFSETS
from tirefit.diagnosis.effects.record import PER_MILLE
from tirefit.diagnosis.engine import NONZERO, UNSEEN
from tirefit.diagnosis.engine.fit import Fit, Folds, without
from tirefit.diagnosis.rows.discrepancy import PLACE
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.diagnosis.rows.slips import shown_runs
from tirefit.padding import pad_rows


class RunOffsets(NamedTuple):
    """Normal law of one kind of offset of the runs, in its unit: the ``common`` value with
    ``std``, the ``spread`` between runs with its 90 % interval, ``p_value`` of no spread, and
    (value, standard error) by the name of the run, shrunk towards the common value."""

    unit: str
    common: float
    std: float
    spread: float
    spread_ci: tuple[float, float]
    p_value: float
    values: Mapping[str, tuple[float, float]]


def shrunk(
    values: np.ndarray, covariance: np.ndarray, names: Sequence[str], unit: str = ""
) -> RunOffsets:
    """A normal law of the runs' true values, by restricted maximum likelihood.

    Values ~ N(common, covariance + spread^2 I); see DerSimonian and Laird 1986 for the
    model, Morris 1983 for the values that shrink to it.

    Args:
        values: (R,) estimates, two or more.
        covariance: (R, R) of their errors.
        names: of the runs; unit: of the values.
    """
    error, axes = np.linalg.eigh(covariance)
    along, ones = axes.T @ values, np.sum(axes, axis=0)
    tried = np.linspace(0.0, 3 * max(np.ptp(values), NONZERO), 400)
    # In the principal axes of the errors the values are independent: (spreads, R).
    sharp = 1 / np.maximum(error + tried[:, None] ** 2, NONZERO)
    weight = sharp @ ones**2
    common = sharp @ (ones * along) / weight
    off = along - common[:, None] * ones
    square = np.sum(sharp * off**2, axis=1)
    logs = 0.5 * (np.sum(np.log(sharp), axis=1) - np.log(weight) - square)
    best = int(np.argmax(logs))
    inside = tried[logs > logs[best] - 1.353]  # half of chi-squared at 90 %
    trust = tried[best] ** 2 * sharp[best]
    pull = 1 - axes @ (trust * ones)
    errors = np.sqrt(axes**2 @ (trust * error) + pull**2 / weight[best])
    each = zip((common[best] + axes @ (trust * off[best])).tolist(), errors.tolist(), strict=True)
    return RunOffsets(
        unit=unit,
        common=float(common[best]),
        std=float(weight[best] ** -0.5),
        spread=float(tried[best]),
        spread_ci=(float(inside[0]), float(inside[-1])),
        p_value=float(chdtrc(len(off[best]) - 1, square[0])),
        values=dict(zip(names, each, strict=True)),
    )


def _law_of(base: Any, kind: str, hypothesis: Fit | None = None) -> RunOffsets | None:
    """The law of the first-order offsets of the runs in addition to a hypothesis (None: the base
    fit); None with fewer than two long runs, or without any slope."""
    rows, offset = base.rows, RUN_OFFSETS[kind]
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
        pattern = np.asarray(getattr(base.design.rows, offset.pattern))[: rows.n]
        there = sizes.get(kind, 0.0) + sizes.get(f"{kind}_run", 0.0) * pattern
        if offset.of_load:
            there = there * PER_MILLE * rows.covariates.load
    run, field = np.tile(rows.run, len(rows.channels)), PLACE[offset.field]
    slope = linear.fields[:, field]
    if offset.unit == RELATIVE:
        slope = slope * np.tile(np.exp(there), len(rows.channels))
    columns = np.stack([np.where(run == code, slope, 0.0) for code in codes], axis=1)
    left = without(columns, used_up)
    value, vector = np.linalg.eigh(left.T @ left)
    if value[-1] <= 0:
        return None
    inverse = (vector / np.maximum(value, value[-1] * UNSEEN)) @ vector.T
    first = [int(np.argmax(rows.run == code)) for code in codes]
    values = inverse @ (left.T @ linear.residual) + there[first]
    if offset.unit == RELATIVE:
        # The common offset of the runs belongs to the parameter of the tire.
        mean = np.full((len(codes), len(codes)), 1 / len(codes))
        values = values - values.mean()
        inverse = inverse - mean @ inverse - inverse @ mean + mean @ inverse @ mean
        inverse = inverse + mean * np.trace(inverse) / max(len(codes) - 1, 1)
    names = [rows.data.runs[code] for code in codes]
    return shrunk(values, base.inflation * inverse, names, offset.unit)


def offsets_of_runs(base: Any, hypothesis: Fit) -> dict[str, RunOffsets]:
    """Differences of the runs in addition to a hypothesis, by kind; empty for one run."""
    laws = {kind: _law_of(base, kind, hypothesis) for kind in RUN_OFFSETS}
    return {kind: law for kind, law in laws.items() if law is not None}


def with_runs(base: Any) -> Any:
    """The base with the patterns of the offsets of its runs, if there are several: minus their
    mean, scaled to unit rms over the rows."""
    if "runs" not in base.rows.has:
        return base
    patterns, rows = {}, base.design.rows
    for kind, offset in RUN_OFFSETS.items():
        pattern, law = np.zeros(base.rows.n), _law_of(base, kind)
        if law is None:
            continue
        if law.spread:
            for name, (value, _) in law.values.items():
                pattern[base.rows.run == base.rows.data.runs.index(name)] = value
            pattern -= pattern.mean()
            pattern /= np.sqrt(np.mean(pattern**2)) or 1.0
        patterns[offset.pattern] = pad_rows(pattern, len(base.design.keep))
    return base.on(base.design._replace(rows=rows._replace(**patterns)))


def folds_of(prepared: Prepared, rows_each: float, across_runs: bool = True) -> Folds:
    """The partition of the used rows: whole runs if there are four or more, else blocks of
    time, else settings and parts of the slip.

    Args:
        rows_each: rows per independent row of the noise; a block of time holds several
            times as many.
        across_runs: whether runs may be left out; an effect that belongs to one run
            cannot be predicted from the others.
    """
    runs = shown_runs(prepared.run, prepared.data.runs)
    # Three measured circles, two to one side, do not show a slip offset that four logs show at 14
    # standard errors.
    if across_runs and len(runs) >= 4:
        code = np.full(prepared.n, -1)
        for number, run in enumerate(runs):
            code[prepared.run == run] = number
        return Folds(code, f"{len(runs)} runs left out in turn")
    least = 12  # rows of a part; at most eight parts
    count = max(min(8, int(prepared.n // max(least, 4 * rows_each))), 2)
    if prepared.time is not None and np.ptp(prepared.time) and not prepared.random_order:
        # Order runs by name, as their codes follow the order of the rows.
        place = np.argsort(np.argsort(prepared.data.runs))
        code = _in_parts(np.lexsort((prepared.time, place[prepared.run])), count)
        return Folds(code, f"{count} blocks of time left out in turn")
    settings = [levels(prepared.inputs.fz), levels(prepared.covariates.v)]
    each = [setting.code for setting in settings if setting.few()]
    if each:
        _, code, sizes = np.unique(each, axis=1, return_inverse=True, return_counts=True)
        if len(sizes) > 2 and sizes.min() >= least:
            return Folds(code, f"{len(sizes)} settings of load and speed left out in turn")
    parts = _in_parts(np.argsort(prepared.slip, kind="stable"), 2 * count) % count
    return Folds(parts, f"{count} parts of the slip range left out in turn")


def _in_parts(order: np.ndarray, count: int) -> np.ndarray:
    """Part (n,) of each row of an order, of equal numbers of rows."""
    code = np.empty(len(order), int)
    code[order] = np.arange(len(order)) * count // len(order)
    return code
