"""What effects do to the state of every row: the part of a fit that knows of them.

The changes are traced once and evaluated by NumPy: to compile the fifty of the library
takes XLA 15 s of processor time, more than a diagnosis runs.
"""

from collections.abc import Mapping, Sequence
from functools import cache, cached_property, lru_cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.diagnosis.effects import Effect
from tirefit.diagnosis.effects.state import Covariates, State, null_state
from tirefit.diagnosis.evidence.by_numpy import Traced
from tirefit.results import InputProblem, UsageError

_LIBRARIES = 64
"""Libraries of effects whose traces are kept, at most."""

MOST_EFFECTS = 3
"""Effects of one hypothesis, at most."""

Present = Sequence[tuple[int, float]]
"""Numbers and amplitudes, in their own units, of the atoms of a hypothesis."""

Slopes = Mapping[int, np.ndarray]
"""Derivatives (n,) of the fields of a state that differ, by the number of the field."""


class Changes(NamedTuple):
    """What more of each atom does to a state.

    ``slopes`` are by its amplitude, by the number of the atom. Where that slope
    vanishes or misleads, ``ends`` is instead the state (F, n) that lies ``sizes`` prior
    scales away, one or as far as the amplitude that is expected.
    """

    slopes: dict[int, Slopes]
    ends: dict[int, np.ndarray]
    sizes: dict[int, float]


class _Change:
    """The change of one effect, traced for rows of given shapes.

    ``touched`` are the numbers of the fields of the state that it changes.
    """

    def __init__(self, effect: Effect, constants, rows: Covariates):
        count, self.touched = len(rows.fz), ()

        def moved(amplitude, constants, state, rows):
            try:
                changed = effect.change(state, amplitude, constants, rows)
                pairs = enumerate(zip(changed, state, strict=True))
                new = {
                    field: jnp.broadcast_to(jnp.asarray(after, float), (count,))
                    for field, (after, before) in pairs
                    if after is not before
                }
            except Exception as error:  # whatever a user's function raises
                reason = f"effect {effect.id!r}: {type(error).__name__}: {error}"
                remedy = (
                    "its change takes (state, amplitude, constants, rows) and gives"
                )
                remedy += " a state, each field a number or one for each row"
                raise UsageError(InputProblem(reason, remedy)) from error
            self.touched = tuple(new)
            return list(new.values())

        def direct(amplitude, constants, state, rows):
            def alone(amplitude):
                return moved(amplitude, constants, state, rows)

            return jax.jvp(alone, (amplitude,), (1.0,))

        def through(amplitude, constants, state, rows, tangent):
            def alone(state):
                return moved(amplitude, constants, state, rows)

            return jax.jvp(alone, (state,), (tangent,))[1]

        state = State(*np.zeros((len(State._fields), count)))
        given = 0.0, constants, state, rows
        self.direct = Traced(direct, *given)
        self._through = partial(Traced, through, *given, state)

    @cached_property
    def through(self) -> Traced:
        """What it makes of slopes of the state; few hypotheses ask for it."""
        return self._through()


class _Variant:
    """One variant of an effect: its change for rows of given shapes, by NumPy."""

    def __init__(self, change: _Change, constants):
        self._change, self._constants = change, constants
        self.touched = change.touched
        self._direct = change.direct.by_numpy({_CONSTANTS: constants})

    @cached_property
    def _through(self):
        return self._change.through.by_numpy({_CONSTANTS: self._constants})

    def added(self, state, amplitude: float, rows: Covariates):
        """The state (F, n) with the change, and the slopes of that by its amplitude;
        where it touches nothing, of a field by nothing."""
        values, slopes = self._direct(amplitude, self._constants, *state, *rows)
        after = np.array(state)
        for field, value in zip(self.touched, values, strict=True):
            after[field] = value
        by_field = dict(zip(self.touched, slopes, strict=True))
        return after, by_field or {0: np.zeros(state.shape[1])}

    def passed_on(self, slopes: Slopes, state, amplitude: float, rows) -> Slopes:
        """Slopes of the state before the change as those of the state after it."""
        before = np.zeros_like(state)
        for field, slope in slopes.items():
            before[field] = slope
        new = self._through(amplitude, self._constants, *state, *rows, *before)
        return {**slopes, **dict(zip(self.touched, new, strict=True))}


_CONSTANTS = 1
"""Number of the constants among the leaves of a change."""


class Library:
    """Effects with the traces of their changes.

    ``owner`` and ``constants`` say which effect an atom is of and its variant.
    """

    def __init__(self, effects: tuple[Effect, ...]):
        self.effects = effects
        pairs = [(e, c) for e, effect in enumerate(effects) for c in effect.variants]
        self.owner = [effect for effect, _ in pairs]
        self.constants = [np.array(constants, float) for _, constants in pairs]
        self._changes: dict[tuple, _Change] = {}
        self._variants: dict[tuple, _Variant] = {}

    def _of(self, atom: int, rows: Covariates) -> _Variant:
        key, shape, constants = self.owner[atom], rows.past.shape, self.constants[atom]
        if (atom, shape) not in self._variants:
            if (key, shape) not in self._changes:
                new = _Change(self.effects[key], constants, rows)
                self._changes[key, shape] = new
            new = _Variant(self._changes[key, shape], constants)
            self._variants[atom, shape] = new
        return self._variants[atom, shape]

    def state(self, present: Present, rows: Covariates) -> np.ndarray:
        """The state (F, n) with every atom that is present."""
        return self.slopes(present, rows, wanted=False)[0]

    def slopes(self, present: Present, rows: Covariates, wanted: bool = True):
        """The state with every atom, and its slopes by each of their amplitudes."""
        state, slopes = _nothing(len(rows.fz)), []
        for atom, amplitude in present:
            variant = self._of(atom, rows)
            if wanted:
                slopes = [
                    variant.passed_on(before, state, amplitude, rows)
                    for before in slopes
                ]
            state, own = variant.added(state, amplitude, rows)
            slopes.append(own)
        return state, slopes

    def changes(self, present: Present, rows: Covariates, scale, center) -> Changes:
        """What more of each atom does beside those that are present.

        Args:
            scale: (K,) prior scales of the amplitudes, in their own units.
            center: (K,) expected amplitudes, in prior scales.
        """
        whole, amplitudes = self.state(present, rows), dict(present)
        found = Changes({}, {}, {})
        for atom, number in enumerate(self.owner):
            others, amplitude = whole, amplitudes.get(atom, 0.0)
            if atom in amplitudes:
                others = self.state([one for one in present if one[0] != atom], rows)
            if self.effects[number].far:
                expected = float(center[atom])
                size = max(abs(expected), 1.0) * (-1.0 if expected < 0 else 1.0)
                far = amplitude + size * scale[atom]
                found.ends[atom] = self._of(atom, rows).added(others, far, rows)[0]
                found.sizes[atom] = size
            else:
                variant = self._of(atom, rows)
                found.slopes[atom] = variant.added(others, amplitude, rows)[1]
        return found


@lru_cache(maxsize=_LIBRARIES)
def library_of(effects: tuple[Effect, ...]) -> Library:
    """The effects with what was traced of them so far."""
    return Library(effects)


@cache
def _null() -> np.ndarray:
    return np.array([float(field) for field in null_state()])


def _nothing(count: int) -> np.ndarray:
    """The state (F, n) without any effect."""
    return np.repeat(_null()[:, None], count, axis=1)


def count_atoms(effects) -> int:
    """Variants of all effects."""
    return sum(len(effect.variants) for effect in effects)
