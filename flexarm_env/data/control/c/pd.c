static void NAME_begin(NAME_memory *m, const double *v, const double *to_go) { (void)m; (void)v; (void)to_go; }

static void NAME_torques(NAME_memory *m, const double *v, const double *to_go, double *torque)
{
    (void)m;
    for (int i = 0; i < UPPER_JOINTS; i++) torque[i] = NAME_kp[i] * to_go[i] - NAME_kd[i] * v[NAME_rates[i]];
}

static void NAME_predict(NAME_memory *m, const double *torque) { (void)m; (void)torque; }
