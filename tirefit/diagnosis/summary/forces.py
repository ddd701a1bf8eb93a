"""Forces of every row of a file: of the base, with the named effects, and the gap."""

import numpy as np

from tirefit.diagnosis.decide.verdict import Status
from tirefit.diagnosis.evidence.base import Base, on_rows
from tirefit.diagnosis.evidence.posterior import fitted_form, linear_at
from tirefit.diagnosis.evidence.search import Hypothesis, amplitudes_of
from tirefit.diagnosis.rows.basis import located, without
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.diagnosis.summary.case import Case


def rows_of(case: Case, at: Base) -> dict[str, dict[str, np.ndarray]]:
    """Base, extended, located gap and its deviation, canonical, used rows.

    Args:
        at: the base fit at the slips that the forces are wanted for.
    """
    base = case.base
    before = at.forces(base.as_given, base.amplitudes())
    tuned = at.forces(base.z, base.amplitudes()) if base.simulator else {}
    after = at.forces(case.chosen.z, amplitudes_of(base, case.chosen))
    smooth, deviation = _smoothed_remainder(case)
    form = form_part(case, case.chosen)
    forces, n = {}, base.prepared.n
    for k, channel in enumerate(base.prepared.channels):
        scale = np.asarray(base.design.scale[channel])[:n]
        part = slice(k * n, (k + 1) * n)
        forces[channel] = {
            "base": before[channel],
            "extended": after[channel] + form[part] * scale,
            "gap": after[channel] - before[channel] + (form + smooth)[part] * scale,
            "gap_std": deviation[part] * scale,
        }
        if base.simulator:
            forces[channel] |= {"sim": before[channel], "tuned": tuned[channel]}
    return forces


def form_part(case: Case, hypothesis: Hypothesis) -> np.ndarray:
    """What another form of its effects adds to their formulas, whitened (m,)."""
    base, key = case.base, tuple(sorted(hypothesis.effects))
    if key not in case.weighed.other_form:
        return np.zeros(len(base.prepared.channels) * base.prepared.n)
    return fitted_form(linear_at(base, hypothesis))


def _smoothed_remainder(case: Case):
    """Whitened generic remainder of the chosen fit and the deviation of the located
    gap, (m,) each; no remainder where a verdict explains all."""
    base, chosen = case.base, case.chosen
    residual, jacobian, tangent, _ = base.linearised(
        chosen.z, amplitudes_of(base, chosen)
    )
    own = tangent[:, list(chosen.atoms)]
    lone = without(own, jacobian)
    p = len(chosen.z)
    variance = np.einsum("mi,ij,mj->m", lone, chosen.covariance[p:, p:], lone)
    if base.simulator:  # its gap has the parameters in it
        moved = np.concatenate([jacobian, own], axis=1)
        variance = np.einsum("mi,ij,mj->m", moved, chosen.covariance, moved)
    if case.verdict.status in (Status.NAMED, Status.CANNOT_TELL):
        return np.zeros(len(residual)), np.sqrt(np.maximum(variance, 0))
    used_up = np.concatenate([jacobian, own], axis=1)
    smooth, unsure = located(base.generic, used_up, residual)
    return smooth, np.sqrt(np.maximum(variance + unsure, 0))


def all_rows(case: Case, whole: Prepared, rig, rows):
    """The rows of the whole file, NaN where masked: {channel: {name: (n,)}}."""
    data = whole.data
    spread_out: dict[str, dict[str, np.ndarray]] = {}
    if case.base.prepared.n < whole.n:
        rows = _on_everything(case, whole, rig, rows)
    for channel, parts in rows.items():
        spread_out[channel] = {}
        for name, values in parts.items():
            full = np.full(len(data), np.nan)
            full[data.used] = values
            spread_out[channel][name] = full
    return spread_out


def _on_everything(case: Case, prepared: Prepared, rig, rows):
    """Forces of both fits on every row; the located gap between the thinned rows is
    interpolated in their order."""
    base = case.base
    whole = on_rows(base, prepared, rig).measured
    before = whole.forces(base.as_given, base.amplitudes())
    after = whole.forces(case.chosen.z, amplitudes_of(base, case.chosen))
    kept, every, spread_out = base.prepared.kept, np.arange(prepared.n), {}
    for channel, parts in rows.items():
        rest = parts["gap"] - (parts["extended"] - parts["base"])
        gap = after[channel] - before[channel] + np.interp(every, kept, rest)
        spread_out[channel] = {
            "base": before[channel], "extended": after[channel], "gap": gap,
            "gap_std": np.interp(every, kept, parts["gap_std"]),
        }  # fmt: skip
        if base.simulator:
            tuned = whole.forces(base.z, base.amplitudes())[channel]
            spread_out[channel] |= {"sim": before[channel], "tuned": tuned}
    return spread_out
