"""Source code of a tire's forces: C, NumPy and CasADi."""

from collections.abc import Sequence

import numpy as np

from tirefit.slip import CONVENTIONS
from tirefit.targets.languages import CASADI, NUMPY, C, body, value
from tirefit.targets.program import Program
from tirefit.targets.tire import ALWAYS, UNITS, Tire

MEANING = {
    "kappa": "practical slip: sliding speed over forward speed of the wheel centre",
    "alpha": "slip angle", "fz": "load", "v": "forward speed of the wheel centre",
    "gamma": "camber", "pressure": "inflation pressure (0: nominal)",
    "fx": "longitudinal force", "fy": "lateral force", "mz": "aligning moment",
    "mx": "overturning moment", "my": "rolling resistance moment",
}  # fmt: skip

_VECTORS = ((0.02, 0.01, 1.0), (-0.1, 0.05, 0.5), (0.0, -0.2, 1.5), (-0.9, 0.3, 2.0))
"""Slip, slip angle and share of the middle load of the test vectors."""


def header(tire: Tire, program: Program, convention: str) -> list[str]:
    """Sentences on a tire that stand first in every exported file."""
    names = (*program.inputs, *program.outputs)
    return [
        *tire.origin,
        f"signs: {convention} ({CONVENTIONS[convention].description})",
        *(f"{name} [{UNITS[name]}]: {MEANING[name]}" for name in names),
        "at low speed compute kappa with max(speed, a few tenths of a m/s)",
        f"measured: {tire.ranges()}; beyond it the model extrapolates",
        "parameters (+- standard error):",
        *(f"  {line}" for line in tire.parameters()),
        *tire.notes,
    ]


def numpy_source(
    tire: Tire, program: Program, convention: str, above: Sequence[str], name: str
) -> str:
    """A Python module with one function of arrays; it needs NumPy alone."""
    del tire, convention
    results = ", ".join(value(program, NUMPY, out) for out in program.outputs)
    lines = [
        *(f"# {line}" for line in above), "", "import numpy as np", "", "",
        f"def {name}({', '.join(program.inputs)}):",
        f'    """Forces ({", ".join(program.outputs)}) of arrays or numbers."""',
        *body(program, NUMPY),
        f"    return {results}{',' if len(program.outputs) == 1 else ''}",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def casadi_source(
    tire: Tire, program: Program, convention: str, above: Sequence[str], name: str
) -> str:
    """A Python module with a ``casadi.Function`` of scalars, and its Jacobian."""
    del tire, convention
    given = ", ".join(program.inputs)
    results = ", ".join(value(program, CASADI, out) for out in program.outputs)
    outputs = ", ".join(repr(out) for out in program.outputs)
    inputs = ", ".join(repr(one) for one in program.inputs)
    lines = [
        *(f"# {line}" for line in above), "", "import casadi as ca", "", "",
        "def _build():",
        *(f"    {one} = ca.SX.sym({one!r})" for one in program.inputs),
        *body(program, CASADI),
        "    forces = ca.Function(",
        f"        {name!r}, [{given}], [{results}], [{inputs}], [{outputs}]",
        "    )",
        f"    at = ca.vertcat({given})",
        f"    slopes = ca.jacobian(ca.vertcat({results}), at)",
        f"    return forces, ca.Function({name + '_jacobian'!r}, [{given}], [slopes])",
        "", "",
        f"{name}, {name}_jacobian = _build()",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def vectors(tire: Tire, program: Program, function) -> list[str]:
    """Inputs and forces to check a program by, a line each.

    Args:
        function: of the program's inputs, to its outputs.
    """
    sign = {"kappa": 1.0, "alpha": 1.0, "fz": 1.0}
    middle = {"v": 10.0, "gamma": 0.02, "pressure": 0.0}
    lines, names = [], tuple(program.outputs)
    for kappa, alpha, share in _VECTORS:
        at = sign | middle | {"kappa": kappa, "alpha": alpha, "fz": share * tire.load}
        given = [float(f"{at[name]:.6g}") for name in program.inputs]
        found = function(*given)
        lines.append(f"{_named(program.inputs, given)} -> {_named(names, found)}")
    return lines


def _named(names, values) -> str:
    each = zip(names, values, strict=True)
    return ", ".join(f"{name}={float(x):.17g}" for name, x in each)


_C_HEAD = """\
#ifndef {guard}
#define {guard}
#include <math.h>

/* Define TIREFIT_SINGLE before the first header for single precision. */
#ifndef TIREFIT_C
#ifdef TIREFIT_SINGLE
typedef float tirefit_real;
#define TIREFIT_F(name) name##f
#else
typedef double tirefit_real;
#define TIREFIT_F(name) name
#endif
#define TIREFIT_C(number) ((tirefit_real)(number))
#endif
"""


def c_source(
    tire: Tire, program: Program, convention: str, above: Sequence[str], name: str
) -> str:
    """A C header: forces, and forces with their Jacobian by kappa, alpha and fz."""
    lines = ["/*", *(f" * {line.replace('*/', '* /')}" for line in above)]
    lines += [" * test vectors:"]
    lines += [f" *   {line}" for line in vectors(tire, program, compiled(program))]
    lines += [" */", _C_HEAD.format(guard=f"{name.upper()}_H")]
    count = len(program.outputs)
    lines += _c_function(program, name, [f"tirefit_real force[{count}]"], count)
    both = tire.program(convention, jacobian=True)
    there = [f"tirefit_real force[{count}]", f"tirefit_real slope[{count}][{ALWAYS}]"]
    lines += ["", *_c_function(both, f"{name}_jacobian", there, count)]
    return "\n".join([*lines, "", "#endif", ""])


def _c_function(program: Program, name: str, results, count: int) -> list[str]:
    inputs = [f"tirefit_real {one}" for one in program.inputs]
    lines = [f"static inline void {name}({', '.join([*inputs, *results])})", "{"]
    used = {args[0] for op, args in program.operations if op == "input"}
    unused = [one for k, one in enumerate(program.inputs) if k not in used]
    lines += [f"    (void){one};" for one in unused]
    lines += body(program, C)
    outputs = list(program.outputs)
    for k, out in enumerate(outputs):
        place = f"force[{k}]"
        if k >= count:
            by, force = divmod(k - count, count)
            place = f"slope[{force}][{by}]"
        lines.append(f"    {place} = {value(program, C, out)};")
    return [*lines, "}"]


def compiled(program: Program):
    """A program as a Python function of numbers or arrays."""
    results = ", ".join(value(program, NUMPY, out) for out in program.outputs)
    lines = [f"def force({', '.join(program.inputs)}):", *body(program, NUMPY)]
    scope: dict = {"np": np}
    exec("\n".join([*lines, f"    return ({results},)"]), scope)
    return scope["force"]
