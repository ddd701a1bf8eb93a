"""Functions of arrays that JAX can trace, evaluated by NumPy: nothing is compiled."""

from collections.abc import Callable
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


def by_numpy(function: Callable, *example: Any) -> Callable:
    """The function, for arguments of the shapes of an example.

    What has one value for all rows may come back as that. Primitives without a
    counterpart here are left to JAX.
    """
    closed, shape = jax.make_jaxpr(function, return_shape=True)(*example)
    structure = jax.tree.structure(shape)
    values: list[Any] = [None] * len(closed.jaxpr.invars)
    steps: list[tuple[Callable, list[int], list[int]]] = []

    def placed(value=None) -> int:
        values.append(value)
        return len(values) - 1

    def flattened(jaxpr, constants, places: list[int]) -> list[int]:
        where = dict(zip(jaxpr.invars, places, strict=True))
        where |= {v: placed(c) for v, c in zip(jaxpr.constvars, constants, strict=True)}

        def place(atom) -> int:
            if isinstance(atom, Literal):
                return placed(np.asarray(atom.val))
            return where[atom]

        for equation in jaxpr.eqns:
            taken = [place(atom) for atom in equation.invars]
            inner = equation.params.get(_WITHIN.get(equation.primitive.name))
            if inner is not None:
                given = flattened(inner.jaxpr, inner.consts, taken)
            else:
                given = [placed() for _ in equation.outvars]
                steps.append((_operation(equation), taken, given))
            where |= zip(equation.outvars, given, strict=True)
        return [place(atom) for atom in jaxpr.outvars]

    ends = flattened(closed.jaxpr, closed.consts, list(range(len(values))))
    needed, kept = set(ends), []
    for step in reversed(steps):
        if needed.intersection(step[2]):
            needed |= set(step[1])
            kept.append(step)

    def evaluated(*arguments):
        found = values.copy()
        leaves = jax.tree.leaves(arguments)
        found[: len(leaves)] = leaves
        with np.errstate(all="ignore"):
            for operation, taken, given in reversed(kept):
                result = operation(*[found[place] for place in taken])
                for place, value in zip(given, result, strict=True):
                    found[place] = value
        return jax.tree.unflatten(structure, [found[place] for place in ends])

    return evaluated


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
    return lambda *x: exact(
        *(np.broadcast_to(one, shape) for one, shape in zip(x, shapes, strict=True))
    )


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
    if name == "slice" and told["strides"] is None:
        ranges = zip(told["start_indices"], told["limit_indices"], strict=True)
        part = tuple(slice(*each) for each in ranges)
        return lambda x: (x[part],)
    if name == "reduce_sum":
        return lambda x: (np.sum(x, axis=told["axes"]),)

    def by_jax(*x):
        found = equation.primitive.bind(*x, **told)
        several = equation.primitive.multiple_results
        return tuple(map(np.asarray, found if several else (found,)))

    return by_jax
