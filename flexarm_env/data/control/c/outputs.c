static void NAME_outputs(const double *v, const double *to_go, double *y)
{
    for (int i = 0; i < UPPER_JOINTS; i++) {
        y[i] = -to_go[i];
        y[UPPER_JOINTS + i] = v[NAME_rates[i]];
        y[2 * UPPER_JOINTS + i] = v[NAME_bends[i]];
        y[3 * UPPER_JOINTS + i] = v[NAME_bend_rates[i]];
    }
}

static void NAME_predict(NAME_memory *m, const double *torque) { NAME_move(m, torque); }
