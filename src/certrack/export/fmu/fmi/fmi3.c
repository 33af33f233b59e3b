/* FMI 3.0 co-simulation: the controller as an FMU.

   doStep(t, h) takes the sample at t with the inputs set before; then u is the command of t. */
#include "fmi3Functions.h"
#include "instance.h"

enum { TIME = VARIABLES }; /* value reference of the independent variable */

typedef struct {
    memory now;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} instance;

static fmi3Status refuse(fmi3Instance c, const char *text)
{
    const instance *self = c;

    if (self->log != NULL) {
        self->log(self->environment, fmi3Error, "logStatusError", text);
    }
    return fmi3Error;
}

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n,
                               const fmi3String categories[])
{
    return fmi3OK; /* only errors are logged, and always */
}

fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
    const fmi3ValueReference intermediate[], size_t n, fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    instance unborn = {.environment = environment, .log = log}, *self;

    if (eventModeUsed) {
        refuse(&unborn, ONLY_STEPS);
        return NULL;
    }
    if (token == NULL || strcmp(token, MODEL_TOKEN) != 0) {
        refuse(&unborn, BAD_TOKEN);
        return NULL;
    }
    if ((self = malloc(sizeof *self)) == NULL) {
        refuse(&unborn, NO_MEMORY);
        return NULL;
    }
    *self = unborn;
    begin(&self->now);
    return self;
}

void fmi3FreeInstance(fmi3Instance c) { free(c); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean toleranceDefined,
                                       fmi3Float64 tolerance, fmi3Float64 start,
                                       fmi3Boolean stopDefined, fmi3Float64 stop)
{
    ((instance *)c)->now.time = start;
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return fmi3OK; }

fmi3Status fmi3Terminate(fmi3Instance c) { return fmi3OK; }

fmi3Status fmi3Reset(fmi3Instance c)
{
    begin(&((instance *)c)->now);
    return fmi3OK;
}

/* Variables; all of them are real numbers. */

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n,
                          fmi3Float64 value[], size_t values)
{
    memory *now = &((instance *)c)->now;

    for (size_t k = 0; k < n && k < values; k++) {
        const double *found = vr[k] == TIME ? &now->time : place(now, vr[k]);
        if (found == NULL) {
            return refuse(c, BAD_VARIABLE);
        }
        value[k] = *found;
    }
    return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n,
                          const fmi3Float64 value[], size_t values)
{
    for (size_t k = 0; k < n && k < values; k++) {
        double *found = place(&((instance *)c)->now, vr[k]);
        if (found == NULL) {
            return refuse(c, BAD_VARIABLE);
        }
        *found = value[k];
    }
    return fmi3OK;
}

/* Steps. */

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean noSetPrior,
                      fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation,
                      fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime)
{
    const bool done = advance(&((instance *)c)->now, t, h);

    *eventHandlingNeeded = *terminateSimulation = *earlyReturn = false;
    *lastSuccessfulTime = done ? t + h : t;
    return done ? fmi3OK : refuse(c, BAD_STEP);
}

/* The state of the FMU: a copy. */

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state)
{
    if (*state == NULL && (*state = malloc(sizeof(memory))) == NULL) {
        return refuse(c, NO_MEMORY);
    }
    memcpy(*state, &((instance *)c)->now, sizeof(memory));
    return fmi3OK;
}

fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state)
{
    memcpy(&((instance *)c)->now, state, sizeof(memory));
    return fmi3OK;
}

fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state)
{
    free(*state);
    *state = NULL;
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState state, size_t *size)
{
    *size = sizeof(memory);
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
    if (size < sizeof(memory)) {
        return refuse(c, NO_MEMORY);
    }
    memcpy(bytes, state, sizeof(memory));
    return fmi3OK;
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size,
                                   fmi3FMUState *state)
{
    if (size != sizeof(memory) || (*state == NULL && (*state = malloc(size)) == NULL)) {
        return refuse(c, NO_MEMORY);
    }
    memcpy(*state, bytes, size);
    return fmi3OK;
}

/* What this FMU does not have. Some importers want the functions all the same. */

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                          fmi3Boolean visible, fmi3Boolean logging,
                                          fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log)
{
    instance unborn = {.environment = environment, .log = log};

    refuse(&unborn, ONLY_STEPS);
    return NULL;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token,
                                               fmi3String resources, fmi3Boolean visible,
                                               fmi3Boolean logging,
                                               fmi3InstanceEnvironment environment,
                                               fmi3LogMessageCallback log,
                                               fmi3ClockUpdateCallback update,
                                               fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock)
{
    return fmi3InstantiateModelExchange(name, token, resources, visible, logging, environment, log);
}

#define REFUSED(NAME, ...) \
    fmi3Status NAME(fmi3Instance c, __VA_ARGS__) { return refuse(c, ONLY_STEPS); }
#define BARE(NAME) \
    fmi3Status NAME(fmi3Instance c) { return refuse(c, ONLY_STEPS); }
#define VARIABLE const fmi3ValueReference vr[], size_t n
#define ABSENT(TYPE) \
    NONE(fmi3Get##TYPE, VARIABLE, fmi3##TYPE value[], size_t values) \
    NONE(fmi3Set##TYPE, VARIABLE, const fmi3##TYPE value[], size_t values)
#define NONE(NAME, ...) \
    fmi3Status NAME(fmi3Instance c, __VA_ARGS__) \
    { \
        return n == 0 ? fmi3OK : refuse(c, BAD_VARIABLE); \
    }

ABSENT(Float32)
ABSENT(Int8)
ABSENT(UInt8)
ABSENT(Int16)
ABSENT(UInt16)
ABSENT(Int32)
ABSENT(UInt32)
ABSENT(Int64)
ABSENT(UInt64)
ABSENT(Boolean)
ABSENT(String)
NONE(fmi3GetBinary, VARIABLE, size_t size[], fmi3Binary value[], size_t values)
NONE(fmi3SetBinary, VARIABLE, const size_t size[], const fmi3Binary value[], size_t values)
NONE(fmi3GetClock, VARIABLE, fmi3Clock value[])
NONE(fmi3SetClock, VARIABLE, const fmi3Clock value[])
REFUSED(fmi3GetIntervalDecimal, VARIABLE, fmi3Float64 interval[],
        fmi3IntervalQualifier qualifier[])
REFUSED(fmi3GetIntervalFraction, VARIABLE, fmi3UInt64 counter[], fmi3UInt64 resolution[],
        fmi3IntervalQualifier qualifier[])
REFUSED(fmi3GetShiftDecimal, VARIABLE, fmi3Float64 shift[])
REFUSED(fmi3GetShiftFraction, VARIABLE, fmi3UInt64 counter[], fmi3UInt64 resolution[])
REFUSED(fmi3SetIntervalDecimal, VARIABLE, const fmi3Float64 interval[])
REFUSED(fmi3SetIntervalFraction, VARIABLE, const fmi3UInt64 counter[], const fmi3UInt64 resolution[])
REFUSED(fmi3SetShiftDecimal, VARIABLE, const fmi3Float64 shift[])
REFUSED(fmi3SetShiftFraction, VARIABLE, const fmi3UInt64 counter[], const fmi3UInt64 resolution[])
REFUSED(fmi3ActivateModelPartition, fmi3ValueReference clock, fmi3Float64 time)

REFUSED(fmi3GetNumberOfVariableDependencies, fmi3ValueReference vr, size_t *n)
REFUSED(fmi3GetVariableDependencies, fmi3ValueReference dependent, size_t element[],
        fmi3ValueReference independent[], size_t elements[], fmi3DependencyKind kind[], size_t n)
REFUSED(fmi3GetDirectionalDerivative, const fmi3ValueReference unknown[], size_t m,
        const fmi3ValueReference known[], size_t n, const fmi3Float64 seed[], size_t seeds,
        fmi3Float64 result[], size_t results)
REFUSED(fmi3GetAdjointDerivative, const fmi3ValueReference unknown[], size_t m,
        const fmi3ValueReference known[], size_t n, const fmi3Float64 seed[], size_t seeds,
        fmi3Float64 result[], size_t results)
REFUSED(fmi3GetOutputDerivatives, VARIABLE, const fmi3Int32 order[], fmi3Float64 value[],
        size_t values)

BARE(fmi3EnterConfigurationMode)
BARE(fmi3ExitConfigurationMode)
BARE(fmi3EnterEventMode)
BARE(fmi3EnterStepMode)
BARE(fmi3EnterContinuousTimeMode)
BARE(fmi3EvaluateDiscreteStates)
REFUSED(fmi3UpdateDiscreteStates, fmi3Boolean *needed, fmi3Boolean *terminate,
        fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *defined, fmi3Float64 *next)
REFUSED(fmi3CompletedIntegratorStep, fmi3Boolean final, fmi3Boolean *event, fmi3Boolean *terminate)
REFUSED(fmi3SetTime, fmi3Float64 time)
REFUSED(fmi3SetContinuousStates, const fmi3Float64 x[], size_t n)
REFUSED(fmi3GetContinuousStates, fmi3Float64 x[], size_t n)
REFUSED(fmi3GetContinuousStateDerivatives, fmi3Float64 derivatives[], size_t n)
REFUSED(fmi3GetNominalsOfContinuousStates, fmi3Float64 nominal[], size_t n)
REFUSED(fmi3GetEventIndicators, fmi3Float64 indicators[], size_t n)
REFUSED(fmi3GetNumberOfEventIndicators, size_t *n)
REFUSED(fmi3GetNumberOfContinuousStates, size_t *n)
