/* What it is told and what it says; its memory beside that is a state. */
typedef struct {
    float seen[UPPER_HISTORY * UPPER_ENTRIES];
    double torque[UPPER_JOINTS], start, time, periods;
    int seed, phase, fresh;
} outside;

typedef NAME_memory inner;
enum { INNER = sizeof(inner) };
/* --- */
static void set_up(unit *u)
{
    static const outside first = {.phase = MADE};
    u->now = first;
}

static int create(unit *u) { return u != NULL; }
static void destroy(unit *u) { (void)u; }
static void save_own(const unit *u, void *to) { memcpy(to, &u->own, sizeof(inner)); }
static void restore_own(unit *u, const void *from) { memcpy(&u->own, from, sizeof(inner)); }

static int started(unit *u)
{
    outside *now = &u->now;
    if (now->fresh) return OK;
    now->time = now->start, now->periods = 0.0, now->fresh = 1;
    for (int k = 0; k < UPPER_JOINTS; k++) now->torque[k] = 0.0;
    NAME_reset(&u->own);
    return OK;
}

static int get(unit *u, uint32_t k, double *value)
{
    if (k >= COUNT) return say(u, ERROR, "a value reference that is no number's");
    const int at = variables[k].at;
    started(u);
    *value = variables[k].kind == INPUT ? u->now.seen[at] : variables[k].kind == TIME ? u->now.time : u->now.torque[at];
    return OK;
}

static int set(unit *u, uint32_t k, double value)
{
    u->now.seen[variables[k].at] = (float)value;
    return OK;
}

/* A control period: what is to act through it, by what is seen now. */
static int period(unit *u)
{
    outside *now = &u->now;
    float action[UPPER_JOINTS];
    NAME_decide(&u->own, now->seen, action);
    for (int k = 0; k < UPPER_JOINTS; k++) now->torque[k] = (double)action[k] * NAME_limit[k];
    now->time = now->start + ++now->periods * UPPER_PERIOD;
    return OK;
}
