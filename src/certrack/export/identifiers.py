"""Identifiers of C: derived from what the user wrote, never reserved, never taken twice."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

#: Characters of a stem, at most; NAME_update and the like then differ within the 31 of C99.
MAX_STEM = 24

KEYWORDS = frozenset(
    """auto break case char const continue default do double else enum extern float for goto if
    inline int long register restrict return short signed sizeof static struct switch typedef
    union unsigned void volatile while asm bool true false class delete friend new operator
    private protected public template this throw try catch typename using virtual namespace
    explicit mutable export near far huge interrupt fortran NULL EOF errno assert main
    alignas alignof and and_eq bitand bitor char8_t char16_t char32_t co_await co_return co_yield
    compl concept consteval constexpr constinit const_cast decltype dynamic_cast final import
    module noexcept not not_eq nullptr nullptr_t operator or or_eq override reflexpr
    reinterpret_cast requires static_assert static_cast synchronized thread_local typeid typeof
    typeof_unqual wchar_t xor xor_eq complex imaginary noreturn atomic generic
    size_t ssize_t ptrdiff_t max_align_t offsetof wint_t va_list std
    int8_t int16_t int32_t int64_t uint8_t uint16_t uint32_t uint64_t intptr_t uintptr_t
    intmax_t uintmax_t time_t clock_t div_t ldiv_t jmp_buf""".split()
)

#: What <math.h> declares or defines, on some platform or other; the f and l forms as well.
MATH = """acos asin atan atan2 cos sin tan acosh asinh atanh cosh sinh tanh exp exp2 exp10 expm1
    frexp ldexp log
    log10 log1p log2 logb ilogb modf scalbn scalbln scalb cbrt fabs hypot pow pow10 sqrt
    erf erfc lgamma tgamma gamma ceil floor nearbyint rint lrint llrint round lround llround trunc
    fmod remainder remquo copysign nan nextafter nexttoward fdim fmax fmin fma j0 j1 jn y0 y1 yn
    signgam significand drem sincos finite isinf isnan fpclassify isfinite isnormal signbit
    isgreater isgreaterequal isless islessequal islessgreater isunordered float_t double_t matherr
    abs labs div""".split()

MACROS = """HUGE HUGE_VAL HUGE_VALF HUGE_VALL INFINITY NAN DOMAIN SING OVERFLOW UNDERFLOW PLOSS
    TLOSS MAXFLOAT MATH_ERRNO MATH_ERREXCEPT math_errhandling I linux unix i386 arm avr""".split()

C_RESERVED = KEYWORDS | {name + end for name in MATH for end in ("", "f", "l")} | set(MACROS)

#: Headers that a file NAME.h must not hide.
HEADERS = frozenset(
    """assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal
    stdarg stdbool stddef stdint stdio stdlib string tgmath time wchar wctype""".split()
)


def stem(source: str) -> str:
    """The NAME of the files and functions of a system, by the name of its file.

    >>> stem("plants/dual-motor.toml")
    'dual_motor'
    """
    name = re.sub(r"[^A-Za-z0-9]+", "_", Path(source).stem)[:MAX_STEM].strip("_")
    if not name or not name[0].isalpha():
        name = f"c_{name}"[:MAX_STEM].strip("_")
    return f"{name}_c" if name.lower() in HEADERS else name


#: How headers name their constants: M_PI, DBL_MAX, INT_MIN, UINT8_C, EXIT_FAILURE.
MACRO_NAME = re.compile(
    r"(M|FP|FLT|DBL|LDBL|DECIMAL|CHAR|SCHAR|UCHAR|SHRT|USHRT|U?INT|U?LONG|U?LLONG|SIZE|PTRDIFF|RAND"
    r"|EXIT|BUFSIZ|FE|SIG|PRI|SCN)[0-9]*_[A-Z0-9_]*[A-Z0-9]"
)


def free_name(name: str, used: Iterable[str]) -> str:
    """`name`, or with as many underscores after it as make it a free identifier."""
    while name in C_RESERVED or name in used or MACRO_NAME.fullmatch(name):
        name += "_"
    return name
