/* What the wrappers of both versions share: the variables of an instance, and its steps. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include "model.h"

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <string.h>

/* Value references: measured states from zero, reference and its derivatives, input of the plant,
   then what the controller keeps. */
enum { Y_D = MODEL_STATES, U = Y_D + MODEL_REFERENCES, KEPT, VARIABLES = KEPT + MODEL_KEPT };

/* All that changes; a copy of it is the state of the FMU. */
typedef struct {
    double value[KEPT];
    double time;
    model_state state; /* real numbers only: read as an array of them */
} memory;

static const char *const BAD_STEP =
    "the communication step must be a multiple of the controller's period, " MODEL_PERIOD_TEXT " s";
static const char *const BAD_VARIABLE = "there is no such variable";
static const char *const BAD_TOKEN = "the binary belongs to another modelDescription.xml";
static const char *const NO_MEMORY = "out of memory";
static const char *const ONLY_STEPS = "this is a co-simulation FMU without events";

/* Where a variable is, or NULL. */
static double *place(memory *m, size_t reference)
{
    if (reference < KEPT) {
        return &m->value[reference];
    }
    return (reference < VARIABLES) ? (double *)&m->state + (reference - KEPT) : NULL;
}

static void begin(memory *m)
{
    memset(m, 0, sizeof *m);
    m->value[U] = MODEL_START;
    model_init(&m->state);
}

/* Samples at the current point and every period until the next point; false if they do not fit.
   The inputs are those of the current point throughout. */
static bool advance(memory *m, double t, double h)
{
    const double periods = floor(h / MODEL_PERIOD + 0.5);

    if (!(periods >= 1.0) || fabs(h - periods * MODEL_PERIOD) > 1e-6 * MODEL_PERIOD) {
        return false;
    }
    for (double k = 0.0; k < periods; k += 1.0) {
        m->value[U] = model_step(&m->state, m->value, m->value + Y_D);
    }
    m->time = t + h;
    return true;
}

#endif
