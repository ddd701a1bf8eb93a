"""The record of an effect: its formula, prior, needs and texts, and its variants; and the
state of every row with some effects applied, with its slopes by their amplitudes.

A diagnosis changes the state of every row thousands of times, on plain arrays of NumPy: XLA
would compile the fifty effects for 15 s of processor time. A tire with effects
(:mod:`tirefit.diagnosis.extended`) is traced by JAX."""

import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module, resources
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.diagnosis.effects.state import Covariates, State, null_state
from tirefit.diagnosis.engine import ROUNDING
from tirefit.diagnosis.rows.rig import Rig
from tirefit.params import Values
from tirefit.results import InputProblem, UsageError

if TYPE_CHECKING:
    from tirefit.diagnosis.rows.prepared import Prepared


class _Arrays:
    def __getattr__(self, name: str) -> Callable[..., Any]:
        def function(*values: np.ndarray | float, **options: Any) -> np.ndarray:
            traced = any(isinstance(value, jax.Array) for value in values)
            return getattr(jnp if traced else np, name)(*values, **options)

        setattr(self, name, function)
        return function


xp: Any = _Arrays()
"""``xp.exp`` and so on: the function of JAX if an argument is an array of JAX or a tracer,
else that of NumPy."""


PER_MILLE = 1e-3
"""Unit of amplitudes of a force: over the mean load, so that one prior serves all tires."""

LEAST_FACTOR = 0.05
"""Smallest friction or stiffness over its usual value, as a linear law would become
negative at amplitudes that a search tries."""

Constants = tuple[float, ...]
"""The constants of one variant of an effect."""

Change = Callable[[State, float, Constants, Covariates], State]


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
            both (:data:`effects.record.xp`); amplitude 0 changes nothing.
        scale: prior standard deviation of the amplitude, a judgement: twice as wide
            lowers the log evidence of a certain effect by log 2.
        per: key of :func:`rows.covariates.sizes_of` that is the unit of ``scale``,
            ``center`` and ``bounds``: one for all variants or one for each.
        unit: unit of the amplitude.
        formula, means, remedy, remedy_derived: for the report: the law, its meaning, what to
            do about it, and that in a file written by ``tirefit derive``, if another.
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
        singular: its tangent at zero vanishes or misleads, as of a delay: it is suggested by its
            change over one prior scale, and always refitted.
        looks_like: ids of effects that it is confused with.
        told_apart_by: the measurement that separates it from them.

    Example:
        >>> effect = next(effect for effect in EFFECTS if effect.id == "load_friction")
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
    remedy_derived: str = ""
    of: str = "tire"
    per: tuple[str, ...] = ("plain",)
    bounds: tuple[tuple[float, float], ...] = ((-float("inf"), float("inf")),)
    center: float = 0.0
    prior: Callable[[Prior, object, object], Prior] | None = None
    odds: Callable[[object], float] | None = None
    needs: tuple[str, ...] = ()
    channels: tuple[str, ...] = ()
    variants: tuple[Constants, ...] = ((),)
    which: Callable[[Constants, Covariates | None, object], str] | None = None
    singular: bool = False
    looks_like: tuple[str, ...] = ()
    told_apart_by: str = ""

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Copies and pickles of an effect of a library are that effect: its functions have no
        name by which they could be copied. An effect of the user is copied by its functions."""
        package = _PACKAGES.get(self)
        return (_of_library, (package, self.id)) if package else super().__reduce_ex__(protocol)

    @property
    def misleads(self) -> bool:
        """Whether the tangent at zero is a poor approximation."""
        return self.singular or self.center != 0


class NoiseEffect(NamedTuple):
    """A law of the noise, named if no effect on the mean is; fields as in :class:`Effect`, and
    the ``flag`` of :class:`rows.noise.NoiseLevel` that names it, empty for none."""

    id: str
    means: str
    remedy: str
    flag: str = ""
    family: str = "noise"


NOISE_EFFECTS = (
    NoiseEffect(
        "outliers", "some rows lie far from all others", "correct or delete these rows", "outliers"
    ),
    NoiseEffect(
        "noise_heteroscedastic", "the noise level differs over the range", "give fx_std row by row"
    ),
    NoiseEffect(
        "noise_autocorrelated",
        "the noise of neighbouring rows is correlated",
        "none needed: the effective number of rows is used",
        "autocorrelated",
    ),
    NoiseEffect("slip_noise", "the slip is measured with noise", "give sigma_x_std"),
)


@dataclass(frozen=True)
class Atom:
    """One variant of one effect, with one amplitude."""

    effect: Effect
    variant: int = 0

    @property
    def constants(self) -> Constants:
        return self.effect.variants[self.variant]

    def prior(self, prepared: "Prepared", rig: Rig) -> Prior:
        """Prior in the unit of the amplitude, with information from data and rig."""
        effect = self.effect
        pair = effect.bounds[self.variant if len(effect.bounds) > 1 else 0]
        per = effect.per[self.variant if len(effect.per) > 1 else 0]
        size = prepared.sizes[per]
        prior = Prior(effect.scale, effect.center, *pair).times(size)
        return prior if effect.prior is None else effect.prior(prior, prepared, rig)

    def formula(self, rows: Covariates | None, time: np.ndarray | None) -> str:
        """Text on the formula of the variant, empty if the effect has one only."""
        of = self.effect
        return of.which(self.constants, rows, time) if of.which else ""

    def change(self, state: State, amplitude: float, rows: Covariates) -> State:
        """The state with this variant added."""
        return self.effect.change(state, amplitude, self.constants, rows)


def atoms_of(effects: Sequence[Effect]) -> tuple[Atom, ...]:
    """Every variant of every effect, in order."""
    return tuple(Atom(e, k) for e in effects for k in range(len(e.variants)))


def effects_by_id(effects: Sequence[Effect | NoiseEffect]) -> dict[str, Any]:
    """Records by id."""
    return {effect.id: effect for effect in effects}


def blend(constants: Constants, *values: Values) -> Values | float:
    """Sum of the values weighted by the constants: one of them where ``variants`` is a number."""
    return sum(c * value for c, value in zip(constants, values, strict=True))


def scaled(state: State, name: str, factor: Values | float) -> State:
    """The state with one field multiplied by a factor, which is kept positive."""
    factor = xp.maximum(factor, LEAST_FACTOR)
    return state._replace(**{name: getattr(state, name) * factor})


Term = Callable[[Any, Any, Any], Any]
"""(amplitude, constants, covariates) -> term or factor of one field of the state."""


def adds(path: str, term: Term) -> Callable[..., Any]:
    """The change of an effect that adds a term to a field of a state, ``force``, or of a part
    of it, ``steering.delay``."""
    part, _, name = path.rpartition(".")

    def change(state: Any, amplitude: Any, constants: Constants, rows: Any) -> Any:
        held = getattr(state, part) if part else state
        added = getattr(held, name) + term(amplitude, constants, rows)
        held = held._replace(**{name: added})
        return state._replace(**{part: held}) if part else held

    return change


def multiplies(name: str, factor: Term) -> Change:
    """The change of an effect that multiplies a field by a factor kept positive."""
    return lambda state, amplitude, constants, rows: scaled(
        state, name, factor(amplitude, constants, rows)
    )


def seldom(prepared: "Prepared") -> float:
    """Prior log odds of an effect that most files do not have: a third as frequent."""
    return -1.0


Code = dict[str, Callable[..., Any] | dict[str, Any]]
"""Id of an effect -> its change, or the fields of its record that are code. A car has ``Setting``
and ``Samples`` in the place of ``State`` and ``Covariates``."""


_PACKAGES: dict[Effect, str] = {}
"""Effect of a library -> the package that has its table."""


def _of_library(package: str, id: str) -> Effect:
    import_module(f"{package.removesuffix('.effects')}.effects")
    return next(e for e, place in _PACKAGES.items() if (place, e.id) == (package, id))


def library(package: str, codes: Code) -> tuple[Effect, ...]:
    """The effects of ``effects.toml`` in a package, each with its code."""
    tables = tomllib.loads((resources.files(package) / "effects.toml").read_text("utf-8"))
    effects = []
    for id, table in tables.items():
        code = codes[id]
        fields = {key: _tuples(value) for key, value in table.items()}
        fields |= code if isinstance(code, dict) else {"change": code}
        if fields.pop("seldom", False):
            fields["odds"] = seldom
        if isinstance(count := fields.get("variants"), int):  # blended one formula each
            fields["variants"] = tuple(tuple(np.eye(count)[k].tolist()) for k in range(count))
        effects.append(Effect(id=id, **fields))
    _PACKAGES.update(dict.fromkeys(effects, package))
    return tuple(effects)


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


_STEP = 1e-5
"""Step of a numerical slope over the prior scale: the error of the parabola is its square,
that of rounding 1e-16 over it, so both are about 1e-10 of the change by one scale."""

Present = Sequence[tuple[int, float]]
"""Numbers and amplitudes, in their own units, of the atoms of a hypothesis."""

Slopes = dict[int, np.ndarray]
"""Derivatives (n,) of the fields of a state that an amplitude changes, by their number."""


class Changes(NamedTuple):
    """Changes of a state by each atom: ``slopes`` over its amplitude. If the slope of an
    atom vanishes or misleads, ``ends`` has the state (F, n) at ``sizes`` prior scales."""

    slopes: dict[int, Slopes]
    ends: dict[int, np.ndarray]
    sizes: dict[int, float]


class States:
    """States of some rows under hypotheses of atoms.

    Args:
        scale: prior scales (K,) of the amplitudes of all atoms, in their own units.
    """

    def __init__(self, atoms: Sequence[Atom], rows: Covariates, scale: Values) -> None:
        self._atoms, self._scale = atoms, scale
        self._rows = Covariates(*(_constant(part, np.shape(part)) for part in rows))
        self._null = State(*(_constant(value, np.shape(rows.fz)) for value in null_state()))

    def state(self, present: Present) -> np.ndarray:
        """The state (F, n) with every atom that is present."""
        return np.array(self._after(self._null, present))

    def slopes(self, present: Present) -> tuple[np.ndarray, list[Slopes]]:
        """The state with every atom, and its slopes by each of their amplitudes."""
        before = [self._null]
        for added in present:
            before.append(self._after(before[-1], [added]))
        slopes = [
            self._slope(before[k], added, present[k + 1 :], before[-1])
            for k, added in enumerate(present)
        ]
        return np.array(before[-1]), slopes

    def changes(self, present: Present, center: Values) -> Changes:
        """Changes by each atom in addition to those present. ``center`` are the expected
        amplitudes (K,) in prior scales."""
        whole, amplitudes = self._after(self._null, present), dict(present)
        changes = Changes({}, {}, {})
        for number, atom in enumerate(self._atoms):
            others, amplitude = whole, amplitudes.get(number, 0.0)
            if number in amplitudes:
                others = self._after(self._null, [p for p in present if p[0] != number])
            if atom.effect.misleads:
                expected = float(center[number])
                size = max(abs(expected), 1.0) * (-1.0 if expected < 0 else 1.0)
                end = amplitude + size * float(self._scale[number])
                changes.ends[number] = np.array(self._after(others, [(number, end)]))
                changes.sizes[number] = size
            else:
                added = number, amplitude
                here = self._after(others, [added])
                changes.slopes[number] = self._slope(others, added, [], here)
        return changes

    @np.errstate(all="ignore")  # the engine refuses slopes that are not finite
    def _slope(
        self, before: State, added: tuple[int, float], later: Present, here: State
    ) -> Slopes:
        """Slopes by the amplitude of an atom between those before it and later ones, by the
        parabola through three points; ``here`` is the state with all of them.

        The points lie towards zero, from zero on the positive side: amplitudes on a bound
        stay within it, and a lag, which has no negative length, has its slope at zero.
        """
        number, amplitude = added
        step = -np.copysign(_STEP * float(self._scale[number]), amplitude or -1.0)
        at = amplitude + step, amplitude + 2 * step
        ahead = (self._after(before, [(number, end), *later]) for end in at)
        slopes = {}
        for field, (a, b, c) in enumerate(zip(here, *ahead, strict=True)):
            if a is c or np.array_equal(a, c):
                continue
            first, second = b - a, c - b
            slopes[field] = (3 * first - second) / (2 * step)
            # The second step is as large as the first unless the slope is infinite, as of a root.
            sizes = np.linalg.norm([first, second, b], axis=1)
            if sizes[1] + ROUNDING * sizes[2] < 0.9 * sizes[0] and not amplitude:
                slopes[field] = np.full_like(a, np.inf)
        return slopes

    @np.errstate(all="ignore")
    def _after(self, state: State, present: Present) -> State:
        """The state with further atoms, applied in their order; fields that they do not change
        stay the same arrays."""
        for number, amplitude in present:
            atom = self._atoms[number]
            try:
                pairs = zip(state, atom.change(state, amplitude, self._rows), strict=True)
                state = State(*(a if b is a else _constant(b, np.shape(a)) for a, b in pairs))
            except Exception as error:  # the function of a user may raise any error
                reason = f"effect {atom.effect.id!r}: {type(error).__name__}: {error}"
                remedy = "its change takes (state, amplitude, constants, rows) and gives"
                remedy += " a state, each field a number or one for each row"
                raise UsageError(InputProblem(reason, remedy)) from error
        return state


def _constant(values: Values | float, shape: tuple[int, ...]) -> np.ndarray:
    """Values that no function of a user can write to, as hypotheses share them."""
    array = np.asarray(values, float)
    view = array.view() if array.shape == shape else np.broadcast_to(array, shape)
    view.flags.writeable = False
    return view
