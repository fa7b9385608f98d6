static void NAME_begin(NAME_memory *m, const double *v, const double *to_go)
{
    double y[UPPER_OUTPUTS];
    NAME_outputs(v, to_go, y);
    NAME_times(NAME_OF(start, UPPER_STATES, UPPER_OUTPUTS), UPPER_STATES, UPPER_OUTPUTS, y, m->x);
}

static void NAME_torques(NAME_memory *m, const double *v, const double *to_go, double *torque)
{
    double y[UPPER_OUTPUTS];
    NAME_outputs(v, to_go, y);
    NAME_update(m, NAME_OF(L, UPPER_STATES, UPPER_OUTPUTS), y);
    NAME_times(NAME_OF(K, UPPER_JOINTS, UPPER_STATES), UPPER_JOINTS, UPPER_STATES, m->x, torque);
    for (int i = 0; i < UPPER_JOINTS; i++) torque[i] = -torque[i];
}
