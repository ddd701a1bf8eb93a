"""The state of a diagnosis after its verdict, and the forces of every row of the file: of
the base, with the named effects, and the located gap."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Self, cast

import numpy as np

from tirefit.diagnosis.effects import NOISE_EFFECTS, Atom
from tirefit.diagnosis.engine import NONZERO
from tirefit.diagnosis.engine.decide import (
    POLICY,
    Status,
    Verdict,
    decide,
    findings_of,
    floor_of,
    predictions,
)
from tirefit.diagnosis.engine.discrepancy import Beside
from tirefit.diagnosis.engine.fit import Fit, Key, without
from tirefit.diagnosis.engine.left_out import Ladder, Predicted, jackknife_error, ladder_of
from tirefit.diagnosis.engine.search import Search, Weighed, parts_of
from tirefit.diagnosis.rows.noise import correlation
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.diagnosis.rows.subject import Base, on_rows


class Untestable(NamedTuple):
    """An effect that these data cannot show, and the data that it needs."""

    effect: str
    needs: tuple[str, ...]


@dataclass(frozen=True)
class Concluded:
    """The state of a diagnosis after its verdict, of any subject."""

    search: Search
    weighed: Weighed
    predicted: Predicted  # data left out, predicted by the leading sets
    verdict: Verdict
    untestable: tuple[Untestable, ...]

    @classmethod
    def of(cls, search: Search, lacks: Mapping[str, Sequence[str]]) -> Self:
        """The state after the verdict on a search.

        Args:
            lacks: effect that cannot be tested -> the data that it needs.
        """
        weighed, out = predictions(search)
        verdict = decide(findings_of(search, weighed, out))
        untestable = tuple(Untestable(name, tuple(needs)) for name, needs in lacks.items())
        return cls(search, weighed, out, verdict, untestable)

    @property
    def base(self) -> Any:
        """The subject."""
        return self.search.subject

    @property
    def on_the_noise(self) -> tuple[str, ...]:
        """The effects on the noise, if no effect on the mean is possible."""
        return ()

    @property
    def widening(self) -> float:
        """Factor on the variance of amplitudes where the remainder is not noise."""
        return 1.0

    @property
    def ladder(self) -> Ladder:
        """The steps from no effect to those that help."""
        return ladder_of(self.predicted, self.verdict.key, floor_of(self.base, self.predicted))

    def formula(self, atom: Atom) -> str:
        """The formula of an effect in words."""
        return atom.formula(None, None)

    def errors(self, fit: Fit) -> np.ndarray:
        """Standard errors (k,) of the amplitudes, in prior scales: at least those of the
        jackknife over the parts left out and, of the set that helps, those of the differences
        between its parts."""
        found = fit.errors * np.sqrt(self.widening)
        if fit.key in self.predicted.effects:
            left_out = self.predicted.amplitude[self.predicted.effects.index(fit.key)]
            found = np.maximum(found, jackknife_error(left_out))
        if fit.key == self.verdict.key:
            found = np.maximum(found, self._between_parts)
        return found

    @property
    def _between_parts(self) -> np.ndarray:
        """Differences (k,) of the amplitudes between the parts of the set that helps, root of
        the mean square by their probability."""
        fit, square = self.chosen, np.zeros(len(self.chosen.atoms))
        total = np.full(len(fit.atoms), NONZERO)
        for key, chance in self.parts.items():
            part = self.weighed.best_of[key]
            for place, effect in enumerate(fit.effects):
                if effect in part.effects:
                    own = part.amplitude[part.effects.index(effect)]
                    square[place] += chance * (own - fit.amplitude[place]) ** 2
                    total[place] += chance
        return np.sqrt(square / total)

    @property
    def chosen(self) -> Fit:
        """The fit of the named effects, or of none."""
        return self.weighed.best_of[self.verdict.key]

    @property
    def parts(self) -> dict[Key, float]:
        """Probability of each part of the set that helps: its effects are causes with their
        own probabilities. A size and a parameter are uncertain by the differences of these
        fits: an effect that only acts like a cause may have taken a part of either."""
        each = {effect: one.probability for effect, one in self.verdict.each.items()}
        found = {}
        for key in [*parts_of(self.verdict.key), ()]:
            if key in self.weighed.best_of:
                chances = (p if effect in key else 1 - p for effect, p in each.items())
                found[key] = math.prod(chances)
        whole = max(sum(found.values()), NONZERO)
        return {key: value / whole for key, value in found.items()}


@dataclass(frozen=True)
class Case(Concluded):
    """The state of the diagnosis of a file of forces after its verdict."""

    @property
    def base(self) -> Base:
        """The rows with their base fit."""
        return cast(Base, self.search.subject)

    def formula(self, atom: Atom) -> str:
        """The formula of an effect, with the values to which its amplitude refers."""
        return atom.formula(self.base.design.rows, self.base.rows.time)

    @property
    def noise_flags(self) -> tuple[str, ...]:
        """The flags of the noise of all channels."""
        levels = self.base.noise.values()
        return tuple(dict.fromkeys(flag for level in levels for flag in level.flags))

    @cached_property
    def on_the_noise(self) -> tuple[str, ...]:
        """The effects on the noise, if no effect on the mean is possible."""
        if self.verdict.status != Status.NONE or self.verdict.also_possible:
            return ()
        of_flag = {effect.flag: effect.id for effect in NOISE_EFFECTS if effect.flag}
        return tuple(of_flag[f] for f in self.noise_flags if f in of_flag)

    @cached_property
    def widening(self) -> float:
        """Factor on the variance of amplitudes: mean square of the remainder, times its
        rows per independent row; one if the remainder is noise."""
        base, fit, n = self.base, self.chosen, self.base.rows.n
        left = base.residual(fit.z, base.amplitudes(fit.atoms, fit.amplitude))
        parts = np.split(left, len(left) // n)
        rows_each = max(correlation(part, base.rows.time, base.rows.run) for part in parts)
        return max(float(np.mean(left**2)) * rows_each, 1.0)


def _both(case: Case, at: Base) -> dict[str, dict[str, np.ndarray]]:
    """Forces of the base and of the fit of the verdict by channel, at the slips of ``at``;
    for a simulator, also its forces as given and tuned."""
    base, fit = case.base, case.chosen
    before = at.forces(base.as_given, base.amplitudes())
    after = at.forces(fit.z, base.amplitudes(fit.atoms, fit.amplitude))
    channels = base.rows.channels
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
    forces, n = _both(case, at), case.base.rows.n
    for k, (channel, parts) in enumerate(forces.items()):
        scale = np.asarray(case.base.design.scale[channel])[:n]
        part = slice(k * n, (k + 1) * n)
        gap = parts["extended"] - parts["base"] + smooth[part] * scale
        parts |= {"gap": gap, "gap_std": deviation[part] * scale}
    return forces


def _smoothed_remainder(case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Whitened smooth remainder of the chosen fit and the standard deviation of the
    located gap, (m,) each; the remainder is zero if the verdict explains all."""
    base, fit, p = case.base, case.chosen, len(case.chosen.z)
    columns = base.columns_at(fit)
    # The gap of a simulator includes the error of its parameters; a form that is refitted
    # without the effects takes over what its parameters can represent.
    first = 0 if base.simulator else p
    moved = columns if base.simulator else without(columns[:, p:], columns[:, :p])
    known = fit.covariance[first:, first:]
    variance = np.einsum("mi,ij,mj->m", moved, known, moved)
    smooth = np.zeros(len(variance))
    if case.verdict.unlisted > POLICY.likely or not case.verdict.key:
        value, root = Beside(base.discrepancy.additive, fit).best()
        shapes = beside(base, fit)
        smooth = shapes @ value
        variance = variance + np.sum((shapes @ root) ** 2, axis=1)
    return smooth, np.sqrt(np.maximum(variance, 0))


def beside(base: Base, fit: Fit) -> np.ndarray:
    """Whitened forces (m, q) of the smooth functions, less the part that the parameters and
    amplitudes of a fit take over."""
    taken = fit.covariance @ (fit.columns.T @ base.discrepancy.additive)
    return base.plain_discrepancy.additive - base.columns_at(fit) @ taken


def all_rows(case: Case, whole: Prepared, rig, rows):
    """The rows of the whole file, NaN where masked: {channel: {name: (n,)}}; between
    thinned rows the located gap is interpolated in their order."""
    data, kept, every = whole.data, case.base.rows.kept, np.arange(whole.n)
    if case.base.rows.n < whole.n:
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
