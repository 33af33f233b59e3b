/* What the wrappers of both versions share: an instance, its variables, steps and state, and the
   functions that this FMU does not have.

   Before they include this file they define FMI(NAME), which puts the prefix of the version before
   a name, and COMPONENT, the type of an instance in the interface. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include "model.h"

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

/* Value references: measured states from zero, reference and its derivatives, input of the plant,
   then what the controller keeps. */
enum { Y_D = MODEL_STATES, U = Y_D + MODEL_REFERENCES, KEPT, VARIABLES = KEPT + MODEL_KEPT };

/* In version 3 alone: the independent variable. */
enum { TIME = VARIABLES };

/* All that changes; a copy of it is the state of the FMU. It comes first in every instance. */
typedef struct {
    double value[KEPT];
    double time;
    model_state state; /* real numbers only: read as an array of them */
} memory;

/* A step may differ by this part of the period from a multiple of it: masters add up times. */
static const double STEP_TOLERANCE = 1e-6;

/* More periods than this in one step are a slip: at 1 kHz, a day. */
static const double MOST_PERIODS = 1e8;

static const char *const BAD_STEP =
    "the communication step must be a multiple of the controller's period, " MODEL_PERIOD_TEXT " s";
static const char *const HELD =
    "an input is not finite: the last command and the state were held";
static const char *const BAD_VARIABLE = "there is no such variable";
static const char *const BAD_TOKEN = "the binary belongs to another modelDescription.xml";
static const char *const NO_MEMORY = "out of memory";
static const char *const ONLY_STEPS = "this is a co-simulation FMU without events";

/* Log what is wrong; the status is that of an error. Each version has its own. */
static FMI(Status) refuse(COMPONENT c, const char *text);

/* Log what the importer should know of a step that was taken. */
static FMI(Status) warn(COMPONENT c, const char *text);

static FMI(Status) answer(COMPONENT c, const char *problem)
{
    return (problem == NULL) ? FMI(OK) : refuse(c, problem);
}

static void start(memory *m)
{
    memset(m, 0, sizeof *m);
    m->value[U] = MODEL_START;
    model_init(&m->state);
}

/* What follows returns what is wrong, or NULL. */

static const char *check_token(const char *token)
{
    return (token != NULL && strcmp(token, MODEL_TOKEN) == 0) ? NULL : BAD_TOKEN;
}

/* Where a variable is, or NULL. */
static double *variable(memory *m, size_t reference)
{
    if (reference < KEPT) {
        return &m->value[reference];
    }
    return (reference < VARIABLES) ? (double *)&m->state + (reference - KEPT) : NULL;
}

static const char *get_values(memory *m, const FMI(ValueReference) vr[], size_t n, double value[],
                              bool with_time)
{
    for (size_t k = 0; k < n; k++) {
        const double *source = (with_time && vr[k] == TIME) ? &m->time : variable(m, vr[k]);
        if (source == NULL) {
            return BAD_VARIABLE;
        }
        value[k] = *source;
    }
    return NULL;
}

static const char *set_values(memory *m, const FMI(ValueReference) vr[], size_t n,
                              const double value[])
{
    for (size_t k = 0; k < n; k++) {
        double *target = variable(m, vr[k]);
        if (target == NULL) {
            return BAD_VARIABLE;
        }
        *target = value[k];
    }
    return NULL;
}

/* Samples at the current point and every period until the next point. The inputs are those of the
   current point throughout. */
static const char *advance(memory *m, double t, double h)
{
    const double periods = floor(h / MODEL_PERIOD + 0.5);

    /* no comparison holds for what is not a number */
    if (!(periods >= 1.0 && periods <= MOST_PERIODS && isfinite(t)) ||
        !(fabs(h - periods * MODEL_PERIOD) <= STEP_TOLERANCE * MODEL_PERIOD)) {
        return BAD_STEP;
    }
    for (double k = 0.0; k < periods; k += 1.0) {
        m->value[U] = model_guarded_step(&m->state, m->value, m->value + Y_D, m->value[U]);
    }
    m->time = t + h;
    return NULL;
}

/* The status of a step: a warning where bad inputs were held off. */
static FMI(Status) answer_step(COMPONENT c, const char *problem)
{
    const memory *m = c;

    if (problem == NULL && !model_valid(m->value, m->value + Y_D)) {
        return warn(c, HELD);
    }
    return answer(c, problem);
}

/* Copy into the state, which is made where there is none. */
static const char *copy_to_state(const void *from, void **state)
{
    if (*state == NULL && (*state = malloc(sizeof(memory))) == NULL) {
        return NO_MEMORY;
    }
    memcpy(*state, from, sizeof(memory));
    return NULL;
}

static const char *serialize(const void *state, void *bytes, size_t size)
{
    if (size < sizeof(memory)) {
        return NO_MEMORY;
    }
    memcpy(bytes, state, sizeof(memory));
    return NULL;
}

static const char *deserialize(const void *bytes, size_t size, void **state)
{
    return (size == sizeof(memory)) ? copy_to_state(bytes, state) : NO_MEMORY;
}

/* Functions that are the same in both versions. */

const char *FMI(GetVersion)(void) { return FMI(Version); }

FMI(Status) FMI(SetDebugLogging)(COMPONENT c, FMI(Boolean) on, size_t n,
                                 const FMI(String) categories[])
{
    return FMI(OK); /* only errors are logged, and always */
}

void FMI(FreeInstance)(COMPONENT c) { free(c); }

FMI(Status) FMI(ExitInitializationMode)(COMPONENT c) { return FMI(OK); }

FMI(Status) FMI(Terminate)(COMPONENT c) { return FMI(OK); }

FMI(Status) FMI(Reset)(COMPONENT c)
{
    start(c);
    return FMI(OK);
}

/* What this FMU does not have. Some importers want the functions all the same. */

#define VALUE_REFERENCES const FMI(ValueReference) vr[], size_t n

/* A function of an instance alone, and one of more arguments. */
#define REFUSED_ALONE(NAME) \
    FMI(Status) FMI(NAME)(COMPONENT c) { return refuse(c, ONLY_STEPS); }
#define REFUSED(NAME, ...) \
    FMI(Status) FMI(NAME)(COMPONENT c, __VA_ARGS__) { return refuse(c, ONLY_STEPS); }

/* A function of variables of a type of which there are none. */
#define NO_VARIABLES(NAME, ...) \
    FMI(Status) FMI(NAME)(COMPONENT c, __VA_ARGS__) \
    { \
        return answer(c, (n == 0) ? NULL : BAD_VARIABLE); \
    }

REFUSED(CompletedIntegratorStep, FMI(Boolean) final, FMI(Boolean) *event, FMI(Boolean) *terminate)
REFUSED_ALONE(EnterEventMode)
REFUSED_ALONE(EnterContinuousTimeMode)

#endif
