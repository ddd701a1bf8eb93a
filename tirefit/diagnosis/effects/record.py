"""What an effect is: one record that carries everything of its own."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from tirefit.diagnosis.effects.free_forms import Form
from tirefit.diagnosis.effects.state import Covariates, State

PER_MILLE = 1e-3
"""Amplitudes of a force are in thousandths of the typical load: one prior for every
tire."""

LEAST_FACTOR = 0.05
"""Friction or stiffness over its usual value, at least: a law that falls in a straight
line would cross zero at amplitudes that a search tries."""

SHARE = (-1.9, 1.9)
"""A friction or a stiffness that changes by a share between its ends stays positive at
both where the share stays below two."""

SYMBOLS = {"friction": "mu", "stiffness": "c_p a^2"}
"""Field of the state that is multiplied -> what formulas call it."""

Change = Callable[[State, float, Array | tuple[float, ...], Covariates], State]


class Prior(NamedTuple):
    """What is believed of one amplitude beforehand, in its own unit: a Gaussian of
    ``scale`` about ``center`` within ``low`` and ``high``."""

    scale: float
    center: float
    low: float
    high: float

    def times(self, size: float) -> "Prior":
        """The same in shares of a size of the file."""
        return Prior(*(size * part for part in self))


# JAX hashes the library at every call: by identity, not field by field.
@dataclass(frozen=True, kw_only=True, eq=False)
class Effect:
    """One effect that a model may lack.

    Attributes:
        id: its name in every output.
        family: which parameter varies with which quantity.
        change: (state, amplitude, constants, covariates) -> state; amplitude 0
            changes nothing.
        scale: standard deviation of the amplitude that is expected beforehand, a
            judgement: twice as wide lowers the log evidence of an effect that is there
            for sure by log 2, where 3 and more decide.
        per: field of :class:`rows.covariates.Sizes` in shares of which
            ``scale``, ``center`` and ``bounds`` are: one for all variants or one for
            each.
        unit: unit of the amplitude.
        formula: what it does, for the report.
        means: the same in words.
        remedy: what to do once it is named.
        parameter: what the amplitude is called.
        bounds: amplitudes that physics allows, one pair for all variants or one for
            each; twenty scales or so where it allows any.
        center: expected amplitude; not zero for mistakes of a known size.
        prior: (prior, prepared rows, rig) -> prior, where the data or the rig say more
            of the amplitude than ``scale``, ``center`` and ``bounds``.
        odds: prepared rows -> what they add to the log odds of the effect before any
            force is looked at.
        needs: columns or properties of the data without which it cannot be seen.
        channels: forces that it can change; empty is all.
        variants: the constants of each formula that is tried (other times, other
            speeds); all of one length.
        which: (constants, covariates (n,), time (n,) [s] or None) -> in words which
            formula a variant is, with the values without which its amplitude says
            little.
        doubts: (amplitude, prepared rows) -> why no such effect is as large, in words;
            empty where it may be.
        forms: other shapes in which the same parameter may vary with the same quantity.
        during: (constants) -> begin and end of what a variant changes, in shares of the
            record about its middle, where it acts for a stretch of it: a setting that
            was held for just as long would do the same, and the variant is not tried.
        scans_time: its variants are the times of a sudden change; once one is likely
            the shape of that change is fitted.
        singular: its tangent at zero vanishes; it is always refitted.
        looks_like: ids that it is easily taken for.
        told_apart_by: what measurement separates it from them.
    """

    id: str
    family: str
    change: Change
    scale: float
    unit: str = "-"
    formula: str
    means: str = ""
    remedy: str = ""
    parameter: str = "amplitude"
    per: tuple[str, ...] = ("plain",)
    bounds: tuple[tuple[float, float], ...] = ((-float("inf"), float("inf")),)
    center: float = 0.0
    prior: Callable[[Prior, object, object], Prior] | None = None
    odds: Callable[[object], float] | None = None
    needs: tuple[str, ...] = ()
    channels: tuple[str, ...] = ()
    variants: tuple[tuple[float, ...], ...] = ((),)
    which: Callable[[tuple[float, ...], Covariates, object], str] | None = None
    doubts: Callable[[float, object], str] | None = None
    forms: tuple[Form, ...] = ()
    during: Callable[[tuple[float, ...]], tuple[float, float]] | None = None
    scans_time: bool = False
    singular: bool = False
    looks_like: tuple[str, ...] = ()
    told_apart_by: str = ""

    @property
    def sign(self) -> int:
        """+1 or -1 where only that sign is physical for every variant, 0 otherwise."""
        if all(low >= 0 for low, _ in self.bounds):
            return 1
        return -1 if all(high <= 0 for _, high in self.bounds) else 0

    @property
    def far(self) -> bool:
        """Whether its tangent at zero says little: none, or expected elsewhere."""
        return self.singular or self.center != 0


@dataclass(frozen=True, kw_only=True)
class NoiseEffect:
    """A law of the noise, not of the mean: named where no effect on the mean is.

    Attributes:
        id: its name in every output.
        flag: of :class:`noise.level.NoiseLevel`, on which it is named;
            empty where it is reported as a figure only.
        means, remedy: as for :class:`Effect`.
    """

    id: str
    flag: str = ""
    means: str
    remedy: str
    family: str = "noise"


@dataclass(frozen=True)
class Atom:
    """One variant of one effect: what the engine gives an amplitude."""

    effect: Effect
    variant: int = 0

    @property
    def constants(self) -> tuple[float, ...]:
        return self.effect.variants[self.variant]

    def prior(self, prepared, rig) -> Prior:
        """On the scale of the file, with what the data and the rig say beyond that."""
        effect = self.effect
        pair = effect.bounds[self.variant if len(effect.bounds) > 1 else 0]
        per = effect.per[self.variant if len(effect.per) > 1 else 0]
        size = getattr(prepared.sizes, per)
        prior = Prior(effect.scale, effect.center, *pair).times(size)
        return prior if effect.prior is None else effect.prior(prior, prepared, rig)

    def formula(self, rows: Covariates, time, amplitude=0.0, prepared=None) -> str:
        """Which of the effect's formulas it is, in words; empty where it has one. Of an
        amplitude beyond the effect's own, its doubts as well."""
        of, said = self.effect, []
        if of.which:
            said.append(of.which(self.constants, rows, time))
        if of.doubts and prepared is not None:
            said.append(of.doubts(float(amplitude), prepared))
        return ", ".join(part for part in said if part)

    def change(self, state: State, amplitude, rows: Covariates) -> State:
        """The state with this variant added."""
        return self.effect.change(state, amplitude, self.constants, rows)


def atoms_of(effects: Sequence[Effect]) -> tuple[Atom, ...]:
    """Every variant of every effect, in order."""
    return tuple(Atom(e, k) for e in effects for k in range(len(e.variants)))


def effects_by_id(effects: Sequence[Effect | NoiseEffect]) -> dict:
    """Records by id."""
    return {effect.id: effect for effect in effects}


def blend(constants, *values):
    """Values weighted by constants: a variant that picks one of them has a one there
    and zeros elsewhere."""
    return sum(c * value for c, value in zip(constants, values, strict=True))


def scaled(state: State, name: str, factor) -> State:
    """A field of the state times a factor, which stays positive."""
    factor = jnp.maximum(factor, LEAST_FACTOR)
    return state._replace(**{name: getattr(state, name) * factor})


Term = Callable[[Any, Any, Covariates], Any]
"""(amplitude, constants, covariates) -> what is done to one field of the state."""


def adds(name: str, term: Term) -> Change:
    """The change of an effect that adds a term to a field of the state."""

    def change(state, amplitude, constants, rows):
        added = getattr(state, name) + term(amplitude, constants, rows)
        return state._replace(**{name: added})

    return change


def multiplies(name: str, factor: Term) -> Change:
    """The change of an effect that multiplies a field; the factor stays positive."""
    return lambda state, amplitude, constants, rows: scaled(
        state, name, factor(amplitude, constants, rows)
    )


_SELDOM = -1.0
"""Log odds of an effect that is met a third as often as those of every tire."""


def seldom(prepared) -> float:
    """Log odds, whatever the data, of an effect that most files do not have."""
    return _SELDOM
