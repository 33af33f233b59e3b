/*
 * ${name}_guard.h: the optional guard of ${name}.c. A sample that is not finite, or
 * whose answer is not, leaves no trace: the last command and the state are held.
 */
#ifndef ${guard}
#define ${guard}

#include "${name}.h"

#include <float.h>
#include <stdbool.h>

/* Whether all inputs that are read are finite numbers. */
static inline bool ${name}_valid(const ${name}_real x[${name}_STATES],
    const ${name}_real y_d[${name}_REFERENCES])
{
    const ${name}_real largest = ${largest};

${unused}    return ${inputs};
}

/*
 * ${name}_step behind the guard: u_last, which is what it returned before, and an
 * unchanged state where the inputs, the answer or the next state are not finite.
 */
static inline ${name}_real ${name}_guarded_step(${name}_state *s,
    ${parameters}const ${name}_real x[${name}_STATES], const ${name}_real y_d[${name}_REFERENCES],
    ${name}_real u_last)
{
    const ${name}_real largest = ${largest};
    ${name}_real result = u_last;

    if (${name}_valid(x, y_d)) {
        ${name}_state next = *s;
        const ${name}_real u = ${name}_step(&next, ${p}x, y_d);

        if (${results}) {
            *s = next;
            result = u;
        }
    }
    return result;
}

#endif
