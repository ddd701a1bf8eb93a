"""What effects do to the state of every row: the part of a fit that knows of them.

The changes are traced once and evaluated by NumPy: to compile the fifty of the library
takes XLA 15 s of processor time, more than a diagnosis runs.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.diagnosis.effects import Effect
from tirefit.diagnosis.effects.state import Covariates, State, null_state
from tirefit.diagnosis.evidence.by_numpy import by_numpy
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


class _Traced:
    """The change of one effect, for rows of given shapes."""

    def __init__(self, effect: Effect, constants, rows: Covariates):
        count, self.touched = len(rows.fz), ()

        def moved(amplitude, state, constants, rows):
            try:
                changed = effect.change(state, amplitude, constants, rows)
                new = {
                    f: jnp.broadcast_to(jnp.asarray(after, float), (count,))
                    for f, (after, before) in enumerate(
                        zip(changed, state, strict=True)
                    )
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

        def direct(amplitude, state, constants, rows):
            def alone(amplitude):
                return moved(amplitude, state, constants, rows)

            return jax.jvp(alone, (amplitude,), (1.0,))

        def through(amplitude, state, constants, rows, tangent):
            def alone(state):
                return moved(amplitude, state, constants, rows)

            return jax.jvp(alone, (state,), (tangent,))[1]

        state = State(*np.zeros((len(State._fields), count)))
        self._given: Any = (0.0, state, constants, rows)
        self.direct, self._through = by_numpy(direct, *self._given), through
        self._passed: Any = None

    def passed_on(self, *given):
        """What the change makes of the tangents (F, n) of the state: of those touched.

        Few hypotheses ask for it, so it is traced when the first does.
        """
        if self._passed is None:
            self._passed = by_numpy(self._through, *self._given, self._given[1])
        return self._passed(*given)


class Library:
    """Effects with the traces of their changes.

    ``owner`` and ``constants`` say which effect an atom is of and its variant.
    """

    def __init__(self, effects: tuple[Effect, ...]):
        self.effects = effects
        pairs = [(e, c) for e, effect in enumerate(effects) for c in effect.variants]
        self.owner = [effect for effect, _ in pairs]
        self.constants = [np.array(constants, float) for _, constants in pairs]
        self._traced: dict[tuple, _Traced] = {}

    def _of(self, atom: int, rows: Covariates) -> _Traced:
        key = (self.owner[atom], *(np.shape(part) for part in rows))
        if key not in self._traced:
            effect = self.effects[self.owner[atom]]
            self._traced[key] = _Traced(effect, self.constants[atom], rows)
        return self._traced[key]

    def _more(self, state, atom: int, amplitude: float, rows: Covariates):
        """The state (F, n) with an atom more, and the slopes of that by its amplitude;
        where it touches nothing, of a field by nothing."""
        traced, after = self._of(atom, rows), np.array(state)
        given = amplitude, State(*state), self.constants[atom], rows
        values, slopes = traced.direct(*given)
        for field, value in zip(traced.touched, values, strict=True):
            after[field] = value
        by_field = dict(zip(traced.touched, slopes, strict=True))
        return after, by_field or {0: np.zeros(len(rows.fz))}

    def state(self, present: Present, rows: Covariates) -> np.ndarray:
        """The state (F, n) with every atom that is present."""
        state = _nothing(len(rows.fz))
        for atom, amplitude in present:
            state = self._more(state, atom, amplitude, rows)[0]
        return state

    def slopes(self, present: Present, rows: Covariates):
        """The state with every atom, and its slopes by each of their amplitudes."""
        state, slopes = _nothing(len(rows.fz)), []
        for atom, amplitude in present:
            traced = self._of(atom, rows)
            for k, before in enumerate(slopes):
                tangent = np.zeros_like(state)
                for field, slope in before.items():
                    tangent[field] = slope
                given = amplitude, State(*state), self.constants[atom], rows
                new = traced.passed_on(*given, State(*tangent))
                slopes[k] = before | dict(zip(traced.touched, new, strict=True))
            state, own = self._more(state, atom, amplitude, rows)
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
                found.ends[atom] = self._more(others, atom, far, rows)[0]
                found.sizes[atom] = size
            else:
                slopes = self._more(others, atom, amplitude, rows)[1]
                found.slopes[atom] = slopes
        return found


@lru_cache(maxsize=_LIBRARIES)
def library_of(effects: tuple[Effect, ...]) -> Library:
    """The effects with what was traced of them so far."""
    return Library(effects)


def _nothing(count: int) -> np.ndarray:
    """The state (F, n) without any effect."""
    state = np.array([float(field) for field in _NULL])
    return np.repeat(state[:, None], count, axis=1)


_NULL = null_state()


def count_atoms(effects) -> int:
    """Variants of all effects."""
    return sum(len(effect.variants) for effect in effects)
