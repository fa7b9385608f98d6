static void NAME_begin(NAME_memory *m, const double *v, const double *to_go)
{
    double y[UPPER_OUTPUTS];
    NAME_outputs(v, to_go, y);
    NAME_times(NAME_start, UPPER_STATES, UPPER_OUTPUTS, y, m->x);
    m->sign = y[0] > 0.0 ? -1.0 : 1.0;
}

static void NAME_torques(NAME_memory *m, const double *v, const double *to_go, double *torque)
{
    double y[UPPER_OUTPUTS], off[UPPER_STATES];
    const int along = m->step < UPPER_PERIODS;
    NAME_outputs(v, to_go, y);
    NAME_update(m, NAME_L, y);
    for (int i = 0; i < UPPER_STATES; i++)
        off[i] = m->x[i] - (along ? m->sign * NAME_way[m->step * UPPER_STATES + i] : 0.0);
    NAME_times(NAME_K, 1, UPPER_STATES, off, torque);
    torque[0] = (along ? m->sign * NAME_plan[m->step] : 0.0) - torque[0];
}
