/* torques that the joints' rates ask for beside inertia times acceleration, N m */
static void NAME_coriolis(const double *angle, const double *rate, double *torque)
{
    double alpha[UPPER_JOINTS];
    NAME_directions(angle, alpha);
    for (int j = UPPER_JOINTS - 1; j >= 0; j--) {
        double turning = 0.0;
        torque[j] = j + 1 < UPPER_JOINTS ? torque[j + 1] : 0.0;
        for (int k = 0; k < UPPER_JOINTS; k++) {
            const int at = j * UPPER_JOINTS + k;
            turning += rate[k];
            torque[j] += (NAME_along[at] * sin(alpha[j] - alpha[k]) - NAME_across[at] * cos(alpha[j] - alpha[k])) *
                         turning * turning;
        }
    }
}
