/* ${name} with its monitor, as the wrapper knows it: all that is kept, in real numbers. */
#ifndef MONITORED_H
#define MONITORED_H

#include "${name}_monitor.h"

typedef struct {
    ${name}_state state;
${parameters}    double enable;
    double reset_estimates;
    double clear_flags;
    double premises_hold;
    double now[${flags}];
    double latched[${flags}];
} monitored_state;

/* Inputs and flags are switches: 1 is on, 0 off. */
static bool is_on(double value)
{
    return value > 0.5;
}

static double as_switch(bool on)
{
    return on ? 1.0 : 0.0;
}

static void monitored_init(monitored_state *s)
{
    static const monitored_state nothing = {0};

    *s = nothing;
    ${name}_init(&s->state);
${preset}    s->enable = 1.0;
    s->premises_hold = 1.0;
}

static double monitored_step(monitored_state *s, const double x[], const double y_d[],
                             double u_last)
{
    ${name}_monitor m;
    double u;

    ${name}_monitor_init(&m);
    m.state = s->state;
${load_parameters}    m.u = u_last;
${load}
    if (is_on(s->reset_estimates)) {
        ${name}_reset_estimates(&m);
    }
    if (is_on(s->clear_flags)) {
        ${name}_clear_flags(&m);
    }
    u = ${name}_monitored_step(&m, is_on(s->enable), x, y_d);
    s->state = m.state;
    s->premises_hold = as_switch(${name}_premises_hold(&m));
${store}
    return u;
}

#endif
