/* Arithmetic on a vector register of doubles: selections, elementary functions, rounding, bins.
 * Where it uses the bits of a double - sign, 11 of the exponent (that of 1 is 1023), 52 of the
 * fraction - the reason stands beside it, and tests/test_vector_math.py compares the results. */
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
typedef float F __attribute__((vector_size(4 * LANES)));
typedef int32_t J __attribute__((vector_size(4 * LANES)));
typedef uint16_t H __attribute__((vector_size(2 * LANES)));

#define SPLAT(a) ((V){0} + (a))
#define INLINE static inline __attribute__((always_inline))
/* lest constants be kept in registers, and spilled */
#define OUTLINE static __attribute__((noinline))

/* A comparison gives all bits or none: `and` and `or` are a selection without a branch. */
INLINE V choose(I mask, V yes, V no) { return (V)((mask & (I)yes) | (~mask & (I)no)); }
INLINE V v_abs(V a) { return (V)((I)a & INT64_MAX); } /* without the sign bit */
#ifdef __AVX512DQ__
INLINE V greater(V a, V b, V yes, V no) {
  return _mm512_mask_blend_pd(_mm512_cmp_pd_mask(a, b, _CMP_GT_OQ), no, yes);
}
INLINE V v_max(V a, V b) { return _mm512_max_pd(a, b); } /* b if one is not a number */
INLINE V v_min(V a, V b) { return _mm512_min_pd(a, b); }
INLINE V rough_inverse(V a) { return _mm512_rcp14_pd(a); } /* to 14 bits */
#else
INLINE V greater(V a, V b, V yes, V no) { return choose(a > b, yes, no); } /* a > b ? yes : no */
INLINE V v_max(V a, V b) { return greater(a, b, a, b); }
INLINE V v_min(V a, V b) { return greater(b, a, a, b); }
INLINE V rough_inverse(V a) { return 1.0 / a; }
#endif
INLINE int any(I mask) {
#ifdef __AVX512F__
  return _mm512_test_epi64_mask((__m512i)mask, (__m512i)mask) != 0;
#else
  int64_t bits = 0;
  for (int l = 0; l < LANES; l++) bits |= mask[l];
  return bits != 0;
#endif
}

/* Cubics with p = e, p' = d at the ends of [0, 1]: `Extremum` and `Entry` of core/select.py. The
 * value at an extremum hardly depends on the place: 14 bits of that are enough, and no branch, as
 * among eight members there is often one that turns. */
INLINE V cubic(V s, V e0, V d0, V b, V a) { return e0 + s * (d0 + s * (b + s * a)); }
INLINE V within(V s) { return v_min(v_max(s, SPLAT(0.0)), SPLAT(1.0)); }
INLINE V v_Extremum(V e0, V e1, V d0, V d1) {
  V rise = e1 - e0, b = 3.0 * rise - 2.0 * d0 - d1, a = d0 + d1 - 2.0 * rise;
  V per_change = rough_inverse(d0 - d1), even = d0 * per_change;
  V s = within(even + (d0 + even * (2.0 * b + 3.0 * even * a)) * per_change);
  return greater(SPLAT(0.0), d0 * d1, cubic(s, e0, d0, b, a), e0);
}
INLINE V v_Entry(V e0, V e1, V d0, V d1, V band) {
  I enters = v_max(v_abs(e0), v_abs(e1)) > band;
  if (!any(enters)) return SPLAT(1.0);
  V rise = e1 - e0, b = 3.0 * rise - 2.0 * d0 - d1, a = d0 + d1 - 2.0 * rise;
  V level = choose(e0 > SPLAT(0.0), band, -band), per_rise = rough_inverse(rise);
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
#ifdef __AVX512F__
INLINE int beyond(V a, double least, double most) {
  return _mm512_cmp_pd_mask(a, SPLAT(least), _CMP_NGT_UQ) |
         _mm512_cmp_pd_mask(a, SPLAT(most), _CMP_NLT_UQ);
}
#else
INLINE int beyond(V a, double least, double most) {
  return any(~((a > SPLAT(least)) & (a < SPLAT(most))));
}
#endif
#define FAR(name, least, most)                                                 \
  static __attribute__((noinline, cold)) V far_##name(V a, V value) {          \
    for (int l = 0; l < LANES; l++)                                            \
      if (!(a[l] > least && a[l] < most)) value[l] = name(a[l]);               \
    return value;                                                              \
  }                                                                            \
  INLINE V v_##name(V a) {                                                     \
    V value = near_##name(a);                                                  \
    if (__builtin_expect(beyond(a, least, most), 0)) value = far_##name(a, value); \
    return value;                                                              \
  }

#define HORNER(sum, table, x)                                            \
  do {                                                                   \
    enum { TERMS = sizeof table / sizeof *table };                       \
    _Pragma("GCC unroll 16") for (int i = TERMS - 1; i >= 0; i--) sum =  \
        sum * (x) + table[i];                                            \
  } while (0)

/* 1.5 2^52: adding it rounds to an integer, which then stands in the low bits of the fraction. */
static const double ROUND = 6755399441055744.0;

/* The nearest multiple of a quantum; beyond 2^51 of them the value itself. */
INLINE V rounded(V a, double quantum) {
  V n = a / quantum, near = (n + ROUND) - ROUND;
  return choose(v_abs(n) < SPLAT(0x1p51), near, n) * quantum;
}

/* (-1)^(n / 2) sin(a - n pi/2) for even (`odd` = 0) or odd n, where |a - n pi/2| <= pi/2: a
 * minimax polynomial, pi/2 in three parts. */
INLINE V circular(V a, int odd) {
  V shifted = (a * 0.31830988618379067 - 0.5 * odd) + ROUND;
  V n = (shifted - ROUND) * 2.0 + odd;
  V r = a - n * 0x1.921fb544p+0; /* 33 bits: the products are exact */
  r = r - n * 0x1.0b4611a6p-34;
  r = r - n * 0x1.3198a2e037073p-69;
  V z = r * r, z2 = z * z;
  V p0 = z * 0.0083333333333259309 - 0.16666666666666648; /* short chains, not Horner's */
  V p1 = z * 2.7557318055499585e-6 - 0.00019841269836468067;
  V p2 = z * 1.605097160362982e-10 - 2.5051972905379012e-8;
  V p = p0 + z2 * (p1 + z2 * (p2 - 7.4080454517479943e-13 * z2));
  I sign = (I)shifted + odd; /* its lowest bit: whether to negate */
  return (V)((I)(r + (r * z) * p) ^ (sign << 63)); /* the sign bit */
}
INLINE V near_sin(V a) { return circular(a, 0); }
INLINE V near_cos(V a) { return circular(a, 1); }
FAR(sin, -1e5, 1e5)
FAR(cos, -1e5, 1e5)

/* exp(a) = 2^n exp(r), |r| <= log(2)/2. */
INLINE V near_exp(V a) {
  static const double TAYLOR[] = {1.0,           1.0,           1.0 / 2,        1.0 / 6,
                                  1.0 / 24,      1.0 / 120,     1.0 / 720,      1.0 / 5040,
                                  1.0 / 40320,   1.0 / 362880,  1.0 / 3628800,  1.0 / 39916800,
                                  1.0 / 479001600, 1.0 / 6227020800};
  V shifted = a * 1.4426950408889634 + ROUND, n = shifted - ROUND;
  V r = a - n * 0x1.62e42fefp-1;
  r = r - n * 0x1.473de6af278edp-34;
  V power = SPLAT(0.0);
  HORNER(power, TAYLOR, r);
  return (V)((I)power + ((I)shifted << 52)); /* n, in the low bits, is added to the exponent */
}
FAR(exp, -700.0, 700.0)

/* log(2^n m), m from 1 to 2: by a table of log c_i at the centres c_i of 16 parts, and a minimax
 * polynomial of m/c_i - 1; absolute error 3e-15 for a of order 1. */
#define PART(i) 32.0 / (32 + i)
static const double INVERSE[16] = {
    PART(1),  PART(3),  PART(5),  PART(7),  PART(9),  PART(11), PART(13), PART(15),
    PART(17), PART(19), PART(21), PART(23), PART(25), PART(27), PART(29), PART(31)};
static const double LOG[16] = { /* of (32 + i) / 32; as numbers, since clang does not compute them */
    0.030771658666753687, 0.08961215868968714, 0.1451820098444979, 0.19782574332991987,
    0.24783616390458127, 0.2954642128938359, 0.3409265869705932, 0.38441169891033206,
    0.4260843953109001, 0.46608972992459924, 0.5045560107523953, 0.5415972824327444,
    0.5773153650348236, 0.6118015411059929, 0.6451379613735847, 0.6773988235918061};
/* table[the low 4 bits of the index] */
INLINE V lookup(const double *table, I index) {
#ifdef __AVX512F__
  return _mm512_permutex2var_pd(_mm512_loadu_pd(table), (__m512i)index,
                                _mm512_loadu_pd(table + 8));
#else
  V values;
  for (int l = 0; l < LANES; l++) values[l] = table[index[l] & 15];
  return values;
#endif
}
INLINE V near_log(V a) {
  const int64_t one = 0x3ff0000000000000, fraction = 0x000fffffffffffff;
  I bits = (I)a, index = bits >> 48; /* its low 4 bits lead the fraction: the part of m */
  V m = (V)((bits & fraction) | one); /* the same fraction, exponent 0 */
  V k = __builtin_convertvector((bits - one) >> 52, V); /* the exponent, less that of 1 */
  V r = m * lookup(INVERSE, index) - 1.0, z = r * r;
  V p = r * 0.14302004969935271 - 0.16684993320145907;
  V q = r * 0.19999994032650117 - 0.24999993286903622;
  V s = r * 0.33333333333657097 - 0.50000000000364225;
  return (k * 0.69314718055994531 + (lookup(LOG, index) + r)) + z * (s + z * (q + z * p));
}
FAR(log, 1e-300, 1e300)

/* Bins of y = 1 + |v| by its leading `bits` (see statistics.py): exponent and fraction of y, read
 * as one integer, grow with y. A last bin, 2 side, is for what is not a number, or not alive. */
INLINE H bins_of(F v, I alive, int side, int bits) {
  F y = 1.0f + (F)((J)v & INT32_MAX); /* without the sign bit */
  J bin = ((J)y - (127 << 23)) >> (23 - bits), beyond = bin >= side, negative = v < 0.0f;
  bin = (beyond & (side - 1)) | (~beyond & bin);
  bin = side + (bin ^ negative); /* k -> -k - 1 */
  J real = (v == v) & __builtin_convertvector(alive, J);
  return __builtin_convertvector((real & bin) | (~real & (2 * side)), H);
}
