"""The state of a diagnosis after its verdict, and the forces of every row of the file: of
the base, with the named effects, and the located gap."""

from dataclasses import dataclass

import numpy as np

from tirefit.diagnosis.decide.verdict import Status, Verdict
from tirefit.diagnosis.effects import NOISE_EFFECTS
from tirefit.diagnosis.evidence.base import Base, on_rows
from tirefit.diagnosis.evidence.posterior import Weighed, fitted_form, linear_at
from tirefit.diagnosis.evidence.search import Hypothesis, Search, amplitudes_of
from tirefit.diagnosis.left_out import Predicted
from tirefit.diagnosis.rows.basis import located, without
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.diagnosis.summary.records import Untestable


@dataclass(frozen=True)
class Case:
    """The state of the diagnosis of a file after its verdict."""

    base: Base
    search: Search
    weighed: Weighed
    predicted: Predicted  # data left out, predicted by the leading sets
    verdict: Verdict
    untestable: list[Untestable]

    @property
    def chosen(self) -> Hypothesis:
        """The fit of the named effects, or of none."""
        return self.weighed.best_of[self.verdict.key]

    @property
    def noise_flags(self) -> tuple[str, ...]:
        """The flags of the noise of all channels."""
        levels = self.base.noise.values()
        return tuple(dict.fromkeys(flag for level in levels for flag in level.flags))

    @property
    def on_the_noise(self) -> tuple[str, ...]:
        """The effects on the noise, if no effect on the mean is possible."""
        if self.verdict.status != Status.NONE or self.verdict.also_possible:
            return ()
        of_flag = {effect.flag: effect.id for effect in NOISE_EFFECTS if effect.flag}
        return tuple(of_flag[f] for f in self.noise_flags if f in of_flag)


def _both(case: Case, at: Base) -> dict[str, dict[str, np.ndarray]]:
    """Forces of the base and of the fit of the verdict by channel, at the slips of ``at``;
    for a simulator, also its forces as given and tuned."""
    base = case.base
    before = at.forces(base.as_given, base.amplitudes())
    after = at.forces(case.chosen.z, amplitudes_of(base, case.chosen))
    channels = base.prepared.channels
    forces = {c: {"base": before[c], "extended": after[c]} for c in channels}
    if base.simulator:
        tuned = at.forces(base.z, base.amplitudes())
        for channel in channels:
            forces[channel] |= {"sim": before[channel], "tuned": tuned[channel]}
    return forces


def rows_of(case: Case, at: Base) -> dict[str, dict[str, np.ndarray]]:
    """Base, extended, located gap and its deviation, canonical, used rows.

    Args:
        at: the base fit at the slips that the forces are wanted for.
    """
    smooth, deviation = _smoothed_remainder(case)
    form, n = form_part(case, case.chosen), case.base.prepared.n
    forces = _both(case, at)
    for k, (channel, parts) in enumerate(forces.items()):
        scale = np.asarray(case.base.design.scale[channel])[:n]
        part = slice(k * n, (k + 1) * n)
        gap = parts["extended"] - parts["base"] + (form + smooth)[part] * scale
        parts["extended"] = parts["extended"] + form[part] * scale
        parts |= {"gap": gap, "gap_std": deviation[part] * scale}
    return forces


def form_part(case: Case, hypothesis: Hypothesis) -> np.ndarray:
    """The force that another form of the effects adds to the formulas, whitened (m,)."""
    base, key = case.base, tuple(sorted(hypothesis.effects))
    if key not in case.weighed.other_form:
        return np.zeros(len(base.prepared.channels) * base.prepared.n)
    return fitted_form(linear_at(base, hypothesis))


def _smoothed_remainder(case: Case):
    """Whitened generic remainder of the chosen fit and the standard deviation of the
    located gap, (m,) each; the remainder is zero if the verdict explains all."""
    base, chosen, p = case.base, case.chosen, len(case.chosen.z)
    linear = base.linearised(chosen.z, amplitudes_of(base, chosen))
    own = linear.columns[:, list(chosen.atoms)]
    used_up = np.concatenate([linear.jacobian, own], axis=1)
    # The gap of a simulator includes the error of its parameters.
    moved = used_up if base.simulator else without(own, linear.jacobian)
    known = chosen.covariance if base.simulator else chosen.covariance[p:, p:]
    variance = np.einsum("mi,ij,mj->m", moved, known, moved)
    smooth = np.zeros(len(variance))
    if case.verdict.status not in (Status.NAMED, Status.CANNOT_TELL):
        smooth, unsure = located(base.generic, used_up, linear.residual)
        variance = variance + unsure
    return smooth, np.sqrt(np.maximum(variance, 0))


def all_rows(case: Case, whole: Prepared, rig, rows):
    """The rows of the whole file, NaN where masked: {channel: {name: (n,)}}; between
    thinned rows the located gap is interpolated in their order."""
    data, kept, every = whole.data, case.base.prepared.kept, np.arange(whole.n)
    if case.base.prepared.n < whole.n:
        forces = _both(case, on_rows(case.base, whole, rig).measured)
        for channel, parts in forces.items():
            few = rows[channel]
            rest = np.interp(every, kept, few["gap"] - few["extended"] + few["base"])
            parts["gap"] = parts["extended"] - parts["base"] + rest
            parts["gap_std"] = np.interp(every, kept, few["gap_std"])
        rows = forces
    spread_out: dict[str, dict[str, np.ndarray]] = {}
    for channel, parts in rows.items():
        spread_out[channel] = {name: np.full(len(data), np.nan) for name in parts}
        for name, values in parts.items():
            spread_out[channel][name][data.used] = values
    return spread_out
