
/* The rows of the Jacobian are those of state, observation and reward; its columns those of state and action. */
enum { MOVING = @MOVING@, COLUMNS = @COLUMNS@ };

void NAME_get_states(const NAME_arm *arm, double x[UPPER_STATES])
{
    static const uint32_t at[UPPER_STATES] = {@PLACES@};
    for (int k = 0; k < UPPER_STATES; k++) x[k] = numbers(arm, 0, @BLOCK@)[at[k]];
}

static void put(NAME_arm *arm, const double *x, const double *action)
{
    enum { SHARING = @SHARING@ };
    static const uint32_t shared[][2] = {@SHARED@}; /* the joints' numbers, there and here */
    double *given = numbers(arm, 1, @D_ACTION@);
    for (int i = 0; i < SHARING; i++) *numbers(arm, 1, shared[i][0]) = *numbers(arm, 0, shared[i][1]);
    memcpy(arm->data[1] + @D_STATE@, x, UPPER_STATES * sizeof(double));
    for (int k = 0; k < UPPER_JOINTS; k++)
        given[k] = isfinite(action[k]) ? fmin(fmax(action[k], -1.0), 1.0) : NAN;
}

static int outcome(NAME_arm *arm)
{
    const int failed = arm->data[1][@D_FAILED@];
    if (failed) memset(arm->data[1], 0, @D_CHANGING@);
    return failed;
}

static int jacobian(NAME_arm *arm, const double *x, const double *action)
{
    put(arm, x, action);
    NAME_jacobian_program(place(arm, 1), 0, 1);
    double *J = numbers(arm, 1, @D_JACOBIAN@);
    for (int i = 0; i <= MOVING + UPPER_OBSERVATION; i++)
        for (int k = 0; k < UPPER_JOINTS; k++)
            if (!(fabs(action[k]) <= 1.0)) J[i * COLUMNS + MOVING + k] = 0.0;
    return outcome(arm);
}

int NAME_jvp(
    NAME_arm *arm, const double x[UPPER_STATES], const double action[UPPER_JOINTS],
    const double dx[UPPER_STATES], const double daction[UPPER_JOINTS],
    double dx_after[UPPER_STATES], double dobservation[UPPER_OBSERVATION], double *dreward)
{
    const int failed = jacobian(arm, x, action);
    const double *J = numbers(arm, 1, @D_JACOBIAN@);
    for (int i = 0; i <= MOVING + UPPER_OBSERVATION; i++, J += COLUMNS) {
        double sum = failed ? NAN : 0.0;
        for (int k = 0; k < COLUMNS; k++) sum += J[k] * (k < MOVING ? dx[k] : daction[k - MOVING]);
        *(i < MOVING ? &dx_after[i] : i < MOVING + UPPER_OBSERVATION ? &dobservation[i - MOVING] : dreward) = sum;
    }
    for (int k = MOVING; k < UPPER_STATES; k++) dx_after[k] = dx[k];
    return failed;
}

int NAME_vjp(
    NAME_arm *arm, const double x[UPPER_STATES], const double action[UPPER_JOINTS],
    const double x_after_bar[UPPER_STATES], const double observation_bar[UPPER_OBSERVATION], double reward_bar,
    double x_bar[UPPER_STATES], double action_bar[UPPER_JOINTS])
{
#if @BACKWARDS@ /* the sweep of cotangents has a program of its own */
    put(arm, x, action);
    memcpy(arm->data[1] + @D_STATE_BAR@, x_after_bar, UPPER_STATES * sizeof(double));
    memcpy(arm->data[1] + @D_OBSERVATION_BAR@, observation_bar, UPPER_OBSERVATION * sizeof(double));
    *numbers(arm, 1, @D_REWARD_BAR@) = reward_bar;
    NAME_adjoint_program(place(arm, 1), 0, 1);
    memcpy(x_bar, arm->data[1] + @D_STATE_BAR@, UPPER_STATES * sizeof(double));
    memcpy(action_bar, arm->data[1] + @D_ACTION_BAR@, UPPER_JOINTS * sizeof(double));
    for (int k = 0; k < UPPER_JOINTS; k++)
        if (!(fabs(action[k]) <= 1.0)) action_bar[k] = 0.0;
    return outcome(arm);
#else
    const int failed = jacobian(arm, x, action);
    for (int k = 0; k < COLUMNS; k++) {
        const double *J = numbers(arm, 1, @D_JACOBIAN@) + k;
        double sum = failed ? NAN : 0.0;
        for (int i = 0; i <= MOVING + UPPER_OBSERVATION; i++, J += COLUMNS)
            sum += *J * (i < MOVING ? x_after_bar[i] : i < MOVING + UPPER_OBSERVATION ? observation_bar[i - MOVING] : reward_bar);
        *(k < MOVING ? &x_bar[k] : &action_bar[k - MOVING]) = sum;
    }
    for (int k = MOVING; k < UPPER_STATES; k++) x_bar[k] = x_after_bar[k];
    return failed;
#endif
}
