/* from the joints to their goals, as it is read */
static void NAME_to_go(NAME_memory *m, const double *v, double *to_go)
{
    (void)m;
    for (int i = 0; i < UPPER_JOINTS; i++) to_go[i] = v[NAME_errors[i]];
}

static void NAME_aim(NAME_memory *m, const double *v)
{
    for (int i = 0; i < UPPER_JOINTS; i++)
        m->goal[i] = atan2(v[NAME_sines[i]], v[NAME_cosines[i]]) + v[NAME_errors[i]];
}
