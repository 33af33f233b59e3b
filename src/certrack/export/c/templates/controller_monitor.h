/*
 * ${name}_monitor.h: ${name}.c on a drive. It can be enabled and disabled, its estimates can
 * be reset, and flags tell which premise of the certificate does not hold.
 */
#ifndef ${guard}
#define ${guard}

#include "${name}_guard.h"

#include <math.h>

/* What does not hold, of what the controller can see; disturbances and the plant it cannot see. */
typedef struct {
${flags}
} ${name}_flags;

typedef struct {
    ${name}_state state;
${parameters}    ${name}_real u; /* the last command */
    ${name}_flags now; /* of the last sample */
    ${name}_flags latched; /* of all samples while enabled, until ${name}_clear_flags */
} ${name}_monitor;

static inline void ${name}_lower_flags(${name}_flags *f)
{
${lowered}
}

/* Forgets the latched flags. */
static inline void ${name}_clear_flags(${name}_monitor *m)
{
    ${name}_lower_flags(&m->latched);
}

/* Whether no flag is latched. */
static inline bool ${name}_premises_hold(const ${name}_monitor *m)
{
    return !(${latched});
}

/* Sets everything as before the first sample. */
static inline void ${name}_monitor_init(${name}_monitor *m)
{
    ${name}_init(&m->state);
${preset}    m->u = ${off};
    ${name}_lower_flags(&m->now);
    ${name}_lower_flags(&m->latched);
}

/* The estimates start again; differences and the last command stay. */
static inline void ${name}_reset_estimates(${name}_monitor *m)
{
${reset}
}

/* Neither holds for what is not a number. */
static inline bool ${name}_within(${name}_real value, ${name}_real low, ${name}_real high)
{
    return (value >= low) && (value <= high);
}

static inline bool ${name}_inside(${name}_real value, ${name}_real low, ${name}_real high)
{
    return (value > low) && (value < high);
}

${limiter}/*
 * ${name}_guarded_step on a drive. While it is disabled the command is ${off}, the estimates
 * stand still, and differences and filters go on, so that they are there when it is enabled.
 */
static inline ${name}_real ${name}_monitored_step(${name}_monitor *m, bool enable,
    const ${name}_real x[${name}_STATES], const ${name}_real y_d[${name}_REFERENCES])
{
${limits}    const ${name}_real none = (${name}_real)INFINITY;
    const ${name}_real off = ${off};
    ${name}_state next = m->state;
    ${name}_real u = m->u;

    ${name}_lower_flags(&m->now);
    m->now.${held} = true;
    if (${name}_valid(x, y_d)) {
        const ${name}_real answer = ${name}_guarded_step(&next, ${p}x, ${y_d}, none);

        if (answer < none) {
            m->now.${held} = false;
            u = answer;
        }
    }
    if (!enable) {
${disabled}
    }
    if (!m->now.${held}) {
${judged}
    }
${always}    if (enable) {
${latching}
    }
    m->state = next;
    m->u = u;
    return u;
}

#endif
