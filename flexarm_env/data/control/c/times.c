/* y = m x, (rows, columns) times (columns) */
static void NAME_times(const double *m, int rows, int columns, const double *x, double *y)
{
    for (int i = 0; i < rows; i++) {
        y[i] = 0.0;
        for (int j = 0; j < columns; j++) y[i] += m[i * columns + j] * x[j];
    }
}
