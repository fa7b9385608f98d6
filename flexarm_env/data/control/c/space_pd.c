static void NAME_begin(NAME_memory *m, const double *v, const double *to_go)
{
    double weight[UPPER_JOINTS], inertia[UPPER_JOINTS * UPPER_JOINTS];
    NAME_hold(m->goal, weight, inertia);
    for (int k = 0; k < UPPER_JOINTS; k++) {
        m->torque[k] -= weight[k];
        m->inertia[k] = inertia[(UPPER_JOINTS + 1) * k];
        m->rate[k] = v[NAME_rates[k]];
    }
    NAME_shape(m, to_go);
}

static void NAME_torques(NAME_memory *m, const double *v, const double *to_go, double *torque)
{
    double angle[UPPER_JOINTS], about[UPPER_JOINTS * UPPER_JOINTS];
    double left[UPPER_JOINTS], rates[UPPER_JOINTS], moved[UPPER_JOINTS];
    for (int k = 0; k < UPPER_JOINTS; k++) angle[k] = m->goal[k] - to_go[k];
    NAME_hold(angle, torque, about);
    NAME_follow(m, left, rates, moved);
    for (int k = 0; k < UPPER_JOINTS; k++) {
        const double off = to_go[k] - left[k], way = off > 1.0 ? 1.0 : off < -1.0 ? -1.0 : off;
        m->rate[k] += NAME_filter[0] * (v[NAME_rates[k]] - rates[k] - m->rate[k]);
        torque[k] += m->torque[k] + moved[k] + m->inertia[k] * (NAME_filter[1] * way - NAME_filter[2] * m->rate[k]);
    }
}

static void NAME_predict(NAME_memory *m, const double *torque) { (void)m; (void)torque; }
