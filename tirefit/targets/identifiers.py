"""Names that a function in an exported file cannot have."""

import builtins
import keyword
import re

_SHAPE = re.compile(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*", re.ASCII)
"""CasADi and C++ reserve two underscores in a row, C and Python one at the beginning. One at
the end and that of ``_jacobian`` would be two in a row."""

_KEYWORDS = frozenset(
    "alignas alignof and and_eq asm auto bitand bitor bool break case catch char char8_t"
    " class compl complex concept const consteval constexpr constinit const_cast continue"
    " co_await co_return co_yield decltype default defined delete do double dynamic_cast"
    " else enum explicit export extern false float for friend goto if imaginary inline int"
    " linux long mutable namespace new noexcept noreturn not not_eq nullptr operator or or_eq"
    " private protected public register reinterpret_cast requires restrict return short"
    " signed sizeof static static_assert static_cast struct switch template this"
    " thread_local throw true try typedef typeid typename typeof typeof_unqual union unix"
    " unsigned using virtual void volatile while xor xor_eq".split()
)
"""Keywords of C to C23 and of C++, macros that replace keywords, and macros of GCC."""

_MATH = frozenset(
    "acos acosh acospi asin asinh asinpi atan atan2 atan2pi atanh atanpi cabs cacos cacosh"
    " carg casin casinh catan catanh cbrt ccos ccosh ceil cexp cimag clog clog10 conj"
    " copysign cos cosh cospi canonicalize cpow cproj creal csin csinh csqrt ctan ctanh dadd ddiv"
    " dfma dmul drem dsqrt dsub erf erfc exp exp10 exp10m1 exp2 exp2m1 expm1 fabs fadd"
    " fdim fdiv ffma finite floor fma fmax fmaximum fmaximum_mag fmaximum_mag_num"
    " fmaximum_num fmin fminimum fminimum_mag fminimum_mag_num fminimum_num fmod fmul frexp"
    " fromfp fromfpx fsqrt fsub gamma getpayload hypot ilogb isinf isnan j0 j1 jn ldexp"
    " lgamma llogb llrint llround log log10 log10p1 log1p log2 log2p1 logb logp1 lrint"
    " lround modf nan nearbyint nextafter nextdown nexttoward nextup pow pow10 pown powr"
    " remainder remquo rint rootn round roundeven rsqrt scalb scalbln scalbn setpayload"
    " setpayloadsig significand sin sincos sinh sinpi sqrt tan tanh tanpi tgamma totalorder"
    " totalordermag trunc ufromfp ufromfpx y0 y1 yn".split()
)
"""Functions of math.h and complex.h, also of POSIX, GNU and C23, without f or l at the end."""

_LIBRARY = frozenset(
    "abort abs aligned_alloc asctime assert at_quick_exit atexit atof atoi atol atoll bsearch"
    " btowc call_once calloc clearerr clock ctime difftime div errno exit fclose"
    " feof ferror fflush fgetpos fopen fpclassify fputs fgets fread free freopen frexp fseek"
    " fsetpos ftell fwide fwrite getenv gets gmtime imaxabs imaxdiv iscanonical iseqsig"
    " isfinite isgreater isgreaterequal isless islessequal islessgreater isnormal"
    " issignaling issubnormal isunordered iszero jmp_buf kill_dependency labs ldiv llabs"
    " lldiv localeconv localtime longjmp main malloc math_errhandling mblen mbsinit"
    " memory_order mktime offsetof once_flag perror puts qsort quick_exit raise rand realloc"
    " remove rename rewind setbuf setjmp setlocale setvbuf signal signbit signgam srand std"
    " stderr stdin stdout strlcat strlcpy system time timegm timespec_get timespec_getres"
    " tmpfile tmpnam va_arg va_copy va_end va_list va_start".split()
)
"""Other functions, types and macros of the headers of C11 and C23."""

_GROUPS = re.compile(
    "(atomic|memory_order|mtx|cnd|thrd|tss|stdc)_.*|(PRI|SCN).*|L_tmpnam|.*_t|.*_r"
    "|w?mem(chr|cmp|cpy|ccpy|move|set|set_explicit|alignment)"
    "|(str|wcs)(n?cat|n?cmp|n?cpy|n?dup|r?chr|coll|c?spn|error|f?time|len|pbrk|str|tok|xfrm|from"
    "|to[dfu]|tou?ll?|told|to[iu]max|fromd|fromf|froml|rtombs)"
    "|(is|to)w?(alnum|alpha|blank|cntrl|ctype|digit|graph|lower|print|punct|space|upper"
    "|xdigit)|towctrans|wctrans|wctype|wctob|wctomb|wcstombs|wcrtomb|c(8|16|32)rtomb"
    "|mb(r?len|r?to(wc|c8|c16|c32)|sr?towcs)|(f?get|f?put|unget)w?(c|s|char)"
    "|v?(f|s|sn)?w?printf|v?(f|s)?w?scanf|v?[fs]w(print|scan)f"
    "|fe(clear|get|raise|set|hold|test|update)(except|env|exceptflag|round|mode)"
)
"""Groups of such names."""

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
    stem = name[:-1] if name[-1] in "fl" else name
    if {name, stem} & _MATH or name in _KEYWORDS | _LIBRARY or _GROUPS.fullmatch(name):
        return "C has this name"
    if keyword.iskeyword(name) or hasattr(builtins, name) or name in _IN_FILES:
        return "Python or the exported file has this name"
    return ""
