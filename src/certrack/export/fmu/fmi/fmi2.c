/* FMI 2.0 co-simulation: the controller as an FMU.

   doStep(t, h) takes the sample at t with the inputs set before; then u is the command of t. */
#include "fmi2Functions.h"

#define FMI(NAME) fmi2##NAME
#define COMPONENT fmi2Component
#include "instance.h"

typedef struct {
    memory now; /* the first: see instance.h */
    const fmi2CallbackFunctions *callbacks;
    char name[]; /* copied: the caller's may be gone */
} instance;

/* The text is the format itself, for importers that do not format: it must contain no %. */
static void report(const fmi2CallbackFunctions *callbacks, const char *name, fmi2Status status,
                   const char *text)
{
    if (callbacks != NULL && callbacks->logger != NULL) {
        callbacks->logger(callbacks->componentEnvironment, name, status,
                          (status == fmi2Error) ? "logStatusError" : "logStatusWarning", text);
    }
}

static fmi2Status refuse(fmi2Component c, const char *text)
{
    const instance *self = c;

    report(self->callbacks, self->name, fmi2Error, text);
    return fmi2Error;
}

static fmi2Status warn(fmi2Component c, const char *text)
{
    const instance *self = c;

    report(self->callbacks, self->name, fmi2Warning, text);
    return fmi2Warning;
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid,
                              fmi2String resources, const fmi2CallbackFunctions *callbacks,
                              fmi2Boolean visible, fmi2Boolean logging)
{
    const char *problem = (type == fmi2CoSimulation) ? check_token(guid) : ONLY_STEPS;
    instance *self = NULL;

    if (problem == NULL && (self = calloc(1, sizeof *self + strlen(name) + 1)) == NULL) {
        problem = NO_MEMORY;
    }
    if (problem != NULL) {
        report(callbacks, name, fmi2Error, problem);
        return NULL;
    }
    self->callbacks = callbacks;
    strcpy(self->name, name);
    start(&self->now);
    return self;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance,
                               fmi2Real begin, fmi2Boolean stopDefined, fmi2Real stop)
{
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }

/* Variables; all of them are real numbers. */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    return answer(c, get_values(c, vr, n, value, false));
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                       const fmi2Real value[])
{
    return answer(c, set_values(c, vr, n, value));
}

#define NO_VARIABLES_OF_TYPE(TYPE) \
    NO_VARIABLES(Get##TYPE, VALUE_REFERENCES, fmi2##TYPE value[]) \
    NO_VARIABLES(Set##TYPE, VALUE_REFERENCES, const fmi2##TYPE value[])

NO_VARIABLES_OF_TYPE(Integer)
NO_VARIABLES_OF_TYPE(Boolean)
NO_VARIABLES_OF_TYPE(String)

/* Steps. */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean noSetPrior)
{
    return answer_step(c, advance(c, t, h));
}

/* The state of the FMU: a copy. */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    return answer(c, copy_to_state(c, state));
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    memcpy(c, state, sizeof(memory));
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
    return answer(c, serialize(state, bytes, size));
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size,
                                   fmi2FMUstate *state)
{
    return answer(c, deserialize(bytes, size, state));
}

/* What this FMU does not have. */

REFUSED(GetDirectionalDerivative, const fmi2ValueReference unknown[], size_t m,
        const fmi2ValueReference known[], size_t n, const fmi2Real seed[], fmi2Real result[])
REFUSED(SetRealInputDerivatives, VALUE_REFERENCES, const fmi2Integer order[],
        const fmi2Real value[])
REFUSED(GetRealOutputDerivatives, VALUE_REFERENCES, const fmi2Integer order[], fmi2Real value[])
REFUSED(GetStatus, const fmi2StatusKind kind, fmi2Status *value)
REFUSED(GetRealStatus, const fmi2StatusKind kind, fmi2Real *value)
REFUSED(GetIntegerStatus, const fmi2StatusKind kind, fmi2Integer *value)
REFUSED(GetBooleanStatus, const fmi2StatusKind kind, fmi2Boolean *value)
REFUSED(GetStringStatus, const fmi2StatusKind kind, fmi2String *value)
REFUSED(NewDiscreteStates, fmi2EventInfo *info)
REFUSED(SetTime, fmi2Real time)
REFUSED(SetContinuousStates, const fmi2Real x[], size_t n)
REFUSED(GetDerivatives, fmi2Real derivatives[], size_t n)
REFUSED(GetEventIndicators, fmi2Real indicators[], size_t n)
REFUSED(GetContinuousStates, fmi2Real x[], size_t n)
REFUSED(GetNominalsOfContinuousStates, fmi2Real nominal[], size_t n)
REFUSED_ALONE(CancelStep)
