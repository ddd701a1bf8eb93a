"""Functions of arrays that JAX can trace, evaluated by NumPy: nothing is compiled."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.extend.core import Literal

_ELEMENTWISE: dict[str, Callable] = {
    "abs": np.abs, "add": np.add, "add_any": np.add, "and": np.bitwise_and,
    "cos": np.cos, "div": np.divide, "eq": np.equal, "exp": np.exp,
    "expm1": np.expm1, "ge": np.greater_equal, "gt": np.greater, "le": np.less_equal,
    "log": np.log, "log1p": np.log1p, "lt": np.less, "max": np.maximum,
    "min": np.minimum, "mul": np.multiply, "ne": np.not_equal, "neg": np.negative,
    "pow": np.power, "sign": np.sign, "sin": np.sin, "sqrt": np.sqrt,
    "square": np.square, "sub": np.subtract, "tan": np.tan, "tanh": np.tanh,
}  # fmt: skip
"""Primitives of JAX that one function of NumPy does."""

_WITHIN = {"jit": "jaxpr", "custom_jvp_call": "call_jaxpr"}
"""Primitives that are a function by itself, and the parameter that holds it."""


class Traced(NamedTuple):
    """A function as JAX saw it: the program, and the structure of what it gives."""

    program: Any
    structure: Any

    @classmethod
    def of(cls, function: Callable, *example: Any) -> "Traced":
        """For arguments of the shapes of an example."""
        program, shape = jax.make_jaxpr(function, return_shape=True)(*example)
        return cls(program, jax.tree.structure(shape))


def by_numpy(traced: Traced, known: Mapping[int, np.ndarray]) -> Callable:
    """The function, of arrays or tuples of such; what has one value for all rows may
    come back as that.

    Args:
        known: leaves of the arguments that will be the same, by their number: what
            follows from them alone, and what they multiply by zero, is not evaluated
            again.
    """
    (closed, structure), count = traced, len(traced.program.jaxpr.invars)
    steps = _Steps([known.get(k) for k in range(count)])
    ends = steps.added(closed.jaxpr, closed.consts, list(range(count)))
    needed, kept = set(ends), []
    for step in reversed(steps.steps):
        if needed.intersection(step[2]):
            needed |= set(step[1])
            kept.append(step)
    kept.reverse()

    def evaluated(*arguments):
        leaves: list[Any] = []
        for one in arguments:
            leaves.extend(one) if isinstance(one, tuple) else leaves.append(one)
        found = [*map(np.asarray, leaves), *steps.values[count:]]
        with np.errstate(all="ignore"):
            for operation, taken, given in kept:
                result = operation(*[found[place] for place in taken])
                for place, value in zip(given, result, strict=True):
                    found[place] = value
        return jax.tree.unflatten(structure, [found[place] for place in ends])

    return evaluated


class _Steps:
    """Operations one after the other, between places of a list of values; None stands
    for what is not known yet."""

    def __init__(self, values: list):
        self.values = values
        self.steps: list[tuple[Callable, list[int], list[int]]] = []

    def _place(self, value=None) -> int:
        self.values.append(value)
        return len(self.values) - 1

    def added(self, jaxpr, constants, places: list[int]) -> list[int]:
        """The places of what a program gives, of those of what it takes."""
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
    """A function of arrays, each of the shape of its variable or one that broadcasts to
    it, that gives a tuple of such."""
    name, told = equation.primitive.name, equation.params
    shapes = [variable.aval.shape for variable in equation.invars]
    if name in _ELEMENTWISE:
        done = _ELEMENTWISE[name]
        return lambda *x: (done(*x),)
    if name == "integer_pow":
        return lambda x: (x ** float(told["y"]),)
    if name == "convert_element_type":
        return lambda x: (x.astype(told["new_dtype"]),)
    if name == "select_n" and len(shapes) == 3:
        return lambda which, no, yes: (np.where(which, yes, no),)
    if name == "broadcast_in_dim" and not shapes[0]:
        return lambda x: (x,)
    exact = _exact(equation)

    def of_whole(*x):
        pairs = zip(x, shapes, strict=True)
        return exact(*(a if a.shape == s else np.broadcast_to(a, s) for a, s in pairs))

    return of_whole


def _exact(equation) -> Callable:
    """The same of arrays of the very shapes; what NumPy has no short way for is left to
    JAX."""
    name, told = equation.primitive.name, equation.params
    if name == "broadcast_in_dim":
        shape = np.ones(len(told["shape"]), int)
        shape[list(told["broadcast_dimensions"])] = equation.invars[0].aval.shape
        return lambda x: (np.reshape(x, shape),)
    if name == "squeeze":
        return lambda x: (np.squeeze(x, told["dimensions"]),)
    if name == "slice":
        steps = told["strides"] or [1] * len(told["start_indices"])
        ranges = zip(told["start_indices"], told["limit_indices"], steps, strict=True)
        part = tuple(slice(*each) for each in ranges)
        return lambda x: (x[part],)
    if name == "reshape" and told["dimensions"] is None:
        return lambda x: (np.reshape(x, told["new_sizes"]),)
    if name == "reduce_sum":
        return lambda x: (np.sum(x, axis=told["axes"]),)
    if name == "dot_general" and not any(told["dimension_numbers"][1]):
        axes = told["dimension_numbers"][0]
        return lambda x, y: (np.tensordot(x, y, axes),)

    def by_jax(*x):
        found = equation.primitive.bind(*x, **told)
        several = equation.primitive.multiple_results
        return tuple(map(np.asarray, found if several else (found,)))

    return by_jax
