"""The state of every row with some effects applied, and its slopes by their amplitudes, on
arrays of NumPy."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tirefit.diagnosis.effects.record import Atom
from tirefit.diagnosis.effects.state import Covariates, State, null_state
from tirefit.diagnosis.negligible import ROUNDING
from tirefit.results import InputProblem, UsageError

_STEP = 1e-5
"""Step of a numerical slope over the prior scale: the error of the parabola is its square,
that of rounding 1e-16 over it, so both are about 1e-10 of the change by one scale."""

_LEAST_NEXT = 0.9
"""Smallest second step of a state over the first, from amplitude 0. It is below 1 by about
the step unless the slope there is infinite, as that of a root."""

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

    def __init__(self, atoms: Sequence[Atom], rows: Covariates, scale):
        self._atoms, self._scale = atoms, scale
        self._rows = Covariates(*(_constant(part, np.shape(part)) for part in rows))
        self._null = State(*(_constant(value, np.shape(rows.fz)) for value in null_state()))

    def state(self, present: Present) -> np.ndarray:
        """The state (F, n) with every atom that is present."""
        return np.array(self._after(self._null, present))

    def slopes(self, present: Present) -> tuple[np.ndarray, list[Slopes]]:
        """The state with every atom, and its slopes by each of their amplitudes."""
        before = [self._null]
        for one in present:
            before.append(self._after(before[-1], [one]))
        slopes = [
            self._slope(before[k], one, present[k + 1 :], before[-1])
            for k, one in enumerate(present)
        ]
        return np.array(before[-1]), slopes

    def changes(self, present: Present, center) -> Changes:
        """Changes by each atom in addition to those present. ``center`` are the expected
        amplitudes (K,) in prior scales."""
        whole, amplitudes = self._after(self._null, present), dict(present)
        found = Changes({}, {}, {})
        for number, atom in enumerate(self._atoms):
            others, amplitude = whole, amplitudes.get(number, 0.0)
            if number in amplitudes:
                others = self._after(self._null, [p for p in present if p[0] != number])
            if atom.effect.far:
                expected = float(center[number])
                size = max(abs(expected), 1.0) * (-1.0 if expected < 0 else 1.0)
                far = amplitude + size * float(self._scale[number])
                found.ends[number] = np.array(self._after(others, [(number, far)]))
                found.sizes[number] = size
            else:
                one = number, amplitude
                found.slopes[number] = self._slope(others, one, [], self._after(others, [one]))
        return found

    @np.errstate(all="ignore")  # the engine refuses slopes that are not finite
    def _slope(self, before: State, one: tuple[int, float], later: Present, here: State) -> Slopes:
        """Slopes by the amplitude of an atom between those before it and later ones, by the
        parabola through three points; ``here`` is the state with all of them.

        The points lie towards zero, from zero on the positive side: amplitudes on a bound
        stay within it, and a lag, which has no negative length, has its slope at zero.
        """
        number, amplitude = one
        step = -np.copysign(_STEP * float(self._scale[number]), amplitude or -1.0)
        near, far = (self._after(before, [(number, amplitude + k * step), *later]) for k in (1, 2))
        found = {}
        for field, (a, b, c) in enumerate(zip(here, near, far, strict=True)):
            if a is c or np.array_equal(a, c):
                continue
            first, second = b - a, c - b
            found[field] = (3 * first - second) / (2 * step)
            shrinks = _size(second) + ROUNDING * _size(b) < _LEAST_NEXT * _size(first)
            if shrinks and not amplitude:
                found[field] = np.full_like(a, np.inf)
        return found

    @np.errstate(all="ignore")
    def _after(self, state: State, present: Present) -> State:
        """The state with further atoms, applied in their order."""
        for number, amplitude in present:
            state = _changed(state, self._atoms[number], amplitude, self._rows)
        return state


def _changed(state: State, atom: Atom, amplitude: float, rows: Covariates) -> State:
    """The state with an atom; fields that it does not change stay the same arrays."""
    try:
        pairs = zip(state, atom.change(state, amplitude, rows), strict=True)
        return State(*(a if b is a else _constant(b, np.shape(a)) for a, b in pairs))
    except Exception as error:  # the function of a user may raise any error
        reason = f"effect {atom.effect.id!r}: {type(error).__name__}: {error}"
        remedy = "its change takes (state, amplitude, constants, rows) and gives"
        remedy += " a state, each field a number or one for each row"
        raise UsageError(InputProblem(reason, remedy)) from error


def _size(values) -> float:
    return float(np.sqrt(np.vdot(values, values)))


def _constant(values, shape: tuple[int, ...]) -> np.ndarray:
    """Values that no function of a user can write to, as hypotheses share them."""
    array = np.asarray(values, float)
    view = array.view() if array.shape == shape else np.broadcast_to(array, shape)
    view.flags.writeable = False
    return view
