/* the links' absolute angles, the hub's left out */
static void NAME_directions(const double *angle, double *alpha)
{
    alpha[0] = 0.0;
    for (int k = 1; k < UPPER_JOINTS; k++) alpha[k] = alpha[k - 1] + angle[k] + NAME_turned[k - 1];
}

/* of the arm with rigid links, (joints, joints), kg m^2 */
static void NAME_rigid_inertia(const double *angle, double *inertia)
{
    double alpha[UPPER_JOINTS];
    NAME_directions(angle, alpha);
    for (int j = UPPER_JOINTS - 1; j >= 0; j--)
        for (int k = UPPER_JOINTS - 1; k >= 0; k--) {
            const int at = j * UPPER_JOINTS + k, below = j + 1 < UPPER_JOINTS, right = k + 1 < UPPER_JOINTS;
            const double by = alpha[j] - alpha[k];
            inertia[at] = NAME_along[at] * cos(by) + NAME_across[at] * sin(by);
            if (below) inertia[at] += inertia[at + UPPER_JOINTS];
            if (right) inertia[at] += inertia[at + 1];
            if (below && right) inertia[at] -= inertia[at + UPPER_JOINTS + 1];
        }
    for (int k = 0; k < UPPER_JOINTS; k++) inertia[k * UPPER_JOINTS + k] += NAME_rotor[k];
}
