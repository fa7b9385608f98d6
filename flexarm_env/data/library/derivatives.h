
/*
 * A period and its derivative as functions of numbers; no draws, no noise. The state's UPPER_STATES numbers:
@STATES@
 */
#define UPPER_STATES @S@
void NAME_get_states(const NAME_arm *arm, double x[UPPER_STATES]);

/* Tangents of state and action to those of state, observation and reward a period later. */
int NAME_jvp(
    NAME_arm *arm, const double x[UPPER_STATES], const double action[UPPER_JOINTS],
    const double dx[UPPER_STATES], const double daction[UPPER_JOINTS],
    double dx_after[UPPER_STATES], double dobservation[UPPER_OBSERVATION], double *dreward);

/* Cotangents of state, observation and reward after the period to those of state and action before it. */
int NAME_vjp(
    NAME_arm *arm, const double x[UPPER_STATES], const double action[UPPER_JOINTS],
    const double x_after_bar[UPPER_STATES], const double observation_bar[UPPER_OBSERVATION], double reward_bar,
    double x_bar[UPPER_STATES], double action_bar[UPPER_JOINTS]);
