/* Coulomb friction over the next period: what stops the motors by its end, if it can */
static void NAME_friction(const NAME_memory *m, const double *torque, double sharp, double *taken)
{
    const double *by_torque = NAME_OF(by_torque, UPPER_JOINTS, UPPER_JOINTS);
    double rate[UPPER_JOINTS], change[UPPER_JOINTS];
    NAME_times(NAME_OF(by_state, UPPER_JOINTS, UPPER_STATES), UPPER_JOINTS, UPPER_STATES, m->x, rate);
    NAME_times(by_torque, UPPER_JOINTS, UPPER_JOINTS, torque, change);
    for (int i = 0; i < UPPER_JOINTS; i++) {
        const double stops = sharp * (rate[i] + change[i]) / by_torque[i * UPPER_JOINTS + i], most = NAME_coulomb[i];
        taken[i] = stops < -most ? -most : stops > most ? most : stops;
    }
}
