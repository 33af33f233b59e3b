/*
 * ${name}_split.h: the commands of two motors that share the input u of ${name}.c,
 *
 *     u_1 = s u - k_d (omega_1 - omega_2),   u_2 = (1 - s) u + k_d (omega_1 - omega_2).
 *
 * k_d damps the difference of the shafts, whose speeds omega_1 and omega_2 are in rad/s.
 */
#ifndef ${guard}
#define ${guard}

#include "${name}.h"

static inline void ${name}_split(${name}_real u, ${name}_real omega_1, ${name}_real omega_2,
    ${name}_real u_each[2])
{
    const ${name}_real share = ${share};
    const ${name}_real damping = ${damping};
    const ${name}_real moved = damping * (omega_1 - omega_2);
    u_each[0] = (share * u) - moved;
    u_each[1] = ((${one} - share) * u) + moved;
}

#endif
