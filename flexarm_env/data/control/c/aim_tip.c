/* the straight arm's tip is where its hub points: a cantilever bent by its tip */
static void NAME_to_go(NAME_memory *m, const double *v, double *to_go)
{
    const double b = v[NAME_bends[0]], bend = b < -0.9 ? -0.9 : b > 0.9 ? 0.9 : b;
    (void)m;
    to_go[0] = v[NAME_errors[0]] + atan2(bend, 1.0 - 0.6 * bend * bend);
}

static void NAME_aim(NAME_memory *m, const double *v)
{
    double to_go[UPPER_JOINTS];
    NAME_to_go(m, v, to_go);
    m->goal[0] = atan2(v[NAME_sines[0]], v[NAME_cosines[0]]) + to_go[0];
}
