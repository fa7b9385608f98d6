#define NAME_PI 3.14159265358979323846

static double NAME_turn(double angle, double now)
{
    return angle - 2.0 * NAME_PI * floor((angle - now) / (2.0 * NAME_PI) + 0.5);
}

GOAL
/* where the tip is, links bent as by forces at their tips; where the target is; the joint angles of straight links there */
static void NAME_aim(NAME_memory *m, const double *v)
{
    double x = 0.0, y = 0.0, angle = 0.0;
    for (int k = 0; k < UPPER_JOINTS; k++) m->angle[k] = m->goal[k] = atan2(v[NAME_sines[k]], v[NAME_cosines[k]]);
    for (int k = 0; k < UPPER_JOINTS; k++) {
        const double bend = v[NAME_bends[k]], along = 1.0 - 0.6 * bend * bend;
        angle += k ? m->angle[k] : 0.0;
        x += NAME_length[k] * (along * cos(angle) - bend * sin(angle));
        y += NAME_length[k] * (along * sin(angle) + bend * cos(angle));
        angle += 1.5 * bend;
    }
    x += v[NAME_errors[0]];
    y += v[NAME_errors[1]];
    angle = m->angle[0];
    NAME_find(cos(angle) * x - sin(angle) * y, sin(angle) * x + cos(angle) * y, m->goal);
}

static void NAME_to_go(NAME_memory *m, const double *v, double *to_go)
{
    for (int k = 0; k < UPPER_JOINTS; k++) {
        m->angle[k] = NAME_turn(atan2(v[NAME_sines[k]], v[NAME_cosines[k]]), m->angle[k]);
        to_go[k] = m->goal[k] - m->angle[k];
    }
}
