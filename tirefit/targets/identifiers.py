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
    " fmaximum_num fmaxmag fmin fminmag fminimum fminimum_mag fminimum_mag_num fminimum_num"
    " fmod fmul frexp fromfp fromfpx fsqrt fsub gamma getpayload hypot ilogb isinf isnan"
    " j0 j1 jn ldexp"
    " lgamma llogb llrint llround log log10 log10p1 log1p log2 log2p1 logb logp1 lrint"
    " lround modf nan nearbyint nextafter nextdown nexttoward nextup pow pow10 pown powr"
    " remainder remquo rint rootn round roundeven rsqrt scalb scalbln scalbn setpayload"
    " setpayloadsig significand sin sincos sinh sinpi sqrt tan tanh tanpi tgamma totalorder"
    " totalordermag trunc ufromfp ufromfpx y0 y1 yn".split()
)
"""Functions of math.h and complex.h, also of POSIX, GNU and C23, without their ending for
the type, as f, l or f64."""

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

_POSIX = frozenset(
    "P_tmpdir a64l accept access acct adjtime alarm alloca arc4random arc4random_buf"
    " arc4random_uniform asprintf assert_perror basename bcmp bcopy bind brk bzero"
    " canonicalize_file_name chdir chmod chown chroot clearenv clone close close_range"
    " closedir closefrom confstr connect copy_file_range creat crypt ctermid cuserid daemon"
    " daylight dirname dprintf drand48 dup dup2 dup3 duplocale dysize eaccess ecvt"
    " endusershell environ erand48 euidaccess explicit_bzero faccessat fallocate fchdir"
    " fchmod fchmodat fchown fchownat fcloseall fcntl fcvt fd_mask fd_set fdatasync fdopen"
    " fedisableexcept feenableexcept fexecve ffs ffsl ffsll fileno flock flockfile fmemopen"
    " fopencookie fork fpathconf freelocale fseeko fstat fstatat fsync ftello ftruncate"
    " ftrylockfile ftw funlockfile futimens futimes futimesat gcvt get_current_dir_name"
    " getcpu getcwd getdate getdate_err getdelim getdomainname getdtablesize getegid"
    " getentropy geteuid getgid getgroups gethostid gethostname getitimer getline getloadavg"
    " getlogin getopt getpagesize getpass getpgid getpgrp getpid getppid getpt getresgid"
    " getresuid getsid getsubopt gettid gettimeofday getuid getumask getusershell getw getwd"
    " glob grantpt group_member gsignal index initstate ioctl isascii isatty jrand48 kill"
    " killpg l64a lchmod lchown lcong48 link linkat listen lockf lrand48 lseek lstat lutimes"
    " mbsnrtowcs memfrob memmem mempcpy memrchr mkdir mkdirat mkdtemp mkfifo mkfifoat mknod"
    " mknodat mkostemp mkostemps mkstemp mkstemps mktemp mmap mprotect mrand48 munmap"
    " name_to_handle_at nanosleep newlocale nice nrand48 obstack_printf obstack_vprintf"
    " on_exit open open_by_handle_at open_memstream open_wmemstream openat opendir optarg"
    " opterr optind optopt pathconf pause pclose pipe pipe2 poll popen pread profil pselect"
    " psiginfo psignal ptsname putenv putw pwrite qecvt qfcvt qgcvt random rawmemchr read"
    " readahead readdir readlink readlinkat reallocarray realpath recv renameat renameat2"
    " revoke rindex rmdir rpmatch sbrk secure_getenv seed48 select send setbuffer"
    " setdomainname setegid setenv seteuid setgid sethostid sethostname setitimer setlinebuf"
    " setlogin setns setpgid setpgrp setregid setresgid setresuid setreuid setsid setstate"
    " settimeofday setuid setusershell shutdown sigaction sigaddset sigaltstack sigandset"
    " sigblock sigdelset sigemptyset sigfillset siggetmask sighold sigignore siginterrupt"
    " sigisemptyset sigismember sigjmp_buf siglongjmp sigmask sigorset sigpause sigpending"
    " sigprocmask sigqueue sigrelse sigreturn sigset sigsetjmp sigsetmask sigstack"
    " sigsuspend sigtimedwait sigwait sigwaitinfo sleep socket splice srand48 srandom"
    " ssignal stat statx stpcpy stpncpy strcasecmp strcasestr strchrnul strdupa strfry"
    " strncasecmp strndupa strnlen strptime strsep strsignal strtoq strtouq strverscmp swab"
    " symlink symlinkat sync sync_file_range syncfs syscall sysconf sysv_signal tcgetpgrp"
    " tcsetpgrp tee tempnam tgkill timelocal timeradd timerclear timercmp timerisset"
    " timersub timezone toascii truncate ttyname ttyslot tzname tzset u_char u_int u_long"
    " u_short ualarm uint ulong umask unlink unlinkat unlockpt unsetenv unshare uselocale"
    " ushort usleep utimensat utimes valloc vasprintf vdprintf vfork vhangup vmsplice wait"
    " waitpid wcpcpy wcpncpy wcscasecmp wcschrnul wcsncasecmp wcsnlen wcsnrtombs wcstoq"
    " wcstouq wcswcs wcswidth wcwidth wmempcpy write".split()
)
"""Names of POSIX and GNU in headers that a program includes beside, as unistd.h, fcntl.h,
signal.h and sys/stat.h; with 64 at the end some have another type."""

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
    stem = re.sub("(f[0-9]+x?|f|l)$", "", name)  # as in sinf, sinl, sinf64x
    taken = {name, name.removesuffix("64")} & (_KEYWORDS | _LIBRARY | _POSIX)
    if {name, stem} & _MATH or taken or _GROUPS.fullmatch(name):
        return "C has this name"
    if keyword.iskeyword(name) or hasattr(builtins, name) or name in _IN_FILES:
        return "Python or the exported file has this name"
    return ""
