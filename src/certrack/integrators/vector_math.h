/* Arithmetic on a vector register of doubles: selections and elementary functions. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#ifdef __AVX512F__
#include <immintrin.h>
#endif

enum { LANES = 8 };
typedef double V __attribute__((vector_size(8 * LANES)));
typedef int64_t I __attribute__((vector_size(8 * LANES)));

#define SPLAT(a) ((V){0} + (a))
#define INLINE static inline __attribute__((always_inline))
#define OUTLINE static __attribute__((noinline)) /* lest constants be kept in registers, and spilled */

INLINE V choose(I mask, V yes, V no) { return (V)((mask & (I)yes) | (~mask & (I)no)); }
INLINE V v_abs(V a) { return (V)((I)a & INT64_MAX); }
INLINE V v_max(V a, V b) { return choose(a > b, a, b); }
INLINE V v_min(V a, V b) { return choose(a < b, a, b); }
INLINE int any(I mask) {
#ifdef __AVX512F__
  return _mm512_test_epi64_mask((__m512i)mask, (__m512i)mask) != 0;
#else
  int64_t found = 0;
  for (int l = 0; l < LANES; l++) found |= mask[l];
  return found != 0;
#endif
}

/* Cubics with p = e, p' = d at the ends of [0, 1]; see `Extremum` and `Entry` in lowering.py. */
INLINE V cubic(V s, V e0, V d0, V b, V a) { return e0 + s * (d0 + s * (b + s * a)); }
INLINE V within(V s) { return v_min(v_max(s, SPLAT(0.0)), SPLAT(1.0)); }
INLINE V v_Extremum(V e0, V e1, V d0, V d1) {
  I turns = d0 * d1 < SPLAT(0.0);
  if (!any(turns)) return e0;
  V rise = e1 - e0, b = 3.0 * rise - 2.0 * d0 - d1, a = d0 + d1 - 2.0 * rise;
  V per_change = 1.0 / (d0 - d1), even = d0 * per_change;
  V s = within(even + (d0 + even * (2.0 * b + 3.0 * even * a)) * per_change);
  return choose(turns, cubic(s, e0, d0, b, a), e0);
}
INLINE V v_Entry(V e0, V e1, V d0, V d1, V band) {
  I enters = v_max(v_abs(e0), v_abs(e1)) > band;
  if (!any(enters)) return SPLAT(1.0);
  V rise = e1 - e0, b = 3.0 * rise - 2.0 * d0 - d1, a = d0 + d1 - 2.0 * rise;
  V level = choose(e0 > SPLAT(0.0), band, -band), per_rise = 1.0 / rise;
  V s = within((level - e0) * per_rise);
  V better = within(s - (cubic(s, e0, d0, b, a) - level) * per_rise);
  return choose(enters & (better == better), better, SPLAT(1.0));
}

/* The vector versions of the C library (libmvec), where there are any. */
#ifdef VECTOR_MATH
#define CLONED __attribute__((simd("notinbranch")))
extern CLONED double pow(double, double);
#ifdef MORE_VECTOR_MATH
extern CLONED double tan(double), asin(double), acos(double), atan(double), sinh(double);
extern CLONED double cosh(double), tanh(double), atan2(double, double);
#endif
#endif

#define ELEMENTARY(name)                                             \
  static V v_##name(V a) {                                           \
    double b[LANES] __attribute__((aligned(64)));                    \
    memcpy(b, &a, sizeof b);                                         \
    for (int l = 0; l < LANES; l++) b[l] = name(b[l]);               \
    memcpy(&a, b, sizeof b);                                         \
    return a;                                                        \
  }
#define ELEMENTARY_OF_TWO(name)                                      \
  static V v_##name(V a, V c) {                                      \
    double b[LANES] __attribute__((aligned(64)));                    \
    double d[LANES] __attribute__((aligned(64)));                    \
    memcpy(b, &a, sizeof b);                                         \
    memcpy(d, &c, sizeof d);                                         \
    for (int l = 0; l < LANES; l++) b[l] = name(b[l], d[l]);         \
    memcpy(&a, b, sizeof b);                                         \
    return a;                                                        \
  }
INLINE V v_sqrt(V a) {
  for (int l = 0; l < LANES; l++) a[l] = sqrt(a[l]);
  return a;
}
INLINE V v_sign(V a) {
  return choose(a > SPLAT(0.0), SPLAT(1.0), choose(a < SPLAT(0.0), SPLAT(-1.0), SPLAT(0.0)));
}

/* sin, cos, exp and log are written out: a call would empty all registers. Arguments beyond the
 * range of the series go to the C library, lane by lane. */
#define EACH(mask, name)              \
  if (__builtin_expect(any(mask), 0)) \
    for (int l = 0; l < LANES; l++)   \
      if (mask[l]) found[l] = name(a[l]);

#define HORNER(sum, table, x)                                            \
  do {                                                                   \
    enum { TERMS = sizeof table / sizeof *table };                       \
    _Pragma("GCC unroll 16") for (int i = TERMS - 1; i >= 0; i--) sum =  \
        sum * (x) + table[i];                                            \
  } while (0)

static const double ROUND = 6755399441055744.0; /* 1.5 2^52: adding it rounds to an integer */

/* sin of a + quarter turns: Taylor on [-pi/4, pi/4], pi/2 in three parts. */
INLINE V circular(V a, int64_t quarter) {
  static const double ODD[] = {-1.0 / 6,           1.0 / 120,           -1.0 / 5040,
                               1.0 / 362880,       -1.0 / 39916800,     1.0 / 6227020800,
                               -1.0 / 1307674368e3, 1.0 / 355687428096e3};
  static const double EVEN[] = {-1.0 / 2,         1.0 / 24,           -1.0 / 720, 1.0 / 40320,
                                -1.0 / 3628800,   1.0 / 479001600,    -1.0 / 87178291200,
                                1.0 / 20922789888e3};
  V shifted = a * 0.63661977236758134 + ROUND, n = shifted - ROUND;
  V r = a - n * 0x1.921fb544p+0; /* 33 bits each: the products are exact */
  r = r - n * 0x1.0b4611a6p-34;
  r = r - n * 0x1.3198a2e037073p-69;
  I turn = ((I)shifted + quarter) & 3;
  V square = r * r, odd = SPLAT(0.0), even = SPLAT(0.0);
  HORNER(odd, ODD, square);
  HORNER(even, EVEN, square);
  V found = choose((turn & 1) != 0, 1.0 + square * even, r + r * square * odd);
  return (V)((I)found ^ ((turn & 2) << 62));
}
INLINE V v_sin(V a) {
  V found = circular(a, 0);
  I far = ~(v_abs(a) < SPLAT(1e5));
  EACH(far, sin)
  return found;
}
INLINE V v_cos(V a) {
  V found = circular(a, 1);
  I far = ~(v_abs(a) < SPLAT(1e5));
  EACH(far, cos)
  return found;
}
/* exp(a) = 2^n exp(r), |r| <= log(2)/2. */
INLINE V v_exp(V a) {
  static const double TAYLOR[] = {1.0,           1.0,           1.0 / 2,        1.0 / 6,
                                  1.0 / 24,      1.0 / 120,     1.0 / 720,      1.0 / 5040,
                                  1.0 / 40320,   1.0 / 362880,  1.0 / 3628800,  1.0 / 39916800,
                                  1.0 / 479001600, 1.0 / 6227020800};
  V shifted = a * 1.4426950408889634 + ROUND, n = shifted - ROUND;
  V r = a - n * 0x1.62e42fefp-1;
  r = r - n * 0x1.473de6af278edp-34;
  V found = SPLAT(0.0);
  HORNER(found, TAYLOR, r);
  found = (V)((I)found + ((I)shifted << 52));
  I far = ~(v_abs(a) < SPLAT(700.0));
  EACH(far, exp)
  return found;
}
/* log(2^n m) = n log 2 + 2 artanh((m - 1)/(m + 1)), m from 0.7 to 1.4. */
INLINE V v_log(V a) {
  static const double SERIES[] = {1.0 / 3,  1.0 / 5,  1.0 / 7,  1.0 / 9,  1.0 / 11,
                                  1.0 / 13, 1.0 / 15, 1.0 / 17, 1.0 / 19, 1.0 / 21};
  I pattern = (I)a - 0x3fe6a09e667f3bcd; /* sqrt(1/2) */
  I n = pattern >> 52;
  V m = (V)((I)a - (n << 52));
  V exponent = (V)(n + (I)SPLAT(ROUND)) - ROUND;
  V f = (m - 1.0) / (m + 1.0), square = f * f, sum = SPLAT(0.0);
  HORNER(sum, SERIES, square);
  V found = exponent * 0x1.62e42fefp-1 +
            (2.0 * f + (2.0 * f * square * sum + exponent * 0x1.473de6af278edp-34));
  I far = ~((a > SPLAT(1e-300)) & (a < SPLAT(1e300)));
  EACH(far, log)
  return found;
}
