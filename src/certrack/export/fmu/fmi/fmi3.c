/* FMI 3.0 co-simulation: the controller as an FMU.

   doStep(t, h) takes the sample at t with the inputs set before; then u is the command of t. */
#include "fmi3Functions.h"

#define FMI(NAME) fmi3##NAME
#define COMPONENT fmi3Instance
#include "instance.h"

typedef struct {
    memory now; /* the first: see instance.h */
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

static fmi3Status warn(fmi3Instance c, const char *text)
{
    const instance *self = c;

    if (self->log != NULL) {
        self->log(self->environment, fmi3Warning, "logStatusWarning", text);
    }
    return fmi3Warning;
}

fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
    const fmi3ValueReference intermediate[], size_t n, fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    const char *problem = eventModeUsed ? ONLY_STEPS : check_token(token);
    instance fresh = {.environment = environment, .log = log}, *self = NULL;

    if (problem == NULL && (self = malloc(sizeof *self)) == NULL) {
        problem = NO_MEMORY;
    }
    if (problem != NULL) {
        refuse(&fresh, problem);
        return NULL;
    }
    *self = fresh;
    start(&self->now);
    return self;
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean toleranceDefined,
                                       fmi3Float64 tolerance, fmi3Float64 begin,
                                       fmi3Boolean stopDefined, fmi3Float64 stop)
{
    ((instance *)c)->now.time = begin;
    return fmi3OK;
}

/* Variables; all of them are real numbers. */

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n,
                          fmi3Float64 value[], size_t values)
{
    return answer(c, get_values(c, vr, (n < values) ? n : values, value, true));
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n,
                          const fmi3Float64 value[], size_t values)
{
    return answer(c, set_values(c, vr, (n < values) ? n : values, value));
}

#define NO_VARIABLES_OF_TYPE(TYPE) \
    NO_VARIABLES(Get##TYPE, VALUE_REFERENCES, fmi3##TYPE value[], size_t values) \
    NO_VARIABLES(Set##TYPE, VALUE_REFERENCES, const fmi3##TYPE value[], size_t values)

NO_VARIABLES_OF_TYPE(Float32)
NO_VARIABLES_OF_TYPE(Int8)
NO_VARIABLES_OF_TYPE(UInt8)
NO_VARIABLES_OF_TYPE(Int16)
NO_VARIABLES_OF_TYPE(UInt16)
NO_VARIABLES_OF_TYPE(Int32)
NO_VARIABLES_OF_TYPE(UInt32)
NO_VARIABLES_OF_TYPE(Int64)
NO_VARIABLES_OF_TYPE(UInt64)
NO_VARIABLES_OF_TYPE(Boolean)
NO_VARIABLES_OF_TYPE(String)
NO_VARIABLES(GetBinary, VALUE_REFERENCES, size_t size[], fmi3Binary value[], size_t values)
NO_VARIABLES(SetBinary, VALUE_REFERENCES, const size_t size[], const fmi3Binary value[],
             size_t values)
NO_VARIABLES(GetClock, VALUE_REFERENCES, fmi3Clock value[])
NO_VARIABLES(SetClock, VALUE_REFERENCES, const fmi3Clock value[])

/* Steps. */

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean noSetPrior,
                      fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation,
                      fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime)
{
    const char *problem = advance(c, t, h);

    *eventHandlingNeeded = *terminateSimulation = *earlyReturn = false;
    *lastSuccessfulTime = (problem == NULL) ? t + h : t;
    return answer_step(c, problem);
}

/* The state of the FMU: a copy. */

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state)
{
    return answer(c, copy_to_state(c, state));
}

fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state)
{
    memcpy(c, state, sizeof(memory));
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
    return answer(c, serialize(state, bytes, size));
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size,
                                   fmi3FMUState *state)
{
    return answer(c, deserialize(bytes, size, state));
}

/* What this FMU does not have. */

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                          fmi3Boolean visible, fmi3Boolean logging,
                                          fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log)
{
    instance fresh = {.environment = environment, .log = log};

    refuse(&fresh, ONLY_STEPS);
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

REFUSED(GetIntervalDecimal, VALUE_REFERENCES, fmi3Float64 interval[],
        fmi3IntervalQualifier qualifier[])
REFUSED(GetIntervalFraction, VALUE_REFERENCES, fmi3UInt64 counter[], fmi3UInt64 resolution[],
        fmi3IntervalQualifier qualifier[])
REFUSED(GetShiftDecimal, VALUE_REFERENCES, fmi3Float64 shift[])
REFUSED(GetShiftFraction, VALUE_REFERENCES, fmi3UInt64 counter[], fmi3UInt64 resolution[])
REFUSED(SetIntervalDecimal, VALUE_REFERENCES, const fmi3Float64 interval[])
REFUSED(SetIntervalFraction, VALUE_REFERENCES, const fmi3UInt64 counter[],
        const fmi3UInt64 resolution[])
REFUSED(SetShiftDecimal, VALUE_REFERENCES, const fmi3Float64 shift[])
REFUSED(SetShiftFraction, VALUE_REFERENCES, const fmi3UInt64 counter[],
        const fmi3UInt64 resolution[])
REFUSED(ActivateModelPartition, fmi3ValueReference clock, fmi3Float64 time)

REFUSED(GetNumberOfVariableDependencies, fmi3ValueReference vr, size_t *n)
REFUSED(GetVariableDependencies, fmi3ValueReference dependent, size_t element[],
        fmi3ValueReference independent[], size_t elements[], fmi3DependencyKind kind[], size_t n)
REFUSED(GetDirectionalDerivative, const fmi3ValueReference unknown[], size_t m,
        const fmi3ValueReference known[], size_t n, const fmi3Float64 seed[], size_t seeds,
        fmi3Float64 result[], size_t results)
REFUSED(GetAdjointDerivative, const fmi3ValueReference unknown[], size_t m,
        const fmi3ValueReference known[], size_t n, const fmi3Float64 seed[], size_t seeds,
        fmi3Float64 result[], size_t results)
REFUSED(GetOutputDerivatives, VALUE_REFERENCES, const fmi3Int32 order[], fmi3Float64 value[],
        size_t values)

REFUSED_ALONE(EnterConfigurationMode)
REFUSED_ALONE(ExitConfigurationMode)
REFUSED_ALONE(EnterStepMode)
REFUSED_ALONE(EvaluateDiscreteStates)
REFUSED(UpdateDiscreteStates, fmi3Boolean *needed, fmi3Boolean *terminate,
        fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *defined, fmi3Float64 *next)
REFUSED(SetTime, fmi3Float64 time)
REFUSED(SetContinuousStates, const fmi3Float64 x[], size_t n)
REFUSED(GetContinuousStates, fmi3Float64 x[], size_t n)
REFUSED(GetContinuousStateDerivatives, fmi3Float64 derivatives[], size_t n)
REFUSED(GetNominalsOfContinuousStates, fmi3Float64 nominal[], size_t n)
REFUSED(GetEventIndicators, fmi3Float64 indicators[], size_t n)
REFUSED(GetNumberOfEventIndicators, size_t *n)
REFUSED(GetNumberOfContinuousStates, size_t *n)
