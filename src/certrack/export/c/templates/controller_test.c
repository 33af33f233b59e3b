/*
 * Acceptance test of ${name}.c: prints the worst deviation and returns 0 if all is well.
 *
 *     gcc ${name}.c ${name}_test.c -lm && ./a.out
 *
 * The answers were computed in double precision from the controller that certrack simulates.
 * The first ${carried} samples follow each other in a closed loop and carry the state
 * along; at the others every number in ${name}.c shows. A deviation is relative to the
 * sum of the magnitudes that an answer is made of.
 */

#include "${name}.h"
#include "${name}_guard.h"
${monitor_include}
#include <math.h>
#include <stdio.h>

#define CARRIED ${carried}
#define SAMPLES ${samples}
#define TOLERANCE ${tolerance}

typedef struct {
    ${name}_state before;
    ${name}_real x[${name}_STATES];
    ${name}_real y_d[${name}_REFERENCES];
    ${name}_real u;
    ${name}_state after;
    ${name}_real u_scale;
    ${name}_state scale;
} sample;

static const sample samples[SAMPLES] = {
${table}
};

${parameters}static void compare(${name}_real *worst, ${name}_real got, ${name}_real want, ${name}_real scale)
{
    const ${name}_real deviation = ${magnitude}(got - want) / scale;

    if (!(deviation <= *worst)) { /* also where it is not a number */
        *worst = (deviation >= ${zero}) ? deviation : ${one};
    }
}

static void compare_states(${name}_real *worst, const ${name}_state *got, const ${name}_state *want,
    const ${name}_state *scale)
{
${compared}
}

/* A sample with an input that is no number, or infinite, leaves no trace; and a good one passes. */
static void check_guard(${name}_real *worst, const sample *p)
{
    const ${name}_real bad[3] = {(${name}_real)NAN, (${name}_real)INFINITY, -(${name}_real)INFINITY};
    ${name}_state s = p->before;
    int i;
    int k;

    compare(worst, ${name}_guarded_step(&s, ${p}p->x, p->y_d, ${one}), p->u, p->u_scale);
    compare_states(worst, &s, &p->after, &p->scale);
    for (i = 0; i < (${name}_STATES + ${name}_REFERENCES); i++) {
        for (k = 0; k < 3; k++) {
            sample q = *p;
            bool valid;

            if (i < ${name}_STATES) {
                q.x[i] = bad[k];
            } else {
                q.y_d[i - ${name}_STATES] = bad[k];
            }
            valid = ${name}_valid(q.x, q.y_d); /* true where this input is not read */
            s = p->before;
            compare(worst, ${name}_guarded_step(&s, ${p}q.x, q.y_d, p->u), p->u, p->u_scale);
            compare_states(worst, &s, valid ? &p->after : &p->before, &p->scale);
        }
    }
}

${monitor_checks}int main(void)
{
    ${name}_state s;
    ${name}_real worst = ${zero};
    int i;

    compare(&worst, ${name}_PERIOD, ${period}, ${period});
    ${name}_init(&s);
${preset}${started}    for (i = 0; i < SAMPLES; i++) {
        const sample *p = &samples[i];
        ${name}_state updated;
        ${name}_real u;

        if (i >= CARRIED) {
            s = p->before;
        }
        updated = s;
        u = ${name}_output(&s, ${p}p->x, p->y_d);
        compare(&worst, u, p->u, p->u_scale);
        ${name}_update(&updated, ${p}p->x, p->y_d);
        compare_states(&worst, &updated, &p->after, &p->scale);
        u = ${name}_step(&s, ${p}p->x, p->y_d);
        compare(&worst, u, p->u, p->u_scale);
        compare_states(&worst, &s, &p->after, &p->scale);
        check_guard(&worst, p);
    }
${monitor_call}    (void)printf("${name}: %d samples, worst deviation %.3g of %.3g allowed: %s\n", SAMPLES,
        (double)worst, (double)TOLERANCE, (worst <= TOLERANCE) ? "passed" : "FAILED");
    return (worst <= TOLERANCE) ? 0 : 1;
}
