void NAME_decide(const float observation[UPPER_OBSERVATION], float action[UPPER_ACTIONS])
{
    float x[UPPER_WIDTH], x_rest[UPPER_WIDTH], y[UPPER_WIDTH], y_rest[UPPER_WIDTH];
    int i;
STEPS
}
