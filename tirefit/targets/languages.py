"""Print programs as statements of C, NumPy and CasADi."""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

from tirefit.targets.program import Place, Program


class Language(NamedTuple):
    """The syntax of the operations of a language.

    Attributes:
        calls: operation -> name of a function, or a format of the arguments.
        number: a constant.
        line: a statement that gives a value a name.
        within: operations that are written inline, as compilers do not vectorise loops
            with boolean variables.
    """

    calls: Mapping[str, str]
    number: Callable[[float], str]
    line: str
    within: frozenset[str] = frozenset()


_SIGNS = {
    "add": "{} + {}", "sub": "{} - {}", "mul": "{} * {}", "div": "{} / {}",
    "neg": "-{}", "lt": "{} < {}", "le": "{} <= {}", "gt": "{} > {}", "ge": "{} >= {}",
    "eq": "{} == {}", "ne": "{} != {}",
}  # fmt: skip


def _in_python(value: float) -> str:
    text = repr(float(value))
    return text if math.isfinite(value) else f"float({text!r})"


def _in_c(value: float) -> str:
    text = repr(float(value))
    return f"TIREFIT_C({text.replace('inf', 'INFINITY').replace('nan', 'NAN')})"


def _functions(prefix: str, names: Iterable[str]) -> dict[str, str]:
    return {name: prefix.format(name) for name in names}


TRUTHS = frozenset({"lt", "le", "gt", "ge", "eq", "ne", "and", "or", "not"})
"""Operations whose result is true or false."""

_COMMON = ("sqrt", "exp", "expm1", "log", "log1p", "sin", "cos", "tan", "sinh", "cosh", "tanh")
_ARCS = ("asin", "acos", "atan", "asinh")

C = Language(
    _SIGNS
    | _functions("TIREFIT_F({})", (*_COMMON, *_ARCS, "cbrt", "pow", "atan2"))
    | {
        "abs": "TIREFIT_F(fabs)",
        "max": "({0} > {1} ? {0} : {1})",
        "min": "({0} < {1} ? {0} : {1})",
        "sign": "(tirefit_real)(({0} > 0) - ({0} < 0))",
        "where": "({0} ? {1} : {2})",
        "and": "({0} && {1})",
        "or": "({0} || {1})",
        "not": "!{}",
        "cos": "TIREFIT_COS",
    },
    _in_c,
    "const tirefit_real {name} = {value};",
    TRUTHS,
)

NUMPY = Language(
    _SIGNS
    | _functions("np.{}", (*_COMMON, "cbrt", "sign"))
    | {name: f"np.arc{name[1:]}" for name in (*_ARCS, "atan2")}
    | {
        "pow": "np.power",
        "abs": "np.abs",
        "max": "np.maximum",
        "min": "np.minimum",
        "where": "np.where",
        "and": "np.logical_and",
        "or": "np.logical_or",
        "not": "np.logical_not",
    },
    _in_python,
    "{name} = {value}",
)

CASADI = Language(
    _SIGNS | _functions("ca.{}", (*_COMMON, *_ARCS, "atan2", "sign"))
    | {
        "pow": "{} ** {}", "cbrt": "ca.sign({0}) * ca.fabs({0}) ** (1 / 3)",
        "abs": "ca.fabs", "max": "ca.fmax", "min": "ca.fmin", "where": "ca.if_else",
        "and": "ca.logic_and", "or": "ca.logic_or", "not": "ca.logic_not",
    },
    _in_python, "{name} = {value}",
)  # fmt: skip


def body(program: Program, language: Language, indent: str = "    ") -> list[str]:
    """Statements of the operations of a program, one per line.

    The inputs keep their names; the k-th operation is named ``t{k}``, or written inline
    if it is a condition of C.
    """
    lines = []
    for k, (op, args) in enumerate(program.operations):
        if op == "input" or op in language.within:
            continue
        value = _expression(program, language, op, args)
        lines.append(indent + language.line.format(name=f"t{k}", value=value))
    return lines


def results(program: Program, language: Language) -> list[str]:
    """The outputs of a program as expressions."""
    return [_argument(program, language, one) for one in program.outputs.values()]


def _argument(program: Program, language: Language, arg) -> str:
    if not isinstance(arg, Place):
        text = language.number(arg)
        return f"({text})" if text.startswith("-") else text
    op, args = program.operations[arg]
    if op in language.within:
        return f"({_expression(program, language, op, args)})"
    return program.inputs[args[0]] if op == "input" else f"t{arg}"


def _expression(program: Program, language: Language, op: str, args) -> str:
    given = [_argument(program, language, arg) for arg in args]
    how = language.calls[op]
    return how.format(*given) if "{" in how else f"{how}({', '.join(given)})"
