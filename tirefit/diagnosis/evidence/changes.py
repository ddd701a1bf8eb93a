"""Changes of the state of every row by effects.

JAX traces each change once and NumPy evaluates it, as XLA needs 15 s of processor time to
compile the fifty effects of the library, more than a diagnosis takes.
"""

from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Literal

from tirefit.diagnosis.effects import Effect, atoms_of
from tirefit.diagnosis.effects.state import Covariates, State, null_state
from tirefit.results import InputProblem, UsageError

MOST_EFFECTS = 3
"""Largest number of effects of one hypothesis."""

Present = Sequence[tuple[int, float]]
"""Numbers and amplitudes, in their own units, of the atoms of a hypothesis."""

Slopes = dict[int, np.ndarray | float]
"""Derivatives of the fields of a state that differ, (n,) or one, by their number."""


class Changes(NamedTuple):
    """Changes of a state by each atom: ``slopes`` over its amplitude. If the slope of an
    atom vanishes or misleads, ``ends`` has the state (F, n) at ``sizes`` prior scales."""

    slopes: dict[int, Slopes]
    ends: dict[int, np.ndarray]
    sizes: dict[int, float]


class _Change:
    """Change of an effect for rows of given shapes. ``touched`` are the numbers of the
    fields of the state that it changes."""

    touched: tuple[int, ...] = ()

    def __init__(self, effect: Effect, rows: Covariates):
        self._effect, count = effect, len(rows.fz)
        self._given = 0.0, _nothing(count), np.array(effect.variants[0], float), rows
        self._direct = _traced(self._by_amplitude, *self._given)
        self._programs: dict[tuple, _Program] = {}

    def _changed(self, amplitude, state, constants, rows) -> list:
        before = State(*state)
        try:
            after = self._effect.change(before, amplitude, constants, rows)
            new = {
                field: jnp.broadcast_to(jnp.asarray(value, float), state[0].shape)
                for field, value in enumerate(after)
                if value is not before[field]
            }
        except Exception as error:  # the function of a user may raise any error
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
    def _through(self) -> tuple:
        return _traced(self._by_state, *self._given, self._given[1])

    def _evaluated(self, traced: tuple, amplitude, state, constants, rows, *more):
        """By NumPy, for the variant of these constants."""
        key = traced is self._direct, constants
        if key not in self._programs:
            self._programs[key] = _Program(traced, np.array(constants, float))
        return self._programs[key](amplitude, state, rows, *more)

    def added(self, state, amplitude: float, constants, rows: Covariates):
        """The state (F, n) with the change, and its slopes by the amplitude."""
        given = amplitude, state, constants, rows
        values, slopes = self._evaluated(self._direct, *given)
        after = np.array(state)
        for field, value in zip(self.touched, values, strict=True):
            after[field] = value
        by_field = dict(zip(self.touched, slopes, strict=True))
        return after, by_field or {0: np.zeros(state.shape[1])}

    def passed_on(self, slopes: Slopes, state, amplitude, constants, rows) -> Slopes:
        """Slopes of the state after the change, from those of the state before it."""
        before = np.zeros_like(state)
        for number, slope in slopes.items():
            before[number] = slope
        given = amplitude, state, constants, rows
        new = self._evaluated(self._through, *given, before)
        return slopes | dict(zip(self.touched, new, strict=True))


class Library:
    """The atoms of effects, with the changes traced so far."""

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
        """Changes by each atom in addition to those present. ``scale`` are the prior
        scales (K,) of the amplitudes, ``center`` their expected values in those scales."""
        whole, amplitudes = self.state(present, rows), dict(present)
        found = Changes({}, {}, {})
        for number, atom in enumerate(self.atoms):
            others, amplitude = whole, amplitudes.get(number, 0.0)
            if number in amplitudes:
                others = self.state([p for p in present if p[0] != number], rows)
            change, constants = self._of(number, rows)
            if atom.effect.far:
                expected = float(center[number])
                size = max(abs(expected), 1.0) * (-1.0 if expected < 0 else 1.0)
                far = amplitude + size * scale[number]
                found.ends[number] = change.added(others, far, constants, rows)[0]
                found.sizes[number] = size
            else:
                own = change.added(others, amplitude, constants, rows)[1]
                found.slopes[number] = own
        return found


@lru_cache(maxsize=64)
def library_of(effects: tuple[Effect, ...]) -> Library:
    """The library of these effects, cached so that each is traced once."""
    return Library(effects)


@lru_cache(maxsize=64)
def _nothing(count: int) -> np.ndarray:
    """The state (F, n) without any effect; read-only."""
    return np.repeat([[float(value)] for value in null_state()], count, axis=1)


_ELEMENTWISE: dict[str, Callable] = {
    "abs": np.abs, "add": np.add, "add_any": np.add, "and": np.bitwise_and,
    "cos": np.cos, "div": np.divide, "eq": np.equal, "exp": np.exp,
    "expm1": np.expm1, "ge": np.greater_equal, "gt": np.greater, "le": np.less_equal,
    "log": np.log, "log1p": np.log1p, "lt": np.less, "max": np.maximum,
    "min": np.minimum, "mul": np.multiply, "ne": np.not_equal, "neg": np.negative,
    "pow": np.power, "sign": np.sign, "sin": np.sin, "sqrt": np.sqrt,
    "square": np.square, "sub": np.subtract, "tan": np.tan, "tanh": np.tanh,
}  # fmt: skip
"""Primitive of JAX -> the equivalent function of NumPy."""

_WITHIN = {"jit": "jaxpr", "custom_jvp_call": "call_jaxpr"}
"""Primitive that contains a function -> the parameter that holds it."""


def _traced(function: Callable, *example: Any) -> tuple[Any, Any]:
    """The program of a function for arguments like the example, and the structure of its result."""
    program, shape = jax.make_jaxpr(function, return_shape=True)(*example)
    return program, jax.tree.structure(shape)


class _Program:
    """A traced function of (amplitude, state, constants, rows, ...) that NumPy evaluates, for
    these constants. Results with one value for all rows may be scalars.

    What depends on the rows alone is evaluated once for them: a diagnosis has two of them
    and thousands of amplitudes.
    """

    def __init__(self, traced: tuple, constants: np.ndarray):
        (closed, self._structure), known = traced, [None, None, constants]
        self._count = len(closed.jaxpr.invars)
        steps = _Steps([*known, *[None] * (self._count - len(known))])
        self._ends = steps.added(closed.jaxpr, closed.consts, list(range(self._count)))
        self._values, needed, kept = steps.values, set(self._ends), list[tuple]()
        for step in reversed(steps.steps):
            if needed.intersection(step[2]):
                needed |= set(step[1])
                kept.insert(0, step)
        first, varying = 3 + len(Covariates._fields), {0, 1}
        varying |= {*range(first, self._count)}
        self._once, self._each = list[tuple](), list[tuple]()
        for step in kept:
            varies = not varying.isdisjoint(step[1])
            varying |= {*step[2]} if varies else set()
            (self._each if varies else self._once).append(step)
        needed = {*self._ends}.union(*(step[1] for step in self._each))
        self._rest = [k for k in range(3, len(self._values)) if k not in needed]
        self._held: tuple[Covariates | None, list] = None, []

    def __call__(self, amplitude, state, rows: Covariates, *more):
        if self._held[0] is not rows:
            found = self._values.copy()
            found[3 : 3 + len(rows)] = map(np.asarray, rows)
            _run(self._once, found)
            for place in self._rest:
                found[place] = None
            self._held = rows, found
        found = self._held[1].copy()
        found[:2] = np.asarray(amplitude), state
        found[3 + len(rows) : self._count] = more
        _run(self._each, found)
        return jax.tree.unflatten(self._structure, [found[place] for place in self._ends])


def _run(steps: list[tuple], found: list) -> None:
    """Evaluate steps in place."""
    with np.errstate(all="ignore"):
        for operation, taken, given in steps:
            result = operation(*[found[place] for place in taken])
            for place, value in zip(given, result, strict=True):
                found[place] = value


class _Steps:
    """Operations in sequence on a list of values; None is a value not yet computed."""

    def __init__(self, values: list):
        self.values = values
        self.steps: list[tuple[Callable, list[int], list[int]]] = []

    def _place(self, value=None) -> int:
        self.values.append(value)
        return len(self.values) - 1

    def added(self, jaxpr, constants, places: list[int]) -> list[int]:
        """Places of the results of a program, from the places of its arguments."""
        where = dict(zip(jaxpr.invars, places, strict=True))
        for variable, value in zip(jaxpr.constvars, constants, strict=True):
            where[variable] = self._place(np.array(value, variable.aval.dtype))
        for equation in jaxpr.eqns:
            taken = [self._of(atom, where) for atom in equation.invars]
            inner = equation.params.get(_WITHIN.get(equation.primitive.name))
            if inner is not None:
                given = self.added(inner.jaxpr, inner.consts, taken)
            else:
                given = self._step(equation, taken)
            where |= zip(equation.outvars, given, strict=True)
        return [self._of(atom, where) for atom in jaxpr.outvars]

    def _of(self, atom, where) -> int:
        if isinstance(atom, Literal):
            return self._place(np.array(atom.val, atom.aval.dtype))  # type: ignore
        return where[atom]

    def _step(self, equation, taken: list[int]) -> list[int]:
        operation, values = _operation(equation), [self.values[k] for k in taken]
        name = equation.primitive.name
        zero = [value is not None and not np.any(value) for value in values]
        if all(value is not None for value in values):
            with np.errstate(all="ignore"):
                return [self._place(value) for value in operation(*values)]
        if any(zero) and name in ("mul", "and"):
            return [self._place(values[zero.index(True)])]
        if any(zero) and name in ("add", "add_any"):
            return [taken[zero.index(False)]]
        if name == "select_n" and values[0] is not None and not values[0].shape:
            return [taken[1 + int(values[0])]]
        given = [self._place() for _ in equation.outvars]
        self.steps.append((operation, taken, given))
        return given


def _operation(equation) -> Callable:
    """NumPy function of an equation: arrays that broadcast to the shapes of its
    variables -> tuple of such arrays. JAX evaluates primitives that NumPy lacks."""
    name, parameters = equation.primitive.name, equation.params
    shapes = [variable.aval.shape for variable in equation.invars]
    if name in _ELEMENTWISE:
        return lambda *x: (_ELEMENTWISE[name](*x),)
    if name == "integer_pow":
        return lambda x: (x ** float(parameters["y"]),)
    if name == "convert_element_type":
        return lambda x: (x.astype(parameters["new_dtype"]),)
    if name == "select_n" and len(shapes) == 3:
        return lambda which, no, yes: (np.where(which, yes, no),)
    if name == "broadcast_in_dim" and not shapes[0]:
        return lambda x: (x,)

    def exact(*x):
        whole = [*map(np.broadcast_to, x, shapes)]
        if name in _OF_WHOLE:
            return (_OF_WHOLE[name](*whole, parameters),)
        found = equation.primitive.bind(*whole, **parameters)
        several = equation.primitive.multiple_results
        return tuple(map(np.asarray, found if several else (found,)))

    return exact


def _broadcast(x, parameters):
    shape = np.ones(len(parameters["shape"]), int)
    shape[list(parameters["broadcast_dimensions"])] = x.shape
    return np.reshape(x, shape)


def _part(x, parameters):
    steps = parameters["strides"] or [1] * x.ndim
    ranges = zip(parameters["start_indices"], parameters["limit_indices"], steps, strict=True)
    return x[tuple(slice(*each) for each in ranges)]


_OF_WHOLE: dict[str, Callable] = {
    "broadcast_in_dim": _broadcast,
    "reduce_sum": lambda x, parameters: np.sum(x, axis=parameters["axes"]),
    "reshape": lambda x, parameters: np.reshape(x, parameters["new_sizes"]),
    "slice": _part,
    "squeeze": lambda x, parameters: np.squeeze(x, parameters["dimensions"]),
}
"""Primitives that need arrays of exactly the shapes of their variables."""
