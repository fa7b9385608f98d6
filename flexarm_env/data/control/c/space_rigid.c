static void NAME_rigid_inertia(const double *angle, double *inertia)
{
    double weight[UPPER_JOINTS];
    NAME_hold(angle, weight, inertia);
}

/* torques that the joints' rates ask for beside inertia times acceleration, N m: what its changes with the angles do */
static void NAME_coriolis(const double *angle, const double *rate, double *torque)
{
    const double step = 1e-5;
    double ends[2][UPPER_JOINTS * UPPER_JOINTS], there[UPPER_JOINTS];
    for (int n = UPPER_JOINTS; n >= 0; n--) {
        for (int end = 0; end < 2; end++) {
            const double by = end ? -step : step;
            for (int j = 0; j < UPPER_JOINTS; j++)
                there[j] = angle[j] + (n == UPPER_JOINTS ? by * rate[j] : n == j ? by : 0.0);
            NAME_rigid_inertia(there, ends[end]);
        }
        for (int j = 0; j < UPPER_JOINTS; j++) {
            if (n == UPPER_JOINTS) torque[j] = 0.0;
            for (int l = 0; l < UPPER_JOINTS; l++) {
                const int at = UPPER_JOINTS * j + l;
                const double grown = (ends[0][at] - ends[1][at]) / (2.0 * step) * rate[l];
                if (n == UPPER_JOINTS) torque[j] += grown;
                else torque[n] -= 0.5 * rate[j] * grown;
            }
        }
    }
}
