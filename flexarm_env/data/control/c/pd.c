static void NAME_begin(NAME_memory *m, const double *v, const double *to_go) { (void)v; NAME_shape(m, to_go); }

static void NAME_torques(NAME_memory *m, const double *v, const double *to_go, double *torque)
{
    double left[UPPER_JOINTS], rates[UPPER_JOINTS];
    NAME_follow(m, left, rates, torque);
    for (int i = 0; i < UPPER_JOINTS; i++) {
        torque[i] += NAME_kp[i] * (to_go[i] - left[i]);
        torque[i] += NAME_kd[i] * (rates[i] - v[NAME_rates[i]]);
    }
}

static void NAME_predict(NAME_memory *m, const double *torque) { (void)m; (void)torque; }
