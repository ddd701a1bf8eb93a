"""Rules that simplify operations without changing results beyond rounding."""

import math
from collections.abc import Callable
from typing import Any

_COMMUTE = frozenset({"add", "mul", "min", "max", "eq"})


def in_order(op: str, args: tuple, is_term: Callable[..., bool]) -> tuple:
    """Arguments of a commutative operation in canonical order: constants first."""
    if op not in _COMMUTE:
        return args
    return tuple(sorted(args, key=lambda one: (is_term(one), one)))


def simplified(graph: Any, op: str, args: tuple) -> Any:
    """A simpler equivalent of an operation; None if there is none.

    A product with an exact zero is zero, as the derivative by an input without effect.

    Args:
        graph: with ``apply(op, *args)``, and ``parts(value)``: operation and arguments
            of a term, ("", ()) for a constant.
        args: terms and constants; not only constants.
    """
    rule = _RULES.get(op)
    return None if rule is None else rule(graph, *args)


def _constant(graph, value) -> bool:
    return graph.parts(value)[0] == ""


def _add(graph, x, y):
    if _constant(graph, x) and x == 0.0:
        return y
    for one, other in ((x, y), (y, x)):
        op, args = graph.parts(one)
        if op == "neg":
            return graph.apply("sub", other, args[0])
    return None


def _sub(graph, x, y):
    if _constant(graph, y) and y == 0.0:
        return x
    if _constant(graph, x) and x == 0.0:
        return graph.apply("neg", y)
    op, args = graph.parts(y)
    return graph.apply("add", x, args[0]) if op == "neg" else None


def _mul(graph, x, y):
    if _constant(graph, x):
        if x in (0.0, 1.0, -1.0):
            return 0.0 if x == 0.0 else y if x == 1.0 else graph.apply("neg", y)
        op, args = graph.parts(y)
        if op == "mul" and _constant(graph, args[0]):
            return graph.apply("mul", x * args[0], args[1])
        return graph.apply("mul", -x, args[0]) if op == "neg" else None
    for one, other in ((x, y), (y, x)):
        op, args = graph.parts(one)
        if op == "neg":
            return graph.apply("neg", graph.apply("mul", args[0], other))
    return None


def _div(graph, x, y):
    if _constant(graph, x) and x == 0.0:
        return 0.0
    if _constant(graph, y):
        usual = y != 0.0 and math.isfinite(1 / y)
        return graph.apply("mul", 1 / y, x) if usual else None
    op, args = graph.parts(x)
    if op == "neg":
        return graph.apply("neg", graph.apply("div", args[0], y))
    op, args = graph.parts(y)
    if op == "neg":
        return graph.apply("neg", graph.apply("div", x, args[0]))
    if op == "mul" and _constant(graph, args[0]):
        return graph.apply("mul", 1 / args[0], graph.apply("div", x, args[1]))
    if op == "where" and all(_constant(graph, one) and one for one in args[1:]):
        part = graph.apply("where", args[0], 1 / args[1], 1 / args[2])
        return graph.apply("mul", x, part)
    return None


def _neg(graph, x):
    op, args = graph.parts(x)
    if op == "neg":
        return args[0]
    if op == "sub":
        return graph.apply("sub", args[1], args[0])
    if op == "mul" and _constant(graph, args[0]):
        return graph.apply("mul", -args[0], args[1])
    return None


def _pow(graph, x, y):
    if not _constant(graph, y) or y not in (0.0, 0.5, 1.0, 2.0):
        return None
    if y == 0.5:
        return graph.apply("sqrt", x)
    return {0.0: 1.0, 1.0: x, 2.0: graph.apply("mul", x, x)}[y]


def _where(graph, condition, yes, no):
    if _constant(graph, condition):
        return yes if condition else no
    return yes if yes == no else None


_RULES: dict[str, Callable] = {
    "add": _add,
    "sub": _sub,
    "mul": _mul,
    "div": _div,
    "neg": _neg,
    "pow": _pow,
    "where": _where,
}
