/* What vector_math.h gives for a register of members, for one member: the generated formulas of a
 * system call either. */
#include <math.h>
#include <stdint.h>
#include <string.h>

typedef double V;

#define SPLAT(a) (a)
#define INLINE static inline __attribute__((always_inline))
#define OUTLINE static __attribute__((noinline))

INLINE V greater(V a, V b, V yes, V no) { return a > b ? yes : no; }
INLINE V v_abs(V a) { return fabs(a); }
INLINE V v_max(V a, V b) { return greater(a, b, a, b); }
INLINE V v_min(V a, V b) { return greater(b, a, a, b); }
INLINE V v_sign(V a) { return (V)((a > 0.0) - (a < 0.0)); }
INLINE V v_sqrt(V a) { return sqrt(a); }
INLINE V v_sin(V a) { return sin(a); }
INLINE V v_cos(V a) { return cos(a); }
INLINE V v_exp(V a) { return exp(a); }
INLINE V v_log(V a) { return log(a); }

#define ELEMENTARY(name) \
  INLINE V v_##name(V a) { return name(a); }
#define ELEMENTARY_OF_TWO(name) \
  INLINE V v_##name(V a, V b) { return name(a, b); }
