static void NAME_begin(NAME_memory *m, const double *v, const double *to_go)
{
    double weight[UPPER_JOINTS], about[UPPER_JOINTS * UPPER_JOINTS];
    (void)v;
    NAME_hold(m->goal, weight, about);
    for (int i = 0; i < UPPER_JOINTS; i++) m->torque[i] -= weight[i];
    NAME_times(NAME_OF(rigid, UPPER_STATES, UPPER_JOINTS), UPPER_STATES, UPPER_JOINTS, to_go, m->x);
    for (int i = 0; i < UPPER_STATES; i++) m->x[i] = -m->x[i];
}

static void NAME_torques(NAME_memory *m, const double *v, const double *to_go, double *torque)
{
    const long k = m->step < UPPER_LEARNING ? m->step : UPPER_LEARNING - 1;
    const double *still = NAME_OF(still, UPPER_OUTPUTS, 1);
    double y[UPPER_OUTPUTS], angle[UPPER_JOINTS], taken[UPPER_JOINTS], pulled[UPPER_JOINTS], beyond[UPPER_JOINTS];
    double about[UPPER_JOINTS * UPPER_JOINTS];
    for (int i = 0; i < UPPER_JOINTS; i++) {
        const double most = UPPER_FARTHEST, near = to_go[i] < -most ? -most : to_go[i] > most ? most : to_go[i];
        angle[i] = m->goal[i] - to_go[i];
        beyond[i] = to_go[i] - near;
        y[i] = -to_go[i];
    }
    SEEN
    for (int i = 0; i < UPPER_OUTPUTS; i++) y[i] -= still[i];
    NAME_update(m, NAME_OF(L, UPPER_LEARNING, UPPER_STATES * UPPER_OUTPUTS) + k * UPPER_STATES * UPPER_OUTPUTS, y);
    NAME_times(NAME_OF(K, UPPER_JOINTS, UPPER_STATES), UPPER_JOINTS, UPPER_STATES, m->x, torque);
    for (int i = 0; i < UPPER_JOINTS; i++) torque[i] = -torque[i];
    NAME_friction(m, torque, SHARP, taken);
    NAME_times(NAME_OF(pull, UPPER_JOINTS, UPPER_JOINTS), UPPER_JOINTS, UPPER_JOINTS, beyond, pulled);
    NAME_hold(angle, m->held, about);
    for (int i = 0; i < UPPER_JOINTS; i++) {
        m->held[i] += m->torque[i];
        torque[i] += taken[i] - pulled[i] + m->held[i];
    }
}

static void NAME_predict(NAME_memory *m, const double *torque)
{
    double left[UPPER_JOINTS], taken[UPPER_JOINTS];
    for (int i = 0; i < UPPER_JOINTS; i++) left[i] = torque[i] - m->held[i];
    NAME_friction(m, left, 1.0, taken);
    for (int i = 0; i < UPPER_JOINTS; i++) left[i] -= taken[i];
    NAME_move(m, left);
}
