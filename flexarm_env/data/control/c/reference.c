/* a move to the goal, as quick as the rigid arm can follow it with its share of the torques */
static void NAME_shape(NAME_memory *m, const double *to_go)
{
    double inertia[UPPER_JOINTS * UPPER_JOINTS], load[UPPER_JOINTS];
    m->period = 2.0 * UPPER_PERIOD;
    NAME_rigid_inertia(m->goal, inertia);
    NAME_times(inertia, UPPER_JOINTS, UPPER_JOINTS, to_go, load);
    for (int i = 0; i < UPPER_JOINTS; i++) {
        const double quickest = 2.0 * sqrt(fabs(load[i]) / NAME_effort[i]);
        if (quickest > m->period) m->period = quickest;
        m->move[i] = to_go[i];
    }
}

/* share of the move that is done at t, and its rate */
static void NAME_reference(const NAME_memory *m, double t, double *done, double *rate)
{
    *done = *rate = 0.0;
    for (int i = m->posture * UPPER_IMPULSES; i < (m->posture + 1) * UPPER_IMPULSES; i++) {
        const double y = (t - NAME_delay[i]) / m->period, x = y < 0.0 ? 0.0 : y > 1.0 ? 1.0 : y, left = 1.0 - x;
        *done += NAME_amplitude[i] * (x < 0.5 ? 2.0 * x * x : 1.0 - 2.0 * left * left);
        *rate += NAME_amplitude[i] * (x < 0.5 ? 4.0 * x : 4.0 * left) / m->period;
    }
}

/* of this period: what is left to go, its rates, and the torques that the rigid arm needs for it */
static void NAME_follow(const NAME_memory *m, double *left, double *rates, double *torque)
{
    double done, rate, later, unused, inertia[UPPER_JOINTS * UPPER_JOINTS], asked[UPPER_JOINTS];
    double accelerations[UPPER_JOINTS], angles[UPPER_JOINTS];
    NAME_reference(m, m->step * UPPER_PERIOD, &done, &rate);
    NAME_reference(m, (m->step + 1) * UPPER_PERIOD, &unused, &later);
    for (int i = 0; i < UPPER_JOINTS; i++) {
        left[i] = m->move[i] * (1.0 - done);
        angles[i] = m->goal[i] - left[i];
        rates[i] = m->move[i] * rate;
        accelerations[i] = m->move[i] * ((later - rate) / UPPER_PERIOD);
    }
    NAME_rigid_inertia(angles, inertia);
    NAME_times(inertia, UPPER_JOINTS, UPPER_JOINTS, accelerations, torque);
    NAME_coriolis(angles, rates, asked);
    for (int i = 0; i < UPPER_JOINTS; i++) torque[i] += asked[i];
}
