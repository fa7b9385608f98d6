static void NAME_begin(NAME_memory *m, const double *v, const double *to_go)
{
    double weight[UPPER_JOINTS];
    (void)to_go;
    NAME_hold(m->goal, weight, m->inertia);
    for (int k = 0; k < UPPER_JOINTS; k++) m->torque[k] -= weight[k], m->rate[k] = v[NAME_rates[k]];
}

static void NAME_torques(NAME_memory *m, const double *v, const double *to_go, double *torque)
{
    double angle[UPPER_JOINTS], about[UPPER_JOINTS];
    for (int k = 0; k < UPPER_JOINTS; k++) angle[k] = m->goal[k] - to_go[k];
    NAME_hold(angle, torque, about);
    for (int k = 0; k < UPPER_JOINTS; k++) {
        const double way = to_go[k] > 1.0 ? 1.0 : to_go[k] < -1.0 ? -1.0 : to_go[k];
        m->rate[k] += NAME_filter[0] * (v[NAME_rates[k]] - m->rate[k]);
        torque[k] += m->torque[k] + m->inertia[k] * (NAME_filter[1] * way - NAME_filter[2] * m->rate[k]);
    }
}

static void NAME_predict(NAME_memory *m, const double *torque) { (void)m; (void)torque; }
