static void NAME_begin(NAME_memory *m, const double *v, const double *to_go)
{
    (void)v;
    NAME_times(NAME_OF(rigid, UPPER_STATES, UPPER_JOINTS), UPPER_STATES, UPPER_JOINTS, to_go, m->x);
    for (int i = 0; i < UPPER_STATES; i++) m->x[i] = -m->x[i];
}

static void NAME_torques(NAME_memory *m, const double *v, const double *to_go, double *torque)
{
    const long k = m->step < UPPER_LEARNING ? m->step : UPPER_LEARNING - 1;
    double y[UPPER_OUTPUTS], angle[UPPER_JOINTS], taken[UPPER_JOINTS];
    for (int i = 0; i < UPPER_JOINTS; i++) {
        angle[i] = m->goal[i] - to_go[i];
        y[i] = -to_go[i];
    }
    m->posture = NAME_nearest(angle);
    GAUGED
    NAME_update(m, NAME_OF(L, UPPER_LEARNING, UPPER_STATES * UPPER_OUTPUTS) + k * UPPER_STATES * UPPER_OUTPUTS, y);
    NAME_times(NAME_OF(K, UPPER_JOINTS, UPPER_STATES), UPPER_JOINTS, UPPER_STATES, m->x, torque);
    for (int i = 0; i < UPPER_JOINTS; i++) torque[i] = -torque[i];
    NAME_friction(m, torque, SHARP, taken);
    for (int i = 0; i < UPPER_JOINTS; i++) torque[i] += taken[i];
}

static void NAME_predict(NAME_memory *m, const double *torque)
{
    double left[UPPER_JOINTS], taken[UPPER_JOINTS];
    NAME_friction(m, torque, 1.0, taken);
    for (int i = 0; i < UPPER_JOINTS; i++) left[i] = torque[i] - taken[i];
    NAME_move(m, left);
}
