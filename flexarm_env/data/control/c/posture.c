/* the posture that is nearest, of those that gains are held for; its mirror image has the same */
static int NAME_nearest(const double *angle)
{
    double key[UPPER_JOINTS], side = 0.0, least = HUGE_VAL;
    int found = 0;
    for (int k = 1; k < UPPER_JOINTS; k++) {
        key[k] = rint(angle[k] / UPPER_GRID);
        if (side == 0.0 && key[k] != 0.0) side = key[k] < 0.0 ? -1.0 : 1.0;
        key[k] *= side;
    }
    for (int i = 0; i < UPPER_POSTURES; i++) {
        double off = 0.0;
        for (int k = 1; k < UPPER_JOINTS; k++) {
            const double by = key[k] - NAME_posture[i * (UPPER_JOINTS - 1) + k - 1];
            off += by * by;
        }
        if (off < least) {
            least = off;
            found = i;
        }
    }
    return found;
}
