/* FMI 2.0 co-simulation: the controller as an FMU.

   doStep(t, h) takes the sample at t with the inputs set before; then u is the command of t. */
#include "fmi2Functions.h"
#include "instance.h"

typedef struct {
    memory now;
    const fmi2CallbackFunctions *callbacks;
    char name[]; /* copied: the caller's may be gone */
} instance;

/* The text is the format itself, for importers that do not format: it must contain no %. */
static void report(const fmi2CallbackFunctions *callbacks, const char *name, const char *text)
{
    if (callbacks != NULL && callbacks->logger != NULL) {
        callbacks->logger(callbacks->componentEnvironment, name, fmi2Error, "logStatusError",
                          text);
    }
}

static fmi2Status refuse(fmi2Component c, const char *text)
{
    const instance *self = c;

    report(self->callbacks, self->name, text);
    return fmi2Error;
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n,
                               const fmi2String categories[])
{
    return fmi2OK; /* only errors are logged, and always */
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid,
                              fmi2String resources, const fmi2CallbackFunctions *callbacks,
                              fmi2Boolean visible, fmi2Boolean logging)
{
    const char *problem = NULL;
    instance *self = NULL;

    if (type != fmi2CoSimulation) {
        problem = ONLY_STEPS;
    } else if (guid == NULL || strcmp(guid, MODEL_TOKEN) != 0) {
        problem = BAD_TOKEN;
    } else if ((self = calloc(1, sizeof *self + strlen(name) + 1)) == NULL) {
        problem = NO_MEMORY;
    }
    if (problem != NULL) {
        report(callbacks, name, problem);
        return NULL;
    }
    self->callbacks = callbacks;
    strcpy(self->name, name);
    begin(&self->now);
    return self;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance,
                               fmi2Real start, fmi2Boolean stopDefined, fmi2Real stop)
{
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }

fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fmi2OK; }

fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }

fmi2Status fmi2Reset(fmi2Component c)
{
    begin(&((instance *)c)->now);
    return fmi2OK;
}

/* Variables; all of them are real numbers. */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    for (size_t k = 0; k < n; k++) {
        const double *found = place(&((instance *)c)->now, vr[k]);
        if (found == NULL) {
            return refuse(c, BAD_VARIABLE);
        }
        value[k] = *found;
    }
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                       const fmi2Real value[])
{
    for (size_t k = 0; k < n; k++) {
        double *found = place(&((instance *)c)->now, vr[k]);
        if (found == NULL) {
            return refuse(c, BAD_VARIABLE);
        }
        *found = value[k];
    }
    return fmi2OK;
}

#define VARIABLE const fmi2ValueReference vr[], size_t n
#define ABSENT(TYPE) \
    NONE(fmi2Get##TYPE, VARIABLE, fmi2##TYPE value[]) \
    NONE(fmi2Set##TYPE, VARIABLE, const fmi2##TYPE value[])
#define NONE(NAME, ...) \
    fmi2Status NAME(fmi2Component c, __VA_ARGS__) \
    { \
        return n == 0 ? fmi2OK : refuse(c, BAD_VARIABLE); \
    }

ABSENT(Integer)
ABSENT(Boolean)
ABSENT(String)

/* Steps. */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean noSetPrior)
{
    return advance(&((instance *)c)->now, t, h) ? fmi2OK : refuse(c, BAD_STEP);
}

/* The state of the FMU: a copy. */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    if (*state == NULL && (*state = malloc(sizeof(memory))) == NULL) {
        return refuse(c, NO_MEMORY);
    }
    memcpy(*state, &((instance *)c)->now, sizeof(memory));
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    memcpy(&((instance *)c)->now, state, sizeof(memory));
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    free(*state);
    *state = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    *size = sizeof(memory);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    if (size < sizeof(memory)) {
        return refuse(c, NO_MEMORY);
    }
    memcpy(bytes, state, sizeof(memory));
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size,
                                   fmi2FMUstate *state)
{
    if (size != sizeof(memory) || (*state == NULL && (*state = malloc(size)) == NULL)) {
        return refuse(c, NO_MEMORY);
    }
    memcpy(*state, bytes, size);
    return fmi2OK;
}

/* What this FMU does not have. Some importers want the functions all the same. */

#define REFUSED(NAME, ...) \
    fmi2Status NAME(fmi2Component c, __VA_ARGS__) { return refuse(c, ONLY_STEPS); }

REFUSED(fmi2GetDirectionalDerivative, const fmi2ValueReference unknown[], size_t m,
        const fmi2ValueReference known[], size_t n, const fmi2Real seed[], fmi2Real result[])
REFUSED(fmi2SetRealInputDerivatives, VARIABLE, const fmi2Integer order[], const fmi2Real value[])
REFUSED(fmi2GetRealOutputDerivatives, VARIABLE, const fmi2Integer order[], fmi2Real value[])
REFUSED(fmi2GetStatus, const fmi2StatusKind kind, fmi2Status *value)
REFUSED(fmi2GetRealStatus, const fmi2StatusKind kind, fmi2Real *value)
REFUSED(fmi2GetIntegerStatus, const fmi2StatusKind kind, fmi2Integer *value)
REFUSED(fmi2GetBooleanStatus, const fmi2StatusKind kind, fmi2Boolean *value)
REFUSED(fmi2GetStringStatus, const fmi2StatusKind kind, fmi2String *value)
REFUSED(fmi2NewDiscreteStates, fmi2EventInfo *info)
REFUSED(fmi2CompletedIntegratorStep, fmi2Boolean final, fmi2Boolean *event, fmi2Boolean *terminate)
REFUSED(fmi2SetTime, fmi2Real time)
REFUSED(fmi2SetContinuousStates, const fmi2Real x[], size_t n)
REFUSED(fmi2GetDerivatives, fmi2Real derivatives[], size_t n)
REFUSED(fmi2GetEventIndicators, fmi2Real indicators[], size_t n)
REFUSED(fmi2GetContinuousStates, fmi2Real x[], size_t n)
REFUSED(fmi2GetNominalsOfContinuousStates, fmi2Real nominal[], size_t n)

fmi2Status fmi2CancelStep(fmi2Component c) { return refuse(c, ONLY_STEPS); }

fmi2Status fmi2EnterEventMode(fmi2Component c) { return refuse(c, ONLY_STEPS); }

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { return refuse(c, ONLY_STEPS); }
