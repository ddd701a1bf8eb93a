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
"""Keywords and macros of C and C++, and names in the headers of C, POSIX and GNU."""

_GROUPS = re.compile(
    "(atomic|memory_order|mtx|cnd|thrd|tss|stdc)_.*|(PRI|SCN).*|L_.*|.*_t|.*_r"
    "|w?mem(chr|cmp|cpy|ccpy|move|set|set_explicit|alignment)"
    "|(str|wcs)(n?cat|n?cmp|n?cpy|n?dup|r?chr|coll|c?spn|error|f?time|len|pbrk|str|tok|xfrm|from"
    "|to[dfu]|tou?ll?|told|to[iu]max|fromd|fromf|froml|rtombs)"
    "|(is|to)w?(alnum|alpha|blank|cntrl|ctype|digit|graph|lower|print|punct|space|upper"
    "|xdigit)|towctrans|wctrans|wctype|wctob|wctomb|wcstombs|wcrtomb|c(8|16|32)rtomb"
    "|mb(r?len|r?to(wc|c8|c16|c32)|sr?towcs)|(f?get|f?put|unget)w?(c|s|char)"
    "|v?(f|s|sn)?w?printf|v?(f|s)?w?scanf|v?[fs]w(print|scan)f"
    "|fe(clear|get|raise|set|hold|test|update)(except|env|exceptflag|round|mode)"
    "|(pthread|sched|timer|clock|posix|sigev|si|sa|st|M|program_invocation)_.*"
    "|.*_(np|unlocked)|(is|to|str|wc).*_l|str(to|from)f[0-9]+x?|wcstof[0-9]+x?"
    "|f(32|64)x?(add|sub|mul|div|fma|sqrt)(f[0-9]+x?)?|exec(l|le|lp|ve?|vpe?|veat)"
    "|(be|le)(16|32|64)toh|hto(be|le)(16|32|64)"
)
"""Groups of names in these headers."""
_IN_FILES = frozenset("np ca jax jnp base64 null jac hess tirefit_real sysid_parameters".split())
"""Names with another meaning in exported files; CasADi reserves null, jac and hess."""


def reserved(name: str) -> str:
    """Why a function in an exported file cannot have this name; empty if it can.

    The function is written into C headers, which are compiled with others of the
    standard library, and into Python modules.
    """
    if not _SHAPE.fullmatch(name):
        return "it is not letters and digits, with single underscores between them"
    if not re.search("[a-z]", name):
        return "it has no lower-case letter, like a macro of C"
    stem = re.sub("(f[0-9]+x?|f|l)$", "", name)  # sinf, sinl and sinf64x are of the type
    if {name, stem, name.removesuffix("64")} & _C_NAMES or _GROUPS.fullmatch(name):
        return "C has this name"
    if keyword.iskeyword(name) or hasattr(builtins, name) or name in _IN_FILES:
        return "Python or the exported file has this name"
    return ""
