"""What effects do to the state of every row: the part of a fit that knows of them.

Programs of their own, as they hold the changes of all effects, which take long to
compile, and are the same whatever is modelled and measured.
"""

from functools import lru_cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.diagnosis.effects.state import Covariates, State, null_state
from tirefit.params import Values
from tirefit.results import InputProblem, UsageError

_LIBRARIES = 64
"""Libraries of effects, and numbers of rows, whose arrays are kept, at most."""


class Present(NamedTuple):
    """The effects of one hypothesis: ``atom`` (h,) their numbers, K for none, and
    ``amplitude`` (h,) in their own units."""

    atom: Values
    amplitude: Values


MOST_EFFECTS = 3
"""Effects of one hypothesis, at most."""


def present_in(amplitudes) -> Present:
    """The atoms that amplitudes of all (K,) have, at most :data:`MOST_EFFECTS`."""
    chosen = np.flatnonzero(amplitudes)
    index, values = np.full(MOST_EFFECTS, len(amplitudes)), np.zeros(MOST_EFFECTS)
    index[: len(chosen)], values[: len(chosen)] = chosen, np.asarray(amplitudes)[chosen]
    return Present(index, values)


def _per_row(state, count: int):
    """Every field of the state as (n,)."""
    return type(state)(
        *(jnp.broadcast_to(jnp.asarray(value, float), (count,)) for value in state)
    )


@lru_cache(maxsize=_LIBRARIES)
def _atoms(effects) -> tuple[np.ndarray, np.ndarray]:
    """Which effect each atom is of (K + 1,), and its constants (K + 1, c), padded; the
    last atom is of none."""
    owner = [k for k, effect in enumerate(effects) for _ in effect.variants]
    rows = [constants for effect in effects for constants in effect.variants]
    table = np.zeros((len(rows) + 1, max(map(len, rows), default=0)))
    for row, constants in zip(table, rows, strict=False):
        row[: len(constants)] = constants
    return np.array([*owner, len(effects)]), table


def count_atoms(effects) -> int:
    """Variants of all effects."""
    return sum(len(effect.variants) for effect in effects)


def state_of(effects, present: Present, rows: Covariates) -> State:
    """The state (n,) with every atom that is present; only its effect is computed."""
    count = rows.fz.shape[0]
    owner, table = _atoms(effects)

    def branch(effect):
        width = len(effect.variants[0])

        def change(state, a, constants, rows):
            try:
                changed = effect.change(state, a, constants[:width], rows)
                return _per_row(changed, count)
            except Exception as error:  # whatever a user's function raises
                reason = f"effect {effect.id!r}: {type(error).__name__}: {error}"
                remedy = (
                    "its change takes (state, amplitude, constants, rows) and gives"
                )
                remedy += " a state, each field a number or one for each row"
                raise UsageError(InputProblem(reason, remedy)) from error

        return change

    branches = [branch(effect) for effect in effects]
    branches.append(lambda state, a, constants, rows: state)

    def add(state, one):
        atom, amplitude = one
        kind, constants = jnp.asarray(owner)[atom], jnp.asarray(table)[atom]
        changed = jax.lax.switch(kind, branches, state, amplitude, constants, rows)
        return changed, None

    start = _per_row(null_state(), count)
    return jax.lax.scan(add, start, (present.atom, present.amplitude))[0]


def states_of(effects, amplitudes, rows: Covariates):
    """Fields (h + 1, F, n): the state without each of the h atoms that are there, and
    with all of them.

    Args:
        amplitudes: of all atoms (K,), in their own units; not zero of h at most.
    """
    if not np.any(amplitudes):
        return _nothing(len(rows.fz))
    return _states_of(effects, present_in(amplitudes), rows)


@lru_cache(maxsize=_LIBRARIES)
def _nothing(count: int) -> np.ndarray:
    state = np.array([float(field) for field in null_state()])
    return np.tile(state[:, None], (MOST_EFFECTS + 1, 1, count))


@partial(jax.jit, static_argnames=("effects",))
def _states_of(effects, present: Present, rows: Covariates):
    numbers = jnp.arange(present.atom.size)

    def without(gone):
        atom = jnp.where(numbers == gone, count_atoms(effects), present.atom)
        return jnp.stack(state_of(effects, present._replace(atom=atom), rows))

    return jax.lax.map(without, jnp.arange(numbers.size + 1))


class Changes(NamedTuple):
    """What each atom does to the state, by the number of its effect.

    ``slopes`` are changes (variants, n) of the fields that it touches, by field, for
    one prior scale more. Where that slope vanishes or misleads, ``ends`` is the state
    (variants, F, n) that lies ``sizes`` (variants,) prior scales away, one or as far as
    the amplitude that is expected.
    """

    slopes: dict[int, dict[int, Values]]
    ends: dict[int, Values]
    sizes: dict[int, Values]


@partial(jax.jit, static_argnames=("effects",))
def changes_of(effects, states, present: Present, rows, scale, center) -> Changes:
    """What more of each atom does.

    Args:
        states: what :func:`states_of` gave for them.
        scale: (K,) prior scales of the amplitudes, in their own units.
        center: (K,) expected amplitudes, in prior scales.
    """
    sizes = jnp.where(center < 0, -1.0, 1.0) * jnp.maximum(jnp.abs(center), 1.0)
    found, first = Changes({}, {}, {}), 0
    for number, effect in enumerate(effects):
        mine = first + np.arange(len(effect.variants))
        first += len(mine)
        at = jnp.asarray(mine), jnp.array(effect.variants), scale[mine]
        own = partial(_without, states, present)
        if effect.far:
            ends = jax.vmap(partial(_end, effect, own, rows))(*at, sizes[mine])
            found.ends[number], found.sizes[number] = ends, sizes[mine]
        else:
            found.slopes[number] = jax.vmap(partial(_slope, effect, own, rows))(*at)
    return found


def _without(states, present: Present, k) -> tuple[State, Values]:
    """The state without atom k, and the amplitude that it has."""
    mine = present.atom == k
    gone = jnp.where(jnp.any(mine), jnp.argmax(mine), mine.size)
    return State(*states[gone]), jnp.sum(jnp.where(mine, present.amplitude, 0.0))


def _slope(effect, own, rows, k, constants, scale) -> dict[int, Values]:
    """Changes (n,) of the fields that it touches."""
    others, amplitude = own(k)

    def moved(change):
        state = effect.change(others, amplitude + change, constants, rows)
        pairs = enumerate(zip(state, others, strict=True))
        touched = {
            f: jnp.broadcast_to(new, old.shape)
            for f, (new, old) in pairs
            if new is not old
        }
        return touched or {0: jnp.zeros_like(others[0])}

    return jax.jvp(moved, (0.0,), (scale,))[1]


def _end(effect, own, rows, k, constants, scale, size):
    """The state (F, n) so many prior scales away."""
    others, amplitude = own(k)
    state = effect.change(others, amplitude + size * scale, constants, rows)
    return jnp.stack(_per_row(state, rows.fz.shape[0]))
