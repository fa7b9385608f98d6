void NAME_decide(const float observation[UPPER_OBSERVATION], float action[UPPER_ACTIONS])
{
    float x[UPPER_WIDTH], x_rest[UPPER_WIDTH], y[UPPER_WIDTH], y_rest[UPPER_WIDTH];
    int i;
    for (i = 0; i < UPPER_ACTIONS; i++) action[i] = 0.0f;
    for (i = 0; i < UPPER_OBSERVATION; i++)
        if (observation[i] != observation[i]) return; /* NaN: no torque */
STEPS
}
