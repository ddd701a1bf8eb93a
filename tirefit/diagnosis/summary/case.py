"""The state of a diagnosis after its verdict, and the forces of every row of the file: of
the base, with the named effects, and the located gap."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Self, cast

import numpy as np
from scipy.special import softmax

from tirefit.diagnosis.effects import NOISE_EFFECTS, Atom
from tirefit.diagnosis.engine import NONZERO, UNSEEN
from tirefit.diagnosis.engine.decide import (
    POLICY,
    Status,
    Verdict,
    decide,
    findings_of,
    floor_of,
    predictions,
)
from tirefit.diagnosis.engine.discrepancy import likeliest_beside
from tirefit.diagnosis.engine.fit import Fit, Key, without
from tirefit.diagnosis.engine.left_out import Ladder, Predicted, jackknife_error, ladder_of
from tirefit.diagnosis.engine.search import Search, Weighed
from tirefit.diagnosis.rows.fits import refit_base
from tirefit.diagnosis.rows.noise import correlation
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.diagnosis.rows.rig import Rig
from tirefit.diagnosis.rows.subject import Base, on_rows
from tirefit.padding import pad_rows

Numbers = tuple[np.ndarray, np.ndarray]
"""Parameters z (p,), and amplitudes (K,) of all effects in prior scales."""


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

    @property
    def chosen(self) -> Fit:
        """The fit of the named effects, or of none."""
        return self.weighed.best_of[self.verdict.key]

    @cached_property
    def parts(self) -> dict[Key, float]:
        """Probability of each set that these data do not rule out: effects that help are causes
        with their own probabilities, and a twin may be there in the place of each. A size and a
        parameter are averages over these fits: an effect that only acts like a cause may have
        taken a part of either."""
        each, weighed = self.verdict.each, self.weighed
        stands_for = {name: e for e, x in each.items() for name in (e, *x.twins)}
        sets: dict[frozenset[str | None], list[Key]] = {}
        for key in weighed.best_of:
            claim = frozenset(stands_for.get(effect) for effect in key)
            if None not in claim and len(claim) == len(key):
                sets.setdefault(claim, []).append(key)
        chances_of: dict[Key, float] = {}
        for claim, keys in sets.items():
            chances = (p.probability if e in claim else 1 - p.probability for e, p in each.items())
            shares = softmax([weighed.log_weight[key] for key in keys])
            chances_of |= dict(zip(keys, (math.prod(chances) * shares).tolist(), strict=True))
        whole = max(sum(chances_of.values()), NONZERO)
        return {key: value / whole for key, value in chances_of.items()}

    @cached_property
    def sizes(self) -> tuple[np.ndarray, np.ndarray]:
        """Amplitudes (k,) of the effects that help in prior scales, and their standard errors.

        A cause has the average over the ``parts`` that hold it; an effect that only acts like
        one has the size with which it helps, and the error covers its sizes in the parts. The
        errors are at least those of the jackknife over the data left out.
        """
        sizes = []
        for effect, whole in zip(self.chosen.effects, self.chosen.amplitude, strict=True):
            fits = {k: self.weighed.best_of[k] for k in self.parts if effect in k}
            at = {k: fit.effects.index(effect) for k, fit in fits.items()}
            values = np.array([fit.amplitude[at[k]] for k, fit in fits.items()])
            errors = np.array([fit.errors[at[k]] for k, fit in fits.items()])
            chances = np.array([self.parts[k] for k in fits])
            center = None if effect in self.verdict.effects else whole
            sizes.append(averaged(values, self.widening * errors**2, chances, center))
        value, std = np.reshape(sizes, (-1, 2)).T
        left_out = self.predicted.sets[self.verdict.key]
        return value, np.maximum(std, jackknife_error(left_out.amplitude))

    @cached_property
    def parameters(self) -> tuple[np.ndarray, np.ndarray]:
        """Parameters z (p,) of the base, averaged over the ``parts``, and their standard
        errors: at least those of the jackknife over the data left out."""
        estimates = [self.alone(self.weighed.best_of[key]) for key in self.parts]
        values, variances = (np.array(part) for part in zip(*estimates, strict=True))
        variances = np.maximum(self.widening * variances, 0.0)
        value, std = averaged(values, variances, np.array([*self.parts.values()]))
        return value, np.maximum(std, self._scatter)

    def alone(self, fit: Fit) -> tuple[np.ndarray, np.ndarray]:
        """Parameters z (p,) of a fit, and their variances."""
        return fit.z, np.diag(fit.covariance)[: len(fit.z)]

    @property
    def _scatter(self) -> np.ndarray:
        """Standard errors (p,) of the parameters by the jackknife."""
        return np.asarray(jackknife_error(self.predicted.sets[self.verdict.key].parameters))


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
    def before(self) -> Numbers:
        """Parameters and amplitudes of the base: as given, or as fitted without effects."""
        return self.base.as_given, self.base.amplitudes()

    def numbers_of(self, fit: Fit) -> Numbers:
        """Parameters and amplitudes of a fit."""
        return fit.z, self.base.amplitudes(fit.atoms, fit.amplitude)

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

    def alone(self, fit: Fit) -> tuple[np.ndarray, np.ndarray]:
        """Parameters z (p,) of the base without effects whose forces on these rows are nearest to
        those of a fit with its effects of the tire, and their variances: effects that change the
        same forces, as a carcass in series with a stiffness, leave a parameter beside them open."""
        base, p = self.base, len(fit.z)
        of_tire = np.array([base.atoms[k].effect.of == "tire" for k in fit.atoms])
        if not of_tire.any():
            return super().alone(fit)
        forces = base.forces(fit.z, base.amplitudes(fit.atoms, fit.amplitude * of_tire))
        observed = {c: pad_rows(x, len(base.design.keep)) for c, x in forces.items()}
        design = base.design._replace(observed=observed)
        z = refit_base(base.tire, fit.z, design)
        columns = base.columns_at(fit)
        taken = np.linalg.lstsq(columns[:, :p], columns[:, p:] * of_tire, rcond=UNSEEN)[0]
        slopes = np.hstack([np.eye(p), taken])
        return z, np.einsum("ij,jk,ik->i", slopes, fit.covariance, slopes)

    @property
    def _scatter(self) -> np.ndarray:
        """Those of the set without its effects of the tire, or of none, whichever is smaller: a
        part that is left out may take an effect with it, and the linear step is then too long."""
        out, fit = self.predicted, self.chosen
        atoms = zip(fit.effects, (self.base.atoms[k] for k in fit.atoms), strict=True)
        key = tuple(name for name, atom in atoms if atom.effect.of != "tire")
        sets = [out.sets[k] for k in (key, ()) if k in out.sets]
        return np.min([jackknife_error(one.parameters) for one in sets], axis=0)

    @cached_property
    def natural(self) -> tuple[np.ndarray, np.ndarray]:
        """The ``parameters`` in their own units, and their standard errors."""
        values, (z, spread) = self.base.tire.layout.vector, self.parameters
        return values(z), np.abs(values(z + spread) - values(z - spread)) / 2

    @cached_property
    def widening(self) -> float:
        """Factor on the variance of amplitudes: mean square of the remainder, times its
        rows per independent row; one if the remainder is noise."""
        rows, left = self.base.rows, self.base.residual(*self.numbers_of(self.chosen))
        parts = np.split(left, len(left) // rows.n)
        rows_each = max(correlation(part, rows.time, rows.run) for part in parts)
        return max(float(np.mean(left**2)) * rows_each, 1.0)


def averaged(
    values: np.ndarray, variances: np.ndarray, chances: np.ndarray, center: float | None = None
) -> tuple[Any, Any]:
    """Mean and standard deviation (...) of a mixture of normal estimates.

    Args:
        values, variances: (sets, ...) of each estimate.
        chances: (sets,) weights, of any positive sum.
        center: value from which to measure the deviation; None for the mean.
    """
    chances = chances / max(float(chances.sum()), NONZERO)
    mean = chances @ values if center is None else center
    return mean, np.sqrt(chances @ (variances + (values - mean) ** 2))


def _both(case: Case, at: Base) -> dict[str, dict[str, np.ndarray]]:
    """Forces of the base and of the fit of the verdict by channel, at the slips of ``at``;
    for a simulator, also its forces as given and tuned."""
    base = case.base
    kinds = {"base": case.before, "extended": case.numbers_of(case.chosen)}
    if base.simulator:
        kinds |= {"sim": case.before, "tuned": (base.z, base.amplitudes())}
    forces = {kind: at.forces(*numbers) for kind, numbers in kinds.items()}
    return {c: {kind: of[c] for kind, of in forces.items()} for c in base.rows.channels}


def rows_of(case: Case, at: Base) -> dict[str, dict[str, np.ndarray]]:
    """Base, extended, located gap and its deviation, canonical, used rows.

    Args:
        at: the base fit at the slips that the forces are wanted for.
    """
    base, fit, p, n = case.base, case.chosen, len(case.chosen.z), case.base.rows.n
    columns = base.columns_at(fit)
    # The gap of a simulator includes the error of its parameters; a form that is refitted
    # without the effects takes over what its parameters can represent.
    first = 0 if base.simulator else p
    moved = columns if base.simulator else without(columns[:, p:], columns[:, :p])
    variance = np.einsum("mi,ij,mj->m", moved, fit.covariance[first:, first:], moved)
    smooth = np.zeros(len(variance))  # whitened; zero if the verdict explains all
    if case.verdict.unlisted > POLICY.likely or not case.verdict.key:
        additive = base.discrepancy.additive
        value, root = likeliest_beside(additive, fit)
        # Less the part that parameters and amplitudes take over.
        taken = fit.covariance @ (fit.columns.T @ additive)
        shapes = base.plain_discrepancy.additive - columns @ taken
        smooth = shapes @ value
        variance = variance + np.sum((shapes @ root) ** 2, axis=1)
    deviation, forces = np.sqrt(np.maximum(variance, 0)), _both(case, at)
    for k, (channel, parts) in enumerate(forces.items()):
        scale, part = np.asarray(base.design.scale[channel])[:n], slice(k * n, (k + 1) * n)
        gap = parts["extended"] - parts["base"] + smooth[part] * scale
        parts |= {"gap": gap, "gap_std": deviation[part] * scale}
    return forces


def all_rows(
    case: Case, whole: Prepared, rig: Rig, rows: dict[str, dict[str, np.ndarray]]
) -> dict[str, dict[str, np.ndarray]]:
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

    def spread_out(values: np.ndarray) -> np.ndarray:
        every = np.full(len(data), np.nan)
        every[data.used] = values
        return every

    return {c: {name: spread_out(x) for name, x in parts.items()} for c, parts in rows.items()}
