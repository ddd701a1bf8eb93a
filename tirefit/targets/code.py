"""Source code of a tire's forces: C, NumPy, JAX, CasADi, and a module for MuJoCo."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from tirefit.params import parameter_values
from tirefit.slip import CONVENTIONS
from tirefit.targets.program import Program, Term
from tirefit.targets.tire import ALWAYS, QUANTITIES, Tire


class Language(NamedTuple):
    """The syntax of the operations of a language."""

    usual: str  # name of a function, as a format of that of the operation
    calls: Mapping[str, str]
    """Operation -> another name of its function, or a format of the arguments."""
    number: Callable[[float], str]  # a constant
    line: str  # a statement that gives a value a name
    within: frozenset[str] = frozenset()
    """Operations that are written inline, as compilers do not vectorise loops with boolean
    variables."""


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


_TRUTHS = frozenset({"lt", "le", "gt", "ge", "eq", "ne", "and", "or", "not"})
"""Operations whose result is true or false."""

C = Language(
    "TIREFIT_F({})",
    _SIGNS | {
        "abs": "TIREFIT_F(fabs)", "cos": "TIREFIT_COS",
        "max": "({0} > {1} ? {0} : {1})", "min": "({0} < {1} ? {0} : {1})",
        "sign": "(tirefit_real)(({0} > 0) - ({0} < 0))", "where": "({0} ? {1} : {2})",
        "and": "({0} && {1})", "or": "({0} || {1})", "not": "!{}",
    },
    _in_c, "const tirefit_real {name} = {value};", _TRUTHS,
)  # fmt: skip

NUMPY = Language(
    "np.{}",
    _SIGNS | {
        "asin": "np.arcsin", "acos": "np.arccos", "atan": "np.arctan", "atan2": "np.arctan2",
        "asinh": "np.arcsinh", "pow": "np.power", "max": "np.maximum", "min": "np.minimum",
        "and": "np.logical_and", "or": "np.logical_or", "not": "np.logical_not",
    },
    _in_python, "{name} = {value}",
)  # fmt: skip

CASADI = Language(
    "ca.{}",
    _SIGNS | {
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
    return [_argument(program, language, output) for output in program.outputs.values()]


def _argument(program: Program, language: Language, arg: Term | float) -> str:
    if not isinstance(arg, Term):
        text = language.number(arg)
        return f"({text})" if text.startswith("-") else text
    op, args = program.operations[arg.place]
    if op in language.within:
        return f"({_expression(program, language, op, args)})"
    return program.inputs[args[0]] if op == "input" else f"t{arg.place}"


def _expression(program: Program, language: Language, op: str, args: Sequence[Term | float]) -> str:
    given = [_argument(program, language, arg) for arg in args]
    how = language.calls.get(op, language.usual.format(op))
    return how.format(*given) if "{" in how else f"{how}({', '.join(given)})"


def header(tire: Tire, program: Program, convention: str) -> list[str]:
    """Sentences on a tire at the beginning of every exported file."""
    names = (*program.inputs, *program.outputs)
    return [
        tire.origin,
        f"signs: {convention} ({CONVENTIONS[convention].description})",
        *("{} [{}]: {}".format(name, *QUANTITIES[name]).replace(" []", "") for name in names),
        "at low speed compute kappa with max(speed, a few tenths of a m/s)",
        f"measured range: {tire.ranges(convention)}",
        tire.listed,
        *(f"  {line}" for line in tire.parameters()),
        *tire.notes,
    ]


class Draft(NamedTuple):
    """The content from which a file is written."""

    tire: Tire  # the tire; ``forces`` is its program in the signs of ``convention``
    forces: Program
    convention: str
    above: Sequence[str]  # lines that stand first in the file
    name: str  # of the function, or of the file without its ending
    curves: Mapping[str, tuple[np.ndarray, np.ndarray]]
    """Force -> its slip and the pure force [N] at the load of the tire."""
    wheel: Mapping[str, float] = MappingProxyType({})  # what was given of the wheel, in SI units


def comments(lines: Iterable[str]) -> str:
    """Lines as comments of Python and YAML."""
    return "\n".join(f"# {line}" for line in lines)


def numpy_source(draft: Draft) -> str:
    """A Python module with one function of arrays; it needs only NumPy."""
    function = _numpy_function(draft.forces, draft.name)
    return f"{comments(draft.above)}\n\nimport numpy as np\n\n\n{function}\n"


def _numpy_function(program: Program, name: str) -> str:
    lines = [
        f"def {name}({', '.join(program.inputs)}):",
        f'    """Forces ({", ".join(program.outputs)}) of arrays or numbers."""',
        *body(program, NUMPY),
        f"    return ({', '.join(results(program, NUMPY))},)",
    ]
    return "\n".join(lines)


def compiled(program: Program) -> Callable[..., Any]:
    """A program as a Python function of numbers or arrays that returns a tuple."""
    scope: dict[str, Any] = {"np": np}
    exec(_numpy_function(program, "force"), scope)
    return scope["force"]


_CASADI = """\
{above}

import casadi as ca


def _build():
{lines}
    forces = ca.Function(
        {name!r}, [{given}], [{found}],
        {inputs}, {outputs},
    )
    slopes = ca.jacobian(ca.vertcat({found}), ca.vertcat({given}))
    return forces, ca.Function('{name}_jacobian', [{given}], [slopes])


{name}, {name}_jacobian = _build()
"""


def casadi_source(draft: Draft) -> str:
    """A Python module with a ``casadi.Function`` of scalars, and its Jacobian."""
    program, inputs = draft.forces, draft.forces.inputs
    lines = [*(f"    {name} = ca.SX.sym({name!r})" for name in inputs), *body(program, CASADI)]
    return _CASADI.format(
        above=comments(draft.above), lines="\n".join(lines), name=draft.name,
        given=", ".join(inputs), found=", ".join(results(program, CASADI)),
        inputs=list(inputs), outputs=list(program.outputs),
    )  # fmt: skip


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
/* Define TIREFIT_LOOP before the first header if a loop over arrays calls the function:
   gcc -O3 -march=native -ffast-math can then vectorise it, which it cannot for sine and
   cosine of the same angle. */
#ifdef TIREFIT_LOOP
#define TIREFIT_COS(angle) TIREFIT_F(sin)((angle) + TIREFIT_C(1.5707963267948966))
#define TIREFIT_INLINE static inline __attribute__((always_inline))
#else
#define TIREFIT_COS(angle) TIREFIT_F(cos)(angle)
#define TIREFIT_INLINE static inline
#endif
#endif
"""


def c_source(draft: Draft) -> str:
    """A C header: forces, and forces with their Jacobian by kappa, alpha and fz."""
    name, count = draft.name, len(draft.forces.outputs)
    call = f"{name}({', '.join(draft.forces.inputs)}, force);"
    above = [*draft.above, f"call: tirefit_real force[{count}]; {call}"]
    above += [f"force[{k}] is {output}" for k, output in enumerate(draft.forces.outputs)]
    # The text must not contain the beginning or end of a comment.
    messages = [line.replace("/*", "/ *").replace("*/", "* /") for line in above]
    force, slope = f"tirefit_real force[{count}]", f"slope[{count}][{ALWAYS}]"
    both = draft.tire.program(draft.convention, jacobian=True)
    functions = [
        *_c_function(draft.forces, name, [force], count), "",
        *_c_function(both, f"{name}_jacobian", [force, f"tirefit_real {slope}"], count),
    ]  # fmt: skip
    comment = "\n".join(["/*", *(f" * {line}" for line in messages), " */"])
    head = _C_HEAD.format(guard=f"TIREFIT_FILE_{name}")
    return "\n".join([comment, head, *functions, "", "#endif", ""])


def _c_function(program: Program, name: str, given: Iterable[str], count: int) -> list[str]:
    """A C function; outputs after the first ``count`` are derivatives, see :meth:`Tire.program`."""
    inputs = [f"tirefit_real {argument}" for argument in program.inputs]
    used = {args[0] for op, args in program.operations if op == "input"}
    unused = [argument for k, argument in enumerate(program.inputs) if k not in used]
    lines = [f"    (void){argument};" for argument in unused] + body(program, C)
    for k, result in enumerate(results(program, C)):
        by, force = divmod(k - count, count)
        place = f"force[{k}]" if k < count else f"slope[{force}][{by}]"
        lines.append(f"    {place} = {result};")
    head = f"TIREFIT_INLINE void {name}({', '.join([*inputs, *given])})"
    return [head, "{", *lines, "}"]


def jax_source(draft: Draft) -> str:
    """A Python module with a function of arrays; it needs only JAX."""
    return numpy_source(draft).replace("import numpy as np", "import jax.numpy as np", 1)


_SNIPPET = '''

def sysid_parameters(geoms):
    """Sliding friction of the geoms of the wheels as a mujoco.sysid.ParameterDict.

    Use it if MuJoCo's contact computes the tire forces. If the function above computes
    them (data.xfrc_applied), the geoms must have no friction.
    """
    from mujoco import sysid

    def write(spec, parameter):
        for name in geoms:
            geom = spec.geom(name)
            geom.friction = [parameter.value[0], *geom.friction[1:]]

    found = sysid.ParameterDict()
    found.add(
        sysid.Parameter(
            "tire_friction", nominal={peak!r}, min_value={low!r}, max_value={high!r},
            modifier=write,
        )
    )
    return found
'''


def mujoco_source(draft: Draft) -> str:
    """A Python module: the forces by NumPy, and the parameter of ``mujoco.sysid`` with bounds
    20 % below and above the peak, or three standard errors of the friction."""
    tire = draft.tire
    highest = [float(np.max(np.abs(force))) for _, force in draft.curves.values()]
    peak = max(highest, default=0.0) / tire.load
    share = 0.2
    if "mu" in tire.spread:
        share = 3.0 * tire.spread["mu"] / parameter_values(tire.model)["mu"]
    low, middle, high = (float(f"{(1 + k * share) * peak:.6g}") for k in (-1, 0, 1))
    return numpy_source(draft) + _SNIPPET.format(peak=middle, low=low, high=high)
