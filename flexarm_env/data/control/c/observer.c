/* a table's part for the posture, of so many rows and columns */
#define NAME_OF(table, rows, columns) (NAME_##table + (long)m->posture * (rows) * (columns))

/* take in what is measured: x += gain (y - C x) */
static void NAME_update(NAME_memory *m, const double *gain, double *y)
{
    double seen[UPPER_OUTPUTS], change[UPPER_STATES];
    NAME_times(NAME_OF(C, UPPER_OUTPUTS, UPPER_STATES), UPPER_OUTPUTS, UPPER_STATES, m->x, seen);
    for (int i = 0; i < UPPER_OUTPUTS; i++) y[i] -= seen[i];
    NAME_times(gain, UPPER_STATES, UPPER_OUTPUTS, y, change);
    for (int i = 0; i < UPPER_STATES; i++) m->x[i] += change[i];
}

/* x = A x + B torque */
static void NAME_move(NAME_memory *m, const double *torque)
{
    double next[UPPER_STATES], pushed[UPPER_STATES];
    NAME_times(NAME_OF(A, UPPER_STATES, UPPER_STATES), UPPER_STATES, UPPER_STATES, m->x, next);
    NAME_times(NAME_OF(B, UPPER_STATES, UPPER_JOINTS), UPPER_STATES, UPPER_JOINTS, torque, pushed);
    for (int i = 0; i < UPPER_STATES; i++) m->x[i] = next[i] + pushed[i];
}
