/* NAME: see NAME.h. What Python has compiled is in NAME_programs.o; this is what lies around it. C99. */
#include "NAME.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

@DECLARED@

enum { RUNNING = 0, LINE = 64 };

/* A world is a row of words, some of them addresses of places in its data. */
typedef struct {
    const uint64_t *words;
    size_t count;
    const uint32_t (*pointers)[2];
    size_t addresses;
    const uint64_t *data;
    size_t bytes;
} world;

@TABLES@

/* Parameters: where they are, and what they may be; of those that are not drawn which they are, and all places. */
static const struct { uint32_t at; double least, most; } known[UPPER_PARAMETERS] = {
@SETTABLE@
};
enum { COPIES = @COPIES@ };
static const uint32_t copies[][2] = {@COPIED@};

struct NAME_arm {
    void *memory;
    uint64_t *words[@WORLDS@];
    unsigned char *data[@WORLDS@];
};

static size_t lines(size_t bytes) { return (bytes + LINE - 1) / LINE * LINE; }

NAME_arm *NAME_create(void)
{
    size_t bytes = lines(sizeof(NAME_arm)) + LINE;
    for (int k = 0; k < @WORLDS@; k++) bytes += lines(8 * worlds[k].count) + lines(worlds[k].bytes);
    unsigned char *memory = malloc(bytes);
    if (memory == NULL) return NULL;
    unsigned char *at = memory + (LINE - (uintptr_t)memory % LINE) % LINE;
    NAME_arm *arm = (NAME_arm *)at;
    at += lines(sizeof(NAME_arm));
    arm->memory = memory;
    for (int k = 0; k < @WORLDS@; k++) {
        const world *w = &worlds[k];
        arm->words[k] = memcpy(at, w->words, 8 * w->count);
        at += lines(8 * w->count);
        arm->data[k] = memcpy(at, w->data, w->bytes);
        at += lines(w->bytes);
        for (size_t i = 0; i < w->addresses; i++)
            arm->words[k][w->pointers[i][0]] = (uint64_t)(uintptr_t)(arm->data[k] + w->pointers[i][1]);
    }
    return arm;
}

void NAME_destroy(NAME_arm *arm)
{
    if (arm != NULL) free(arm->memory);
}

static int64_t place(const NAME_arm *arm, int k) { return (int64_t)(uintptr_t)arm->words[k]; }
static double *numbers(const NAME_arm *arm, int k, size_t at) { return (double *)(void *)(arm->data[k] + at); }
static int code(const NAME_arm *arm) { return (int)NAME_get_info(arm)->reason; }

/* What is not given is NULL or NAN. */
static int within(const double *values, int count, double most)
{
    for (int k = 0; values != NULL && k < count; k++)
        if (fabs(values[k]) > most) return 0;
    return 1;
}

/* Whether the arm reaches a target that is a point in the plane. */
static int reached(const double *target)
{
    if (!@POINT@ || target == NULL) return 1;
    const double away = hypot(target[0], target[UPPER_TARGET - 1]);
    return !(away < @NEAR@ || away > @FAR@);
}

int NAME_reset(NAME_arm *arm, uint64_t key, const double *angles, const double *target, double vibration)
{
    if (arm == NULL || !within(angles, UPPER_JOINTS, @FARTHEST@) || !within(target, UPPER_TARGET, @FAR_TARGET@)
        || !within(&vibration, 1, @FAR_VIBRATION@) || !reached(target))
        return UPPER_REFUSED;
    double *request = numbers(arm, 0, @REQUEST@), *record = numbers(arm, 0, @RECORD@);
    for (int k = 0; k < UPPER_JOINTS; k++) request[@ANGLES@ + k] = angles == NULL ? NAN : angles[k];
    for (int k = 0; k < UPPER_TARGET; k++) request[@TARGET_AT@ + k] = target == NULL ? NAN : target[k];
    for (int k = 0; k < 3; k++) request[@VIBRATION@ + k] = vibration; /* in space of each mode */
    *(uint64_t *)(void *)(arm->data[0] + @STREAM@) = key;
    *(int64_t *)(void *)(arm->data[0] + @QUEUE@) = 0;
    record[@ALLOWED@] = 1e15;
    for (int i = 0; i < COPIES; i++) /* what is not drawn */
        memcpy(arm->data[0] + copies[i][1], (const unsigned char *)worlds[0].data + copies[i][1], sizeof(double));
    NAME_start_program(place(arm, 0), RUNNING, 1);
    return code(arm);
}

int NAME_step(NAME_arm *arm, const double action[UPPER_JOINTS])
{
    if (arm == NULL || action == NULL) return UPPER_REFUSED;
    if (numbers(arm, 0, @RECORD@)[@MODE@] != RUNNING || numbers(arm, 0, @RECORD@)[@ALLOWED@] == 0.0) return UPPER_OVER;
    memcpy(arm->data[0] + @ACTION_AT@, action, UPPER_JOINTS * sizeof(double));
    NAME_step_program(place(arm, 0), 0, 1);
    return code(arm);
}
@TORQUES@
const NAME_info *NAME_get_info(const NAME_arm *arm) { return (const NAME_info *)(const void *)(arm->data[0] + @TABLE@); }
const NAME_pose *NAME_get_poses(const NAME_arm *arm) { return (const NAME_pose *)(const void *)(arm->data[0] + @POSES@); }
const float *NAME_get_observation(const NAME_arm *arm) { return (const float *)(const void *)(arm->data[0] + @SEEN@); }
double NAME_get_reward(const NAME_arm *arm) { return NAME_get_info(arm)->reward; }
double NAME_get_time(const NAME_arm *arm) { return numbers(arm, 0, @RECORD@)[@PERIODS@] * UPPER_PERIOD; }

void NAME_get_state(const NAME_arm *arm, void *state) { memcpy(state, arm->data[0], UPPER_STATE_BYTES); }

int NAME_set_state(NAME_arm *arm, const void *state)
{
    if (arm == NULL || state == NULL) return UPPER_REFUSED;
    memcpy(arm->data[0], state, UPPER_STATE_BYTES);
    return code(arm);
}

void NAME_get_parameters(const NAME_arm *arm, double parameters[UPPER_PARAMETERS])
{
    for (int k = 0; k < UPPER_PARAMETERS; k++) parameters[k] = *numbers(arm, 0, known[k].at);
}

int NAME_set_parameters(NAME_arm *arm, const double parameters[UPPER_PARAMETERS])
{
    if (arm == NULL || parameters == NULL) return UPPER_REFUSED;
    for (int k = 0; k < UPPER_PARAMETERS; k++)
        if (!(parameters[k] >= known[k].least && parameters[k] <= known[k].most)) return UPPER_REFUSED;
    for (int k = 0; k < UPPER_PARAMETERS; k++) *numbers(arm, 0, known[k].at) = parameters[k];
    for (int i = 0; i < COPIES; i++) *numbers(arm, 0, copies[i][1]) = parameters[copies[i][0]];
    return code(arm);
}

const char *NAME_status(int status)
{
    switch (status) {
@SENTENCES@
    case UPPER_OVER: return "the episode has ended, or none has begun: reset first";
    case UPPER_REFUSED: return "a number is not allowed; nothing has moved";
    }
    return "no status of this library";
}
@DERIVATIVES@
