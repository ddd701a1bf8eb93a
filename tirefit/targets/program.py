"""Straight-line programs of the forces of a model, traced from its JAX function.

A model is written once, in JAX. :func:`traced` converts that function, with its parameter
values, to a list of scalar operations that :mod:`tirefit.targets.code` prints in other
languages, so that no formula is written twice.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.extend import core

_COMMUTE = frozenset({"add", "mul", "min", "max", "eq"})
MOST_OPERATIONS = 20_000
"""Largest number of operations that other compilers can handle."""
_MOST_TRIED = 10 * MOST_OPERATIONS  # largest number of operations including unused ones
_TOO_LONG = f"it takes over {MOST_OPERATIONS} operations"
LEAST = 1e-36
"""The smallest positive constant of a program."""


class Operation(NamedTuple):
    """``op`` of arguments, each a constant or a :class:`Term`."""

    op: str
    args: tuple[Any, ...]


@dataclass(frozen=True, order=True, slots=True)
class Term:
    """A value that depends on the inputs: the number of the operation that gives it."""

    place: int


class Graph:
    """Operations in order; equal ones are shared, and constants are folded."""

    def __init__(self) -> None:
        self.operations: list[Operation] = []
        self._known: dict[Operation, Term] = {}

    def term(self, op: str, *args: Any) -> Term:
        """The term of an operation."""
        key = Operation(op, args)
        if key not in self._known:
            if len(self.operations) >= _MOST_TRIED:
                raise NotImplementedError(_TOO_LONG)
            self._known[key] = Term(len(self.operations))
            self.operations.append(key)
        return self._known[key]

    def apply(self, op: str, *args: Any) -> Any:
        """The result of an operation on terms and constants: a term or a constant."""
        if not any(isinstance(arg, Term) for arg in args):
            with np.errstate(all="ignore"):
                return _OPERATIONS[op](*args).item()
        if op in _COMMUTE:  # constants first
            args = tuple(sorted(args, key=lambda arg: (isinstance(arg, Term), arg)))
        simpler = _simplified(self, op, args)
        return self.term(op, *args) if simpler is None else simpler


class Program(NamedTuple):
    """A function of scalars as operations."""

    inputs: tuple[str, ...]  # names of the arguments, in order
    outputs: dict[str, Any]  # name and value of each result: a :class:`Term` or a constant
    operations: list[Operation]  # in order; ``("input", (k,))`` is the k-th argument


def traced(
    function: Callable[..., Any],
    inputs: Sequence[str],
    outputs: Sequence[str],
    by: Sequence[int] = (),
) -> Program:
    """The program of a JAX function of scalars.

    Args:
        function: of ``len(inputs)`` scalars, to a tuple of ``len(outputs)`` scalars.
        inputs, outputs: names.
        by: numbers of inputs by which the results are differentiated. The derivatives
            by each of these inputs follow the results, named ``fx_kappa``.

    Raises:
        NotImplementedError: the function has a loop of unknown length, an operation
            that other languages lack, or too many operations.
    """
    graph, count = Graph(), len(inputs)
    given = [_array(graph.term("input", k)) for k in range(count)]

    # Trace the derivative once, with the direction as further inputs.
    def both(at: Sequence[Any], along: Sequence[Any]) -> Any:
        return jax.jvp(function, tuple(at), tuple(along)) if by else function(*at)

    ones = [1.0] * count
    closed, by_name = jax.make_jaxpr(both)(ones, ones), dict[str, Any]()
    for k in by or [0]:
        along = [_array(float(j == k)) for j in range(count)]
        values = _evaluate(graph, closed.jaxpr, closed.consts, given + along)
        names = [*outputs, *(f"{name}_{inputs[k]}" for name in outputs if by)]
        by_name |= dict(zip(names, values, strict=True))
    results = {name: value.item() for name, value in by_name.items()}
    program = _pruned(Program(tuple(inputs), results, graph.operations))
    if len(program.operations) > MOST_OPERATIONS:
        raise NotImplementedError(_TOO_LONG)
    return program


def _array(value: object) -> np.ndarray:
    array = np.empty((), object)
    array[()] = value
    return array


def _evaluate(
    graph: Graph, jaxpr: core.Jaxpr, consts: Sequence[Any], given: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """The results of a jaxpr on arrays of terms and constants."""
    known = dict(zip(jaxpr.constvars, map(np.asarray, consts), strict=True))
    known |= dict(zip(jaxpr.invars, given, strict=True))

    def read(atom: Any) -> np.ndarray:
        if not isinstance(atom, core.Literal):
            return known[atom]
        # A smaller number, which keeps a length from being zero, would be zero in single precision.
        value = np.asarray(atom.val)
        return np.maximum(value, LEAST) if 0 < value < LEAST else value

    for equation in jaxpr.eqns:
        values = [read(atom) for atom in equation.invars]
        results = _result(graph, equation, values)
        known |= dict(zip(equation.outvars, results, strict=True))
    return [read(atom) for atom in jaxpr.outvars]


def _result(graph: Graph, equation: core.JaxprEqn, values: list[np.ndarray]) -> list[np.ndarray]:
    name, how = equation.primitive.name, equation.params
    if name in ("jit", "pjit", "closed_call", "custom_jvp_call", "custom_vjp_call"):
        inner: Any = how.get("jaxpr") or how.get("call_jaxpr") or how.get("fun_jaxpr")
        return _evaluate(graph, inner.jaxpr, inner.consts, values)
    if name == "scan":
        return _unrolled(graph, how, values)
    if name in _SHAPES:
        return [_SHAPES[name](values, how)]
    if name in ("integer_pow", "square"):
        y = how.get("y", 2)
        return [_each(graph, lambda g, x: _power(g, x, y), values)]
    if name == "rsqrt":
        root = _each(graph, lambda g, x: g.apply("sqrt", x), values)
        return [_each(graph, lambda g, x: g.apply("div", 1.0, x), [root])]
    if name in ("reduce_sum", "reduce_max"):
        op = {"reduce_sum": "add", "reduce_max": "max"}[name]
        pair = np.frompyfunc(lambda x, y: graph.apply(op, x, y), 2, 1)
        total = values[0].astype(object)
        for axis in sorted(how["axes"], reverse=True):
            total = np.asarray(pair.reduce(total, axis=axis), object)
        return [total]
    if name == "select_n":
        condition, no, yes = values
        name, values = "where", [condition, yes, no]
    result: Any = equation.outvars[0].aval
    if name in _UNCHANGED and not np.issubdtype(result.dtype, int):
        return values
    name = "add" if name == "add_any" else name
    if name not in _OPERATIONS:
        raise NotImplementedError(f"it has no operation {name}")
    return [_each(graph, lambda g, *args: g.apply(name, *args), values)]


def _unrolled(graph: Graph, how: Mapping[str, Any], values: list[np.ndarray]) -> list[np.ndarray]:
    """A loop of known length, step by step."""
    first, last = how["num_consts"], how["num_consts"] + how["num_carry"]
    consts, carry, over = values[:first], values[first:last], values[last:]
    order = range(how["length"])
    steps = []
    for k in reversed(order) if how["reverse"] else order:
        inner = how["jaxpr"]
        given = [*consts, *carry, *(each[k] for each in over)]
        given = [g if isinstance(g, np.ndarray) else _array(g) for g in given]
        results = _evaluate(graph, inner.jaxpr, inner.consts, given)
        carry = results[: how["num_carry"]]
        steps.append(results[how["num_carry"] :])
    if how["reverse"]:
        steps.reverse()
    stacked = [np.stack(rows) for rows in zip(*steps, strict=True)] if steps else []
    return [*carry, *stacked]


def _each(graph: Graph, function: Callable[..., Any], values: Sequence[np.ndarray]) -> np.ndarray:
    """A function of scalars on arrays."""
    arrays = np.broadcast_arrays(*values)
    result = np.empty(arrays[0].shape, object)
    for at in np.ndindex(result.shape):
        result[at] = function(graph, *(_plain(array[at]) for array in arrays))
    return result


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def _power(graph: Graph, x: Any, y: int) -> Any:
    """An integer power as products."""
    if y < 0:
        return _power(graph, graph.apply("div", 1.0, x), -y)
    result, square = 1.0, x
    while y:
        if y & 1:
            result = graph.apply("mul", result, square)
        y >>= 1
        square = graph.apply("mul", square, square) if y else square
    return result


def _simplified(graph: Graph, op: str, args: tuple[Any, ...]) -> Any:
    """An equivalent of an operation that is simpler and differs by rounding at most; None
    if there is none.

    A product with an exact zero is zero, as the derivative by an input without effect.

    Args:
        args: terms and constants; not only constants.
    """
    apply, x, y = graph.apply, args[0], args[-1]

    def known(*values: object) -> bool:
        return not any(isinstance(value, Term) for value in values)

    # A term is matched by its operation and arguments, a constant by its value.
    match (op, *(arg if known(arg) else graph.operations[arg.place] for arg in args)):
        case ("add", 0.0, _):
            return y
        case ("sub", _, 0.0) | ("pow", _, 1.0):
            return x
        case ("sub", 0.0, _) | ("mul", -1.0, _):
            return apply("neg", y)
        case ("mul" | "div", 0.0, _):
            return 0.0
        case ("mul", 1.0, _):
            return y
        case ("mul", _, ("mul", (a, b))) if known(x, a):
            return apply("mul", x * a, b)
        case ("div", _, _) if known(y):
            usual = y != 0.0 and math.isfinite(1 / y)
            return apply("mul", 1 / y, x) if usual else None
        case ("div", _, ("mul", (a, b))) if known(a):
            return apply("mul", 1 / a, apply("div", x, b))
        case ("pow", _, 0.5):
            return apply("sqrt", x)
        case ("pow", _, 2.0):
            return apply("mul", x, x)
        case ("where", _, _, _) if known(x):
            return args[1] if x else y
        case ("where", _, _, _) if args[1] == y:
            return y
    return None


def _pruned(program: Program) -> Program:
    """The program without unused operations."""
    used, wanted = set(), [v for v in program.outputs.values() if isinstance(v, Term)]
    while wanted:
        term = wanted.pop()
        if term.place not in used:
            used.add(term.place)
            args = program.operations[term.place].args
            wanted += [arg for arg in args if isinstance(arg, Term)]
    kept = [(k, operation) for k, operation in enumerate(program.operations) if k in used]
    new = {old: k for k, (old, _) in enumerate(kept)}

    def placed(value: Any) -> Any:
        return Term(new[value.place]) if isinstance(value, Term) else value

    operations = [Operation(o.op, tuple(map(placed, o.args))) for _, o in kept]
    outputs = {name: placed(value) for name, value in program.outputs.items()}
    return Program(program.inputs, outputs, operations)


_OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide,
    "neg": np.negative, "max": np.maximum, "min": np.minimum, "abs": np.abs,
    "sign": np.sign, "sqrt": np.sqrt, "cbrt": np.cbrt, "exp": np.exp,
    "expm1": np.expm1, "log": np.log, "log1p": np.log1p, "pow": np.power,
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos,
    "atan": np.arctan, "atan2": np.arctan2, "sinh": np.sinh, "cosh": np.cosh,
    "tanh": np.tanh, "asinh": np.arcsinh, "lt": np.less, "le": np.less_equal,
    "gt": np.greater, "ge": np.greater_equal, "eq": np.equal, "ne": np.not_equal,
    "and": np.logical_and, "or": np.logical_or, "not": np.logical_not,
    "where": np.where,
}  # fmt: skip
"""Operation of a program -> its function of constants. All but ``where`` have their names
in JAX."""
_UNCHANGED = ("stop_gradient", "convert_element_type", "copy")
"""Operations of JAX that do not change values, except for conversion to integers."""

_SHAPES: dict[str, Callable[..., Any]] = {
    "broadcast_in_dim": lambda v, how: np.broadcast_to(
        np.asarray(v[0]).reshape([
            n if k in how["broadcast_dimensions"] else 1
            for k, n in enumerate(how["shape"])
        ] if np.ndim(v[0]) else ()), how["shape"]),
    "reshape": lambda v, how: v[0].reshape(how["new_sizes"]),
    "squeeze": lambda v, how: np.squeeze(v[0], tuple(how["dimensions"])),
    "slice": lambda v, how: v[0][tuple(
        slice(*each) for each in zip(
            how["start_indices"], how["limit_indices"],
            how["strides"] or [1] * len(how["start_indices"]), strict=True)
    )],
    "concatenate": lambda v, how: np.concatenate(v, how["dimension"]),
    "stack": lambda v, how: np.stack(v, how["axis"]),
}  # fmt: skip
"""Operations that only move values."""
