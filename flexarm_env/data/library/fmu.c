/* NAME as a functional mock-up unit: co-simulation, FMI 2.0 and 3.0, around what NAME is. */
#include "@INSIDE@"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { OK = 0, WARNING = 1, DISCARD = 2, ERROR = 3 }; /* of both standards */
enum { MADE = 1, ENTERED = 2, STEPPING = 4, ENDED = 8, ANY = 15 }; /* phases of a unit */
enum { INPUT, PARAMETER, ANGLE, TARGET, VIBRATION, SEED, INFO, POSE, OBSERVATION, TIME };

/* What a value reference stands for: the kind of thing, which of them, what it may be set to, and its name. */
static const struct { int kind, at; double least, most; const char *name; } variables[] = {
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
    if (u == NULL) return status;
    if (u->told2 != NULL) u->told2(u->environment, u->name, status, "logStatusError", "%s", text);
    if (u->told3 != NULL) u->told3(u->environment, status, "logStatusError", text);
    return status;
}

/* Whether a call is one of these phases; a sentence where it is not. */
static int in_order(unit *u, int phases, const char *text)
{
    if (u == NULL) return ERROR;
    return u->now.phase & phases ? OK : say(u, ERROR, text);
}

@FUNCTIONS@
/* What has `given` for how its tool listens; NULL, and a sentence, where there is none. */
static unit *made(const char *name, const char *token, unit given)
{
    unit *u = NULL;
    given.name = (char *)(uintptr_t)(name == NULL ? "" : name);
    if (token == NULL || strcmp(token, "@TOKEN@") != 0) {
        say(&given, ERROR, "the token (guid) is not that of this unit's modelDescription.xml, @TOKEN@");
        return NULL;
    }
    if ((u = calloc(1, sizeof(unit))) != NULL) {
        *u = given;
        u->name = malloc(strlen(given.name) + 1);
        if (u->name != NULL && create(u)) {
            strcpy(u->name, given.name);
            set_up(u);
            return u;
        }
        free(u->name);
        free(u);
    }
    say(&given, ERROR, "no memory");
    return NULL;
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
    const double periods = length / UPPER_PERIOD, whole = floor(periods + 0.5);
    if (in_order(u, STEPPING, "DoStep is for between ExitInitializationMode and Terminate") != OK) return ERROR;
    if (!(fabs(from - u->now.time) <= 1e-6 * UPPER_PERIOD + 1e-12 * fabs(u->now.time)))
        return say(u, ERROR, "the communication point is not where the last step ended");
    if (!(whole >= 1.0 && whole <= 1e6) || fabs(periods - whole) > 1e-6)
        return say(u, ERROR, "a communication step is @PERIOD@ s, or a whole number of times that, a million at most");
    for (double k = 0.0; k < whole; k++)
        if (period(u) != OK) return ERROR;
    return OK;
}

/* A state: its stamp, what is set, and what is inside. */
enum { STAMP = sizeof(uint64_t), SAVED = STAMP + sizeof(outside) + INNER };

/* Of this build and of all bytes of a state: one that is damaged, or of another unit, has another. */
static uint64_t stamp(const unsigned char *state)
{
    uint64_t sum = 14695981039346656037u;
    for (const char *c = "@TOKEN@"; *c != 0; c++) sum = (sum ^ (unsigned char)*c) * 1099511628211u;
    for (size_t k = STAMP; k < SAVED; k++) sum = (sum ^ state[k]) * 1099511628211u;
    return sum;
}

static int is_state(unit *u, const unsigned char *state)
{
    uint64_t found = 0;
    if (state != NULL) memcpy(&found, state, STAMP);
    return state != NULL && found == stamp(state) ? OK : say(u, ERROR, "not a state of this unit, or a damaged one");
}

static int restore(unit *u, const unsigned char *from)
{
    if (is_state(u, from) != OK) return ERROR;
    memcpy(&u->now, from + STAMP, sizeof(outside));
    restore_own(u, from + STAMP + sizeof(outside));
    return OK;
}

static int kept(unit *u, void **state)
{
    if (state == NULL || (*state == NULL && (*state = malloc(SAVED)) == NULL)) return say(u, ERROR, "no memory");
    unsigned char *to = *state;
    memcpy(to + STAMP, &u->now, sizeof(outside));
    save_own(u, to + STAMP + sizeof(outside));
    const uint64_t sum = stamp(to);
    memcpy(to, &sum, STAMP);
    return OK;
}

/* From the phase `from` to the phase `to`. */
static int next(unit *u, int from, int to, const char *text)
{
    if (in_order(u, from, text) != OK || (to == STEPPING && started(u) != OK)) return ERROR;
    u->now.phase = to;
    return OK;
}

static int set_start(unit *u, double start)
{
    if (in_order(u, MADE, "the start time is set before EnterInitializationMode") != OK) return ERROR;
    if (!(fabs(start) <= 1e10)) return say(u, ERROR, "the start time must be a finite number, at most 1e10 s in size");
    u->now.start = start, u->now.fresh = 0;
    return OK;
}

static int enter(unit *u) { return next(u, MADE, ENTERED, "EnterInitializationMode is for a unit that was just made, or reset"); }
static int begin(unit *u) { return next(u, ENTERED, STEPPING, "ExitInitializationMode is for after EnterInitializationMode"); }
static int end(unit *u) { return next(u, STEPPING, ENDED, "Terminate is for after ExitInitializationMode"); }

static int again(unit *u)
{
    if (u == NULL) return ERROR;
    set_up(u);
    return OK;
}

static int let_go(void **state)
{
    if (state != NULL) free(*state), *state = NULL;
    return OK;
}

/* Whether a number may be set to a value now; a sentence that names both where it may not. */
static int fits(unit *u, uint32_t k, double value)
{
    char text[200];
    if (k >= COUNT || variables[k].kind >= SEED) return say(u, ERROR, "a value reference that cannot be set");
    if (variables[k].kind > PARAMETER && u->now.phase > ENTERED)
        snprintf(text, sizeof(text), "%s: where the arm starts is set before it starts", variables[k].name);
    else if (value >= variables[k].least && value <= variables[k].most) return OK;
    else
        snprintf(text, sizeof(text), "%s = %g: must be a number from %g to %g", variables[k].name, value,
            variables[k].least, variables[k].most);
    return say(u, ERROR, text);
}

static const char LATE[] = "after Terminate nothing is set: reset first";

static int all(unit *u, const uint32_t *which, size_t count, size_t values, double *out, const double *in)
{
    int worst = in_order(u, in == NULL ? ANY : ANY - ENDED, LATE);
    if (worst == OK && count != values) return say(u, ERROR, "as many values as references are wanted");
    for (size_t i = 0; i < count && worst == OK; i++)
        worst = in == NULL ? get(u, which[i], &out[i]) : fits(u, which[i], in[i]) == OK ? set(u, which[i], in[i]) : ERROR;
    return worst;
}

static int seeds(unit *u, const uint32_t *which, size_t count, size_t values, int *out, const int *in)
{
    if (in_order(u, in == NULL ? ANY : ANY - ENDED, LATE) != OK) return ERROR;
    if (count != values) return say(u, ERROR, "as many values as references are wanted");
    for (size_t i = 0; i < count; i++) {
        if (which[i] >= COUNT || variables[which[i]].kind != SEED || (in != NULL && u->now.phase > ENTERED))
            return say(u, ERROR, "not a whole number, or not one that can be set now");
        if (in == NULL) out[i] = u->now.seed;
        else u->now.seed = in[i], u->now.fresh = 0;
    }
    return OK;
}

/* What is not there: further arguments are as the standard has them, and not looked at. */
#define ABSENT(name) int name(void *u); int name(void *u) { return say(u, ERROR, #name " is not there"); }
#define DONE(name) int name(void *u); int name(void *u) { (void)u; return OK; }

/* --- FMI 2.0 --- */
typedef struct { logger2 logger; void *allocate, *release, *finished, *environment; } callbacks2;

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
void *fmi2Instantiate(const char *name, int kind, const char *token, const char *where, const callbacks2 *calls, int seen, int told)
{
    (void)where, (void)seen, (void)told;
    unit given = {.name = NULL};
    if (calls != NULL) given.told2 = calls->logger, given.environment = calls->environment;
    if (kind == 1) return made(name, token, given);
    say(&given, ERROR, "this unit is for co-simulation alone");
    return NULL;
}
void fmi2FreeInstance(void *u) { ended(u); }
int fmi2SetDebugLogging(void *u, int on, size_t n, const char *const words[]) { (void)u, (void)on, (void)n, (void)words; return OK; }
int fmi2SetupExperiment(void *u, int has, double tolerance, double start, int ends, double stop)
{
    (void)has, (void)tolerance, (void)ends, (void)stop;
    return set_start(u, start);
}
int fmi2EnterInitializationMode(void *u) { return enter(u); }
int fmi2ExitInitializationMode(void *u) { return begin(u); }
int fmi2Terminate(void *u) { return end(u); }
int fmi2Reset(void *u) { return again(u); }
int fmi2GetReal(void *u, const uint32_t *which, size_t n, double *values) { return all(u, which, n, n, values, NULL); }
int fmi2SetReal(void *u, const uint32_t *which, size_t n, const double *values) { return all(u, which, n, n, NULL, values); }
int fmi2GetInteger(void *u, const uint32_t *which, size_t n, int *values) { return seeds(u, which, n, n, values, NULL); }
int fmi2SetInteger(void *u, const uint32_t *which, size_t n, const int *values) { return seeds(u, which, n, n, NULL, values); }
int fmi2GetFMUstate(void *u, void **state) { return u == NULL ? ERROR : kept(u, state); }
int fmi2SetFMUstate(void *u, void *state) { return u == NULL ? ERROR : restore(u, state); }
int fmi2FreeFMUstate(void *u, void **state) { (void)u; return let_go(state); }
int fmi2SerializedFMUstateSize(void *u, void *state, size_t *size) { (void)u, (void)state; *size = SAVED; return OK; }
int fmi2SerializeFMUstate(void *u, void *state, unsigned char *to, size_t size)
{
    if (is_state(u, state) != OK) return ERROR;
    if (size < SAVED) return say(u, ERROR, "too little room for a state");
    memcpy(to, state, SAVED);
    return OK;
}
int fmi2DeSerializeFMUstate(void *u, const unsigned char *from, size_t size, void **state)
{
    if (size != SAVED || u == NULL) return say(u, ERROR, "not a state of this unit");
    if (is_state(u, from) != OK || kept(u, state) != OK) return ERROR;
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
    const unit given = {.told3 = logger, .environment = environment};
    return made(name, token, given);
}
void *fmi3InstantiateModelExchange(void);
void *fmi3InstantiateModelExchange(void) { return NULL; }
void *fmi3InstantiateScheduledExecution(void);
void *fmi3InstantiateScheduledExecution(void) { return NULL; }
void fmi3FreeInstance(void *u) { ended(u); }
int fmi3SetDebugLogging(void *u, truth3 on, size_t n, const char *const words[]) { (void)u, (void)on, (void)n, (void)words; return OK; }
int fmi3EnterInitializationMode(void *u, truth3 has, double tolerance, double start, truth3 ends, double stop)
{
    (void)has, (void)tolerance, (void)ends, (void)stop;
    return set_start(u, start) == OK ? enter(u) : ERROR;
}
int fmi3ExitInitializationMode(void *u) { return begin(u); }
int fmi3Terminate(void *u) { return end(u); }
int fmi3Reset(void *u) { return again(u); }
int fmi3GetFloat64(void *u, const uint32_t *which, size_t n, double *values, size_t m) { return all(u, which, n, m, values, NULL); }
int fmi3SetFloat64(void *u, const uint32_t *which, size_t n, const double *values, size_t m) { return all(u, which, n, m, NULL, values); }
int fmi3GetInt32(void *u, const uint32_t *which, size_t n, int *values, size_t m) { return seeds(u, which, n, m, values, NULL); }
int fmi3SetInt32(void *u, const uint32_t *which, size_t n, const int *values, size_t m) { return seeds(u, which, n, m, NULL, values); }
int fmi3GetFMUState(void *u, void **state) { return fmi2GetFMUstate(u, state); }
int fmi3SetFMUState(void *u, void *state) { return u == NULL ? ERROR : restore(u, state); }
int fmi3FreeFMUState(void *u, void **state) { (void)u; return let_go(state); }
int fmi3SerializedFMUStateSize(void *u, void *state, size_t *size) { return fmi2SerializedFMUstateSize(u, state, size); }
int fmi3SerializeFMUState(void *u, void *state, unsigned char *to, size_t size) { return fmi2SerializeFMUstate(u, state, to, size); }
int fmi3DeserializeFMUState(void *u, const unsigned char *from, size_t size, void **state) { return fmi2DeSerializeFMUstate(u, from, size, state); }
int fmi3DoStep(
    void *u, double from, double length, truth3 last, truth3 *event, truth3 *stop, truth3 *early, double *reached)
{
    (void)last;
    const int status = step(u, from, length);
    *event = 0, *stop = 0, *early = 0, *reached = u == NULL ? from : ((unit *)u)->now.time;
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
