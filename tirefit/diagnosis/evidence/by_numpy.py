"""Functions of arrays that JAX can trace, evaluated by NumPy: nothing is compiled."""

from collections.abc import Callable, Mapping
from typing import Any

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
"""Primitives of JAX that one function of NumPy does, for floats and truth values."""

_WITHIN = {"jit": "jaxpr", "custom_jvp_call": "call_jaxpr"}
"""Primitives that are a function by itself, and the parameter that holds it."""


class Traced:
    """A function of arrays as JAX saw it, for arguments of the shapes of an example."""

    def __init__(self, function: Callable, *example: Any):
        self.program, shape = jax.make_jaxpr(function, return_shape=True)(*example)
        self.structure = jax.tree.structure(shape)

    def by_numpy(self, known: Mapping[int, Any]) -> Callable:
        """The function of the leaves of its arguments, evaluated by NumPy.

        What has one value for all rows may come back as that. Primitives without a
        counterpart here are left to JAX.

        Args:
            known: values of some leaves, by their number, that will stay: what follows
                from them alone, and what they multiply by zero, is not evaluated again.
        """
        count = len(self.program.jaxpr.invars)
        steps = _Steps(count, known)
        closed, structure = self.program, self.structure
        ends = steps.flattened(closed.jaxpr, closed.consts, list(range(count)))
        kept, values = steps.needed(ends), steps.values

        def evaluated(*leaves):
            found = [*map(np.asarray, leaves), *values[count:]]
            with np.errstate(all="ignore"):
                for operation, taken, given in kept:
                    result = operation(*[found[place] for place in taken])
                    for place, value in zip(given, result, strict=True):
                        found[place] = value
            return jax.tree.unflatten(structure, [found[place] for place in ends])

        return evaluated


class _Steps:
    """Operations one after the other, between places of a list of values."""

    def __init__(self, count: int, known: Mapping[int, Any]):
        self.values: list[Any] = [None] * count
        self.steps: list[tuple[Callable, list[int], list[int]]] = []
        for place, value in known.items():
            self.values[place] = np.asarray(value)

    def placed(self, value=None) -> int:
        self.values.append(value)
        return len(self.values) - 1

    def flattened(self, jaxpr, constants, places: list[int]) -> list[int]:
        """The places of what a program gives, of what it takes."""
        where = dict(zip(jaxpr.invars, places, strict=True))
        for variable, value in zip(jaxpr.constvars, constants, strict=True):
            where[variable] = self.placed(np.array(value, variable.aval.dtype))

        def place(atom) -> int:
            if isinstance(atom, Literal):
                return self.placed(np.array(atom.val, atom.aval.dtype))
            return where[atom]

        for equation in jaxpr.eqns:
            taken = [place(atom) for atom in equation.invars]
            inner = equation.params.get(_WITHIN.get(equation.primitive.name))
            if inner is not None:
                given = self.flattened(inner.jaxpr, inner.consts, taken)
            else:
                given = self._added(equation, taken)
            where |= zip(equation.outvars, given, strict=True)
        return [place(atom) for atom in jaxpr.outvars]

    def _added(self, equation, taken: list[int]) -> list[int]:
        operation, values = _operation(equation), [self.values[k] for k in taken]
        if all(value is not None for value in values):
            with np.errstate(all="ignore"):
                return [self.placed(value) for value in operation(*values)]
        name, none = equation.primitive.name, [_is_zero(value) for value in values]
        if any(none) and name in ("mul", "and"):
            return [self.placed(values[none.index(True)])]
        if any(none) and name in ("add", "add_any"):
            return [taken[none.index(False)]]
        if name == "select_n" and values[0] is not None and not values[0].shape:
            return [taken[1 + int(values[0])]]
        given = [self.placed() for _ in equation.outvars]
        self.steps.append((operation, taken, given))
        return given

    def needed(self, ends: list[int]) -> list[tuple[Callable, list[int], list[int]]]:
        """The steps that these places need."""
        places, kept = set(ends), []
        for step in reversed(self.steps):
            if places.intersection(step[2]):
                places |= set(step[1])
                kept.append(step)
        return kept[::-1]


def _is_zero(value) -> bool:
    return value is not None and not np.any(value)


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
        return lambda x: (np.asarray(x).astype(told["new_dtype"]),)
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
    """The same of arrays that are of the shapes of their variables."""
    name, told = equation.primitive.name, equation.params
    if name == "broadcast_in_dim":
        places = told["broadcast_dimensions"]

        def spread(x):
            shape = np.ones(len(told["shape"]), int)
            shape[list(places)] = x.shape
            return (np.reshape(x, shape),)

        return spread
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
