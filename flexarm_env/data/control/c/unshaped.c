/* at once to the goal, and to rest there */
static void NAME_shape(NAME_memory *m, const double *to_go) { (void)m; (void)to_go; }

static void NAME_follow(const NAME_memory *m, double *left, double *rates, double *torque)
{
    (void)m;
    for (int i = 0; i < UPPER_JOINTS; i++) left[i] = rates[i] = torque[i] = 0.0;
}
