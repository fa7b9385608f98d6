/* What the environment sets lies together, so that a state is this and the arm's bytes. */
typedef struct {
    double input[UPPER_JOINTS], parameters[UPPER_PARAMETERS], angles[UPPER_JOINTS], target[UPPER_TARGET], vibration, start, time;
    int seed, phase, fresh;
} outside;

typedef NAME_arm *inner;
enum { INNER = UPPER_STATE_BYTES };
/* --- */
static void set_up(unit *u)
{
    static const outside first = {.phase = MADE, .parameters = {@PARAMETERS@}, .target = {@AIM@}};
    u->now = first;
}

static int create(unit *u) { return (u->own = NAME_create()) != NULL; }
static void destroy(unit *u) { NAME_destroy(u->own); }
static void save_own(const unit *u, void *to) { NAME_get_state(u->own, to); }
static void restore_own(unit *u, const void *from) { NAME_set_state(u->own, from); }

/* Put the arm where it starts, as it has been asked for. */
static int started(unit *u)
{
    outside *now = &u->now;
    if (now->fresh) return OK;
    now->time = now->start;
    int status = NAME_reset(u->own, (uint64_t)(uint32_t)now->seed, now->angles, now->target, now->vibration);
    if (status == UPPER_OK) status = NAME_set_parameters(u->own, now->parameters);
    if (status != UPPER_OK) return say(u, ERROR, NAME_status(status));
    now->fresh = 1;
    return OK;
}

static int get(unit *u, uint32_t k, double *value)
{
    if (k >= COUNT || variables[k].kind == SEED) return say(u, ERROR, "a value reference that is no number's");
    const int at = variables[k].at;
    const outside *now = &u->now;
    if (variables[k].kind >= INFO && started(u) != OK) return ERROR;
    switch (variables[k].kind) {
    case INPUT: *value = now->input[at]; break;
    case PARAMETER: *value = now->parameters[at]; break;
    case ANGLE: *value = now->angles[at]; break;
    case TARGET: *value = now->target[at]; break;
    case VIBRATION: *value = now->vibration; break;
    case INFO: *value = ((const double *)(const void *)NAME_get_info(u->own))[at]; break;
    case POSE: *value = ((const double *)(const void *)NAME_get_poses(u->own))[at]; break;
    case OBSERVATION: *value = NAME_get_observation(u->own)[at]; break;
    default: *value = now->time;
    }
    return OK;
}

static int set(unit *u, uint32_t k, double value)
{
    const int at = variables[k].at;
    outside *now = &u->now;
    if (variables[k].kind == INPUT) {
        now->input[at] = value;
        return OK;
    }
    if (variables[k].kind == PARAMETER) {
        const double before = now->parameters[at];
        now->parameters[at] = value;
        if (now->phase == STEPPING && NAME_set_parameters(u->own, now->parameters) == UPPER_REFUSED) {
            now->parameters[at] = before;
            return say(u, ERROR, NAME_status(UPPER_REFUSED));
        }
    } else
        *(variables[k].kind == ANGLE ? &now->angles[at] : variables[k].kind == TARGET ? &now->target[at] : &now->vibration) = value;
    if (now->phase < STEPPING) now->fresh = 0;
    return OK;
}

/* A control period, through which the torques that are asked for act. */
static int period(unit *u)
{
    outside *now = &u->now;
    const int status = @STEP@(u->own, now->input);
    if (status != UPPER_OK) return say(u, ERROR, NAME_status(status));
    now->time = now->start + NAME_get_time(u->own);
    return OK;
}
