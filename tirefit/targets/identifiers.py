"""Names that a function in an exported file cannot have."""

import builtins
import keyword
import re
from pathlib import Path

_SHAPE = re.compile(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*", re.ASCII)
"""CasADi and C++ reserve two underscores in a row, C and Python one at the beginning. One at
the end and that of ``_jacobian`` would be two in a row."""

_C_NAMES = frozenset(
    name
    for line in Path(__file__).with_name("c_names.txt").read_text("ascii").splitlines()
    if not line.startswith("#")
    for name in line.split()
)
"""Keywords and macros of C and C++, and names in math.h, which the file includes."""

_IN_FILES = frozenset("np ca jax jnp base64 null jac hess tirefit_real sysid_parameters".split())
"""Names with another meaning in exported files; CasADi reserves null, jac and hess."""


def reserved(name: str) -> str:
    """Why a function in an exported file cannot have this name; empty if it can.

    The function is written into C headers, which include ``math.h``, and Python modules.
    """
    if not _SHAPE.fullmatch(name):
        return "it is not letters and digits, with single underscores between them"
    if not re.search("[a-z]", name):
        return "it has no lower-case letter, like a macro of C"
    stem = re.sub("(f[0-9]+x?|f|l)$", "", name)  # sinf, sinl and sinf64x are of the type
    if {name, stem} & _C_NAMES:
        return "C has this name"
    if keyword.iskeyword(name) or hasattr(builtins, name) or name in _IN_FILES:
        return "Python or the exported file has this name"
    return ""
