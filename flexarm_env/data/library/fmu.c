/* NAME as a functional mock-up unit: co-simulation, FMI 2.0 and 3.0, around what NAME is. */
#include "@INSIDE@"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { OK = 0, WARNING = 1, DISCARD = 2, ERROR = 3 }; /* of both standards */
enum { INPUT, PARAMETER, ANGLE, TARGET, VIBRATION, SEED, INFO, POSE, OBSERVATION, TIME };

/* What a value reference stands for: the kind of thing, and which of them. */
static const struct { int kind, at; } variables[] = {
@VARIABLES@
};
enum { COUNT = sizeof(variables) / sizeof(variables[0]) };

typedef void (*logger2)(void *, const char *, int, const char *, const char *, ...);
typedef void (*logger3)(void *, int, const char *, const char *);

@TYPES@
typedef struct {
    outside now;
    inner own;
    char *name;
    void *environment;
    logger2 told2;
    logger3 told3;
} unit;

static int say(unit *u, int status, const char *text)
{
    if (u->told2 != NULL) u->told2(u->environment, u->name, status, "logStatusError", "%s", text);
    if (u->told3 != NULL) u->told3(u->environment, status, "logStatusError", text);
    return status;
}

@FUNCTIONS@
static unit *made(const char *name, const char *token)
{
    if (token == NULL || strcmp(token, "@TOKEN@") != 0) return NULL;
    unit *u = calloc(1, sizeof(unit));
    if (u == NULL) return NULL;
    u->name = malloc(strlen(name) + 1);
    if (u->name == NULL || !create(u)) {
        free(u->name);
        free(u);
        return NULL;
    }
    strcpy(u->name, name);
    set_up(u);
    return u;
}

static void ended(unit *u)
{
    if (u == NULL) return;
    destroy(u);
    free(u->name);
    free(u);
}

/* Whole control periods. */
static int step(unit *u, double from, double length)
{
    const outside *now = &u->now;
    const double periods = length / UPPER_PERIOD, whole = floor(periods + 0.5);
    if (started(u) != OK) return ERROR;
    if (fabs(from - now->time) > 1e-6 * UPPER_PERIOD + 1e-12 * fabs(from))
        return say(u, ERROR, "the communication point is not where the last step ended");
    if (!(whole >= 1.0) || fabs(periods - whole) > 1e-6)
        return say(u, ERROR, "a communication step is @PERIOD@ s, or a whole number of times that");
    for (double k = 0.0; k < whole; k++)
        if (period(u) != OK) return ERROR;
    return OK;
}

enum { SAVED = sizeof(outside) + INNER };

static void save(const unit *u, unsigned char *to)
{
    memcpy(to, &u->now, sizeof(outside));
    save_own(u, to + sizeof(outside));
}

static void restore(unit *u, const unsigned char *from)
{
    memcpy(&u->now, from, sizeof(outside));
    restore_own(u, from + sizeof(outside));
}

static int kept(unit *u, void **state)
{
    if (*state == NULL && (*state = malloc(SAVED)) == NULL) return say(u, ERROR, "no memory");
    save(u, *state);
    return OK;
}

static int begin(unit *u)
{
    if (started(u) != OK) return ERROR;
    u->now.begun = 1;
    return OK;
}

static int again(unit *u)
{
    set_up(u);
    return OK;
}

static int let_go(void **state)
{
    if (state != NULL) free(*state), *state = NULL;
    return OK;
}

static int all(unit *u, const uint32_t *which, size_t count, double *out, const double *in)
{
    int worst = OK;
    for (size_t i = 0; i < count && worst == OK; i++) worst = in == NULL ? get(u, which[i], &out[i]) : set(u, which[i], in[i]);
    return worst;
}

static int seeds(unit *u, const uint32_t *which, size_t count, int *out, const int *in)
{
    for (size_t i = 0; i < count; i++) {
        if (which[i] >= COUNT || variables[which[i]].kind != SEED || (in != NULL && u->now.begun))
            return say(u, ERROR, "not a whole number, or not one that can be set now");
        if (in == NULL) out[i] = u->now.seed;
        else u->now.seed = in[i], u->now.fresh = 0;
    }
    return OK;
}

/* What is not there: arguments are as the standard has them, and not looked at. */
#define ABSENT(name) int name(void); int name(void) { return ERROR; }
#define DONE(name) int name(void *u); int name(void *u) { (void)u; return OK; }

/* --- FMI 2.0 --- */
typedef struct { logger2 logger; void *allocate, *release, *finished, *environment; } callbacks2;

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
void *fmi2Instantiate(const char *name, int kind, const char *token, const char *where, const callbacks2 *calls, int seen, int told)
{
    (void)where, (void)seen, (void)told;
    unit *u = kind == 1 ? made(name, token) : NULL;
    if (u != NULL && calls != NULL) u->told2 = calls->logger, u->environment = calls->environment;
    return u;
}
void fmi2FreeInstance(void *u) { ended(u); }
int fmi2SetDebugLogging(void *u, int on, size_t n, const char *const words[]) { (void)u, (void)on, (void)n, (void)words; return OK; }
int fmi2SetupExperiment(void *u, int has, double tolerance, double start, int ends, double end)
{
    (void)has, (void)tolerance, (void)ends, (void)end;
    ((unit *)u)->now.start = start, ((unit *)u)->now.fresh = 0;
    return OK;
}
DONE(fmi2EnterInitializationMode)
int fmi2ExitInitializationMode(void *u) { return begin(u); }
DONE(fmi2Terminate)
int fmi2Reset(void *u) { return again(u); }
int fmi2GetReal(void *u, const uint32_t *which, size_t n, double *values) { return all(u, which, n, values, NULL); }
int fmi2SetReal(void *u, const uint32_t *which, size_t n, const double *values) { return all(u, which, n, NULL, values); }
int fmi2GetInteger(void *u, const uint32_t *which, size_t n, int *values) { return seeds(u, which, n, values, NULL); }
int fmi2SetInteger(void *u, const uint32_t *which, size_t n, const int *values) { return seeds(u, which, n, NULL, values); }
int fmi2GetFMUstate(void *u, void **state) { return kept(u, state); }
int fmi2SetFMUstate(void *u, void *state) { restore(u, state); return OK; }
int fmi2FreeFMUstate(void *u, void **state) { (void)u; return let_go(state); }
int fmi2SerializedFMUstateSize(void *u, void *state, size_t *size) { (void)u, (void)state; *size = SAVED; return OK; }
int fmi2SerializeFMUstate(void *u, void *state, unsigned char *to, size_t size)
{
    if (size < SAVED) return say(u, ERROR, "too little room for a state");
    memcpy(to, state, SAVED);
    return OK;
}
int fmi2DeSerializeFMUstate(void *u, const unsigned char *from, size_t size, void **state)
{
    if (size != SAVED) return say(u, ERROR, "not a state of this unit");
    if (kept(u, state) != OK) return ERROR;
    memcpy(*state, from, SAVED);
    return OK;
}
int fmi2DoStep(void *u, double from, double length, int last) { (void)last; return step(u, from, length); }
ABSENT(fmi2GetBoolean) ABSENT(fmi2GetString) ABSENT(fmi2SetBoolean) ABSENT(fmi2SetString)
ABSENT(fmi2GetDirectionalDerivative) ABSENT(fmi2SetRealInputDerivatives) ABSENT(fmi2GetRealOutputDerivatives)
ABSENT(fmi2CancelStep) ABSENT(fmi2GetStatus) ABSENT(fmi2GetRealStatus) ABSENT(fmi2GetIntegerStatus)
ABSENT(fmi2GetBooleanStatus) ABSENT(fmi2GetStringStatus)

/* --- FMI 3.0 --- */
typedef unsigned char truth3;

const char *fmi3GetVersion(void) { return "3.0"; }
void *fmi3InstantiateCoSimulation(
    const char *name, const char *token, const char *where, truth3 seen, truth3 told, truth3 events, truth3 early,
    const uint32_t *between, size_t count, void *environment, logger3 logger, void *update)
{
    (void)where, (void)seen, (void)told, (void)events, (void)early, (void)between, (void)count, (void)update;
    unit *u = made(name, token);
    if (u != NULL) u->told3 = logger, u->environment = environment;
    return u;
}
void *fmi3InstantiateModelExchange(void);
void *fmi3InstantiateModelExchange(void) { return NULL; }
void *fmi3InstantiateScheduledExecution(void);
void *fmi3InstantiateScheduledExecution(void) { return NULL; }
void fmi3FreeInstance(void *u) { ended(u); }
int fmi3SetDebugLogging(void *u, truth3 on, size_t n, const char *const words[]) { (void)u, (void)on, (void)n, (void)words; return OK; }
int fmi3EnterInitializationMode(void *u, truth3 has, double tolerance, double start, truth3 ends, double end)
{
    return fmi2SetupExperiment(u, has, tolerance, start, ends, end);
}
int fmi3ExitInitializationMode(void *u) { return begin(u); }
DONE(fmi3Terminate)
int fmi3Reset(void *u) { return again(u); }
int fmi3GetFloat64(void *u, const uint32_t *which, size_t n, double *values, size_t m) { return n == m ? all(u, which, n, values, NULL) : ERROR; }
int fmi3SetFloat64(void *u, const uint32_t *which, size_t n, const double *values, size_t m) { return n == m ? all(u, which, n, NULL, values) : ERROR; }
int fmi3GetInt32(void *u, const uint32_t *which, size_t n, int *values, size_t m) { return n == m ? seeds(u, which, n, values, NULL) : ERROR; }
int fmi3SetInt32(void *u, const uint32_t *which, size_t n, const int *values, size_t m) { return n == m ? seeds(u, which, n, NULL, values) : ERROR; }
int fmi3GetFMUState(void *u, void **state) { return kept(u, state); }
int fmi3SetFMUState(void *u, void *state) { restore(u, state); return OK; }
int fmi3FreeFMUState(void *u, void **state) { (void)u; return let_go(state); }
int fmi3SerializedFMUStateSize(void *u, void *state, size_t *size) { return fmi2SerializedFMUstateSize(u, state, size); }
int fmi3SerializeFMUState(void *u, void *state, unsigned char *to, size_t size) { return fmi2SerializeFMUstate(u, state, to, size); }
int fmi3DeserializeFMUState(void *u, const unsigned char *from, size_t size, void **state) { return fmi2DeSerializeFMUstate(u, from, size, state); }
int fmi3DoStep(
    void *u, double from, double length, truth3 last, truth3 *event, truth3 *stop, truth3 *early, double *reached)
{
    (void)last;
    const int status = step(u, from, length);
    *event = 0, *stop = 0, *early = 0, *reached = ((unit *)u)->now.time;
    return status;
}
DONE(fmi3EnterEventMode) DONE(fmi3EnterStepMode) DONE(fmi3EnterConfigurationMode) DONE(fmi3ExitConfigurationMode)
ABSENT(fmi3GetFloat32) ABSENT(fmi3GetInt8) ABSENT(fmi3GetUInt8) ABSENT(fmi3GetInt16) ABSENT(fmi3GetUInt16)
ABSENT(fmi3GetUInt32) ABSENT(fmi3GetInt64) ABSENT(fmi3GetUInt64) ABSENT(fmi3GetBoolean) ABSENT(fmi3GetString)
ABSENT(fmi3GetBinary) ABSENT(fmi3GetClock) ABSENT(fmi3SetFloat32) ABSENT(fmi3SetInt8) ABSENT(fmi3SetUInt8)
ABSENT(fmi3SetInt16) ABSENT(fmi3SetUInt16) ABSENT(fmi3SetUInt32) ABSENT(fmi3SetInt64) ABSENT(fmi3SetUInt64)
ABSENT(fmi3SetBoolean) ABSENT(fmi3SetString) ABSENT(fmi3SetBinary) ABSENT(fmi3SetClock)
ABSENT(fmi3GetNumberOfVariableDependencies) ABSENT(fmi3GetVariableDependencies) ABSENT(fmi3GetDirectionalDerivative)
ABSENT(fmi3GetAdjointDerivative) ABSENT(fmi3GetIntervalDecimal) ABSENT(fmi3GetIntervalFraction)
ABSENT(fmi3GetShiftDecimal) ABSENT(fmi3GetShiftFraction) ABSENT(fmi3SetIntervalDecimal)
ABSENT(fmi3SetIntervalFraction) ABSENT(fmi3SetShiftDecimal) ABSENT(fmi3SetShiftFraction)
ABSENT(fmi3EvaluateDiscreteStates) ABSENT(fmi3UpdateDiscreteStates) ABSENT(fmi3EnterContinuousTimeMode)
ABSENT(fmi3CompletedIntegratorStep) ABSENT(fmi3SetTime) ABSENT(fmi3SetContinuousStates)
ABSENT(fmi3GetContinuousStateDerivatives) ABSENT(fmi3GetEventIndicators) ABSENT(fmi3GetContinuousStates)
ABSENT(fmi3GetNominalsOfContinuousStates) ABSENT(fmi3GetNumberOfEventIndicators)
ABSENT(fmi3GetNumberOfContinuousStates) ABSENT(fmi3GetOutputDerivatives) ABSENT(fmi3ActivateModelPartition)
