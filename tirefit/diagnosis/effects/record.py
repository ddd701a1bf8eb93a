"""The record of an effect: its formula, prior, needs and texts, and its variants."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from tirefit.diagnosis.effects.arrays import xp
from tirefit.diagnosis.effects.state import Covariates, State

PER_MILLE = 1e-3
"""Unit of amplitudes of a force: over the mean load, so that one prior serves all tires."""

LEAST_FACTOR = 0.05
"""Smallest friction or stiffness over its usual value, as a linear law would become
negative at amplitudes that a search tries."""

SHARE = (-1.9, 1.9)
"""Bounds of a relative change between two ends: below 2, both ends stay positive."""

SYMBOLS = {"friction": "mu", "stiffness": "c_p a^2"}
"""Field of the state that is multiplied -> its symbol in formulas."""

Change = Callable[[State, float, tuple[float, ...], Covariates], State]


class Prior(NamedTuple):
    """Prior of one amplitude in its own unit: a Gaussian of ``scale`` about ``center``
    within ``low`` and ``high``."""

    scale: float
    center: float
    low: float
    high: float

    def times(self, size: float) -> "Prior":
        """The same prior in units of a typical size of the file."""
        return Prior(*(size * part for part in self))


# JAX hashes the library at every call, so hash by identity and not field by field.
@dataclass(frozen=True, kw_only=True, eq=False)
class Effect:
    """One effect that a model may lack.

    Attributes:
        id: its name in every output.
        family: which parameter varies with which quantity.
        of: whether it is a property of the tire, vehicle or measurement.
        change: (state, amplitude, constants, covariates) -> state, by functions of NumPy, JAX or
            both (:data:`effects.arrays.xp`); amplitude 0 changes nothing.
        scale: prior standard deviation of the amplitude, a judgement: twice as wide
            lowers the log evidence of a certain effect by log 2.
        per: field of :class:`rows.covariates.Sizes` that is the unit of ``scale``,
            ``center`` and ``bounds``: one for all variants or one for each.
        unit: unit of the amplitude.
        formula, means, remedy: for the report: the law, its meaning, what to do about it.
        parameter: name of the amplitude.
        bounds: of the amplitude, one pair for all variants or one for each; physical,
            else about 20 scales.
        center: expected amplitude; not zero for mistakes of a known size.
        prior: (prior, prepared rows, rig) -> prior, if data or rig give information.
        odds: prepared rows -> change of the prior log odds.
        needs: columns or properties of the data without which it cannot be seen.
        channels: forces that it can change; empty is all.
        variants: constants of each formula that is tried; all of one length.
        which: (constants, covariates, time [s] or None) -> text for the formula of a
            variant, with the values to which its amplitude refers.
        doubts: (amplitude, prepared rows) -> why the amplitude is implausible, or "".
        during: constants -> begin and end of the stretch that a variant changes (shares
            of the record about its middle); not tried if a setting was held during it.
        singular: its tangent at zero vanishes; it is always refitted.
        looks_like: ids of effects that it is confused with.
        told_apart_by: the measurement that separates it from them.

    Example:
        >>> effect = next(one for one in EFFECTS if one.id == "load_friction")
        >>> effect.of, effect.unit, effect.looks_like
        ('tire', '-', ('friction_drift', 'force_offset'))
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
    of: str = "tire"
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
    during: Callable[[tuple[float, ...]], tuple[float, float]] | None = None
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
        """Whether the tangent at zero is a poor approximation."""
        return self.singular or self.center != 0


@dataclass(frozen=True, kw_only=True)
class NoiseEffect:
    """A law of the noise, named if no effect on the mean is; fields as in :class:`Effect`."""

    id: str
    flag: str = ""  # of :class:`noise.level.NoiseLevel` that names it; "": none
    means: str
    remedy: str
    family: str = "noise"


NOISE_EFFECTS = (
    NoiseEffect(
        id="outliers",
        flag="outliers",
        means="some rows lie far from all others",
        remedy="set [noise] loss = 'huber'",
    ),
    NoiseEffect(
        id="noise_heteroscedastic",
        means="the noise level differs over the range",
        remedy="give fx_std row by row",
    ),
    NoiseEffect(
        id="noise_autocorrelated",
        flag="autocorrelated",
        means="the noise of neighbouring rows is correlated",
        remedy="none needed: the effective number of rows is used",
    ),
    NoiseEffect(
        id="slip_noise", means="the slip is measured with noise", remedy="give sigma_x_std"
    ),
)


@dataclass(frozen=True)
class Atom:
    """One variant of one effect, with one amplitude."""

    effect: Effect
    variant: int = 0

    @property
    def constants(self) -> tuple[float, ...]:
        return self.effect.variants[self.variant]

    def prior(self, prepared, rig) -> Prior:
        """Prior in the unit of the amplitude, with information from data and rig."""
        effect = self.effect
        pair = effect.bounds[self.variant if len(effect.bounds) > 1 else 0]
        per = effect.per[self.variant if len(effect.per) > 1 else 0]
        size = getattr(prepared.sizes, per)
        prior = Prior(effect.scale, effect.center, *pair).times(size)
        return prior if effect.prior is None else effect.prior(prior, prepared, rig)

    def formula(self, rows: Covariates, time, amplitude=0.0, prepared=None) -> str:
        """Text on the formula of the variant, empty if the effect has one only, and the
        reason why an amplitude is implausible, if ``prepared`` is given."""
        of, parts = self.effect, []
        if of.which:
            parts.append(of.which(self.constants, rows, time))
        if of.doubts and prepared is not None:
            parts.append(of.doubts(float(amplitude), prepared))
        return ", ".join(part for part in parts if part)

    def change(self, state: State, amplitude, rows: Covariates) -> State:
        """The state with this variant added."""
        return self.effect.change(state, amplitude, self.constants, rows)


def atoms_of(effects: Sequence[Effect]) -> tuple[Atom, ...]:
    """Every variant of every effect, in order."""
    return tuple(Atom(e, k) for e in effects for k in range(len(e.variants)))


def effects_by_id(effects: Sequence[Effect | NoiseEffect]) -> dict:
    """Records by id."""
    return {effect.id: effect for effect in effects}


def choices(count: int) -> tuple[tuple[float, ...], ...]:
    """Constants of ``count`` variants that :func:`blend` one formula each."""
    return tuple(tuple(float(i == k) for i in range(count)) for k in range(count))


def blend(constants, *values):
    """Sum of the values weighted by the constants: one of them for :func:`choices`."""
    return sum(c * value for c, value in zip(constants, values, strict=True))


def scaled(state: State, name: str, factor) -> State:
    """The state with one field multiplied by a factor, which is kept positive."""
    factor = xp.maximum(factor, LEAST_FACTOR)
    return state._replace(**{name: getattr(state, name) * factor})


Term = Callable[[Any, Any, Covariates], Any]
"""(amplitude, constants, covariates) -> term or factor of one field of the state."""


def adds(name: str, term: Term) -> Change:
    """The change of an effect that adds a term to a field of the state."""

    def change(state, amplitude, constants, rows):
        added = getattr(state, name) + term(amplitude, constants, rows)
        return state._replace(**{name: added})

    return change


def multiplies(name: str, factor: Term) -> Change:
    """The change of an effect that multiplies a field by a factor kept positive."""
    return lambda state, amplitude, constants, rows: scaled(
        state, name, factor(amplitude, constants, rows)
    )


_SELDOM = -1.0
"""Log odds of an effect that is a third as frequent as usual ones."""


def seldom(prepared) -> float:
    """Prior log odds of an effect that most files do not have."""
    return _SELDOM
