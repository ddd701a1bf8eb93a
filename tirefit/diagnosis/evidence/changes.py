"""What effects do to the state of every row: the part of a fit that knows of them.

The changes are traced once and evaluated by NumPy: to compile the fifty of the library
takes XLA 15 s of processor time, more than a diagnosis runs.
"""

from collections.abc import Callable, Sequence
from functools import cache, cached_property, lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.diagnosis.effects import Effect, atoms_of
from tirefit.diagnosis.effects.state import Covariates, State, null_state
from tirefit.diagnosis.evidence.by_numpy import Traced, by_numpy
from tirefit.results import InputProblem, UsageError

MOST_EFFECTS = 3
"""Effects of one hypothesis, at most."""

Present = Sequence[tuple[int, float]]
"""Numbers and amplitudes, in their own units, of the atoms of a hypothesis."""

Slopes = dict[int, np.ndarray]
"""Derivatives (n,) of the fields of a state that differ, by the number of the field."""


class Changes(NamedTuple):
    """What more of each atom does to a state, by the number of the atom.

    ``slopes`` are by its amplitude. Where that slope vanishes or misleads, ``ends`` is
    instead the state (F, n) that lies ``sizes`` prior scales away, one or as far as the
    amplitude that is expected.
    """

    slopes: dict[int, Slopes]
    ends: dict[int, np.ndarray]
    sizes: dict[int, float]


class _Change:
    """The change of an effect, for rows of given shapes, by NumPy.

    ``touched`` are the numbers of the fields of the state that it changes.
    """

    touched: tuple[int, ...] = ()

    def __init__(self, effect: Effect, rows: Covariates):
        self._effect, count = effect, len(rows.fz)
        self._given = 0.0, _nothing(count), np.array(effect.variants[0], float), rows
        self._direct = Traced.of(self._by_amplitude, *self._given)
        self._functions: dict[tuple, Callable] = {}

    def _changed(self, amplitude, state, constants, rows) -> list:
        try:
            before = State(*state)
            after = self._effect.change(before, amplitude, constants, rows)
            pairs = enumerate(zip(after, before, strict=True))
            new = {
                field: jnp.broadcast_to(jnp.asarray(value, float), state[0].shape)
                for field, (value, old) in pairs
                if value is not old
            }
        except Exception as error:  # whatever a user's function raises
            reason = f"effect {self._effect.id!r}: {type(error).__name__}: {error}"
            remedy = "its change takes (state, amplitude, constants, rows) and gives"
            remedy += " a state, each field a number or one for each row"
            raise UsageError(InputProblem(reason, remedy)) from error
        self.touched = tuple(new)
        return list(new.values())

    def _by_amplitude(self, amplitude, *more):
        return jax.jvp(lambda a: self._changed(a, *more), (amplitude,), (1.0,))

    def _by_state(self, amplitude, state, constants, rows, tangent):
        def alone(state):
            return self._changed(amplitude, state, constants, rows)

        return jax.jvp(alone, (state,), (tangent,))[1]

    @cached_property
    def _through(self) -> Traced:
        return Traced.of(self._by_state, *self._given, self._given[1])

    def _evaluated(self, traced: Traced, amplitude, state, constants, *more):
        """By NumPy, for the variant of these constants."""
        key, constants = (traced is self._direct, constants), np.array(constants, float)
        if key not in self._functions:
            self._functions[key] = by_numpy(traced, {_CONSTANTS: constants})
        return self._functions[key](amplitude, state, constants, *more)

    def added(self, state, amplitude: float, constants, rows: Covariates):
        """The state (F, n) with the change, and the slopes of that by its amplitude;
        where it touches nothing, of a field by nothing."""
        given = amplitude, state, constants, rows
        values, slopes = self._evaluated(self._direct, *given)
        after = np.array(state)
        for field, value in zip(self.touched, values, strict=True):
            after[field] = value
        by_field = dict(zip(self.touched, slopes, strict=True))
        return after, by_field or {0: np.zeros(state.shape[1])}

    def passed_on(self, slopes: Slopes, state, amplitude, constants, rows) -> Slopes:
        """Slopes of the state before the change as those of the state after it."""
        before = np.zeros_like(state)
        for number, slope in slopes.items():
            before[number] = slope
        given = amplitude, state, constants, rows
        new = self._evaluated(self._through, *given, before)
        return slopes | dict(zip(self.touched, new, strict=True))


_CONSTANTS = 2
"""Number of the constants among the arguments of a change, and their leaves."""


class Library:
    """The atoms of effects, with the changes that were traced so far."""

    def __init__(self, effects: tuple[Effect, ...]):
        self.atoms = atoms_of(effects)
        self._changes: dict[tuple, _Change] = {}

    def _of(self, atom: int, rows: Covariates) -> tuple[_Change, tuple[float, ...]]:
        effect, constants = self.atoms[atom].effect, self.atoms[atom].constants
        key = effect.id, rows.past.shape
        if key not in self._changes:
            self._changes[key] = _Change(effect, rows)
        return self._changes[key], constants

    def state(self, present: Present, rows: Covariates) -> np.ndarray:
        """The state (F, n) with every atom that is present."""
        state = _nothing(len(rows.fz))
        for atom, amplitude in present:
            change, constants = self._of(atom, rows)
            state = change.added(state, amplitude, constants, rows)[0]
        return state

    def slopes(self, present: Present, rows: Covariates):
        """The state with every atom, and its slopes by each of their amplitudes."""
        state, slopes = _nothing(len(rows.fz)), list[Slopes]()
        for atom, amplitude in present:
            change, constants = self._of(atom, rows)
            given = state, amplitude, constants, rows
            slopes = [change.passed_on(before, *given) for before in slopes]
            state, own = change.added(*given)
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
        for number, atom in enumerate(self.atoms):
            others, amplitude = whole, amplitudes.get(number, 0.0)
            if number in amplitudes:
                others = self.state([p for p in present if p[0] != number], rows)
            (change, constants), expected = (
                self._of(number, rows),
                float(center[number]),
            )
            if atom.effect.far:
                size = max(abs(expected), 1.0) * (-1.0 if expected < 0 else 1.0)
                far = amplitude + size * scale[number]
                found.ends[number] = change.added(others, far, constants, rows)[0]
                found.sizes[number] = size
            else:
                given = others, amplitude, constants, rows
                found.slopes[number] = change.added(*given)[1]
        return found


@lru_cache(maxsize=64)
def library_of(effects: tuple[Effect, ...]) -> Library:
    """The effects with what was traced of them so far."""
    return Library(effects)


@cache
def _null() -> np.ndarray:
    return np.array([float(value) for value in null_state()])


def _nothing(count: int) -> np.ndarray:
    """The state (F, n) without any effect."""
    return np.repeat(_null()[:, None], count, axis=1)


def count_atoms(effects) -> int:
    """Variants of all effects."""
    return sum(len(effect.variants) for effect in effects)
