/* Of the angles that bring the tip to (x, y) those of least sum of squares: what a force (fx, fy) at the tip makes of
   joints with equal springs. Begun at arcs to either side. */
static double NAME_within(int k, double angle)
{
    return angle < NAME_range[2 * k] ? NAME_range[2 * k] : angle > NAME_range[2 * k + 1] ? NAME_range[2 * k + 1] : angle;
}

/* t: the tip, its derivatives (px by fx, fy, py by fx, fy), the sum of squared angles */
static void NAME_bent(double x, double y, double fx, double fy, double t[7])
{
    double alpha = 0.0, alpha_x = 0.0, alpha_y = 0.0;
    for (int i = 0; i < 7; i++) t[i] = 0.0;
    for (int k = 0; k < UPPER_JOINTS; k++) {
        const double free = (x - t[0]) * fy - (y - t[1]) * fx, angle = NAME_within(k, free);
        if (free == angle) {
            alpha_x += -t[2] * fy + t[4] * fx - (y - t[1]);
            alpha_y += -t[3] * fy + t[5] * fx + (x - t[0]);
        }
        alpha += angle;
        const double along = NAME_length[k] * cos(alpha), across = NAME_length[k] * sin(alpha);
        t[0] += along;
        t[1] += across;
        t[2] -= across * alpha_x;
        t[3] -= across * alpha_y;
        t[4] += along * alpha_x;
        t[5] += along * alpha_y;
        t[6] += angle * angle;
    }
}

/* the force that brings the tip there, from a guess f; the sum of squared angles, infinite where none is found */
static double NAME_force(double x, double y, double f[2])
{
    double t[7], length = 0.0, off;
    for (int k = 0; k < UPPER_JOINTS; k++) length += NAME_length[k];
    NAME_bent(x, y, f[0], f[1], t);
    off = hypot(t[0] - x, t[1] - y);
    for (int i = 0; i < 60; i++) {
        const double determinant = t[2] * t[5] - t[3] * t[4];
        if (off <= 1e-13 * length || determinant == 0.0) break;
        const double step_x = (t[5] * (x - t[0]) - t[3] * (y - t[1])) / determinant;
        const double step_y = (t[2] * (y - t[1]) - t[4] * (x - t[0])) / determinant;
        double share = 1.0, next = off;
        int better = 0;
        for (int j = 0; j < 12 && !better; j++, share *= 0.5) {
            NAME_bent(x, y, f[0] + share * step_x, f[1] + share * step_y, t);
            next = hypot(t[0] - x, t[1] - y);
            better = next < off;
        }
        if (!better) break;
        f[0] += 2.0 * share * step_x;
        f[1] += 2.0 * share * step_y;
        off = next;
    }
    return off <= 1e-10 * length ? t[6] : HUGE_VAL;
}

/* tip of the chain with its elbows all at one angle */
static void NAME_arc(double bend, double p[2])
{
    p[0] = p[1] = 0.0;
    for (int k = 0; k < UPPER_JOINTS; k++) {
        p[0] += NAME_length[k] * cos(k * bend);
        p[1] += NAME_length[k] * sin(k * bend);
    }
}

/* the least such angle with the tip so far from the root, or as near to that as can be */
static double NAME_arc_bend(double distance)
{
    double low = 0.0, high = -1.0, nearest = HUGE_VAL, kept = 0.0, p[2];
    for (int j = 0; j <= 64; j++) {
        const double bend = NAME_PI * j / 64;
        NAME_arc(bend, p);
        const double off = hypot(p[0], p[1]) - distance;
        if (fabs(off) < nearest) {
            nearest = fabs(off);
            kept = bend;
        }
        if (off <= 0.0) {
            high = bend;
            break;
        }
        low = bend;
    }
    if (high <= 0.0) return kept;
    for (int j = 0; j < 60; j++) {
        const double middle = 0.5 * (low + high);
        NAME_arc(middle, p);
        if (hypot(p[0], p[1]) > distance)
            low = middle;
        else
            high = middle;
    }
    return 0.5 * (low + high);
}

static void NAME_set_arc(double bearing, double bend, double *angle)
{
    double p[2];
    NAME_arc(bend, p);
    angle[0] = NAME_turn(bearing - atan2(p[1], p[0]), 0.0);
    for (int k = 1; k < UPPER_JOINTS; k++) angle[k] = NAME_within(k, bend);
}

/* the force whose moments about the joints are nearest to these angles */
static void NAME_guess(double x, double y, const double *angle, double f[2])
{
    double alpha = 0.0, px = 0.0, py = 0.0, xx = 0.0, xy = 0.0, yy = 0.0, gx = 0.0, gy = 0.0;
    for (int k = 0; k < UPPER_JOINTS; k++) {
        const double u = -(y - py), w = x - px;
        xx += u * u;
        xy += u * w;
        yy += w * w;
        gx += u * angle[k];
        gy += w * angle[k];
        alpha += angle[k];
        px += NAME_length[k] * cos(alpha);
        py += NAME_length[k] * sin(alpha);
    }
    const double determinant = xx * yy - xy * xy;
    f[0] = determinant <= 1e-12 * xx * yy ? 0.0 : (yy * gx - xy * gy) / determinant;
    f[1] = determinant <= 1e-12 * xx * yy ? 0.0 : (xx * gy - xy * gx) / determinant;
}

/* from the arc to a side; where that fails, from an arc to an easy point on the same bearing, step by step */
static double NAME_from_arc(double x, double y, int side, double *angle, double f[2])
{
    const double bearing = atan2(y, x), last = NAME_arc_bend(hypot(x, y));
    double length = 0.0, total = HUGE_VAL, p[2];
    for (int k = 0; k < UPPER_JOINTS; k++) length += NAME_length[k];
    for (int steps = 1; steps <= 24 && total == HUGE_VAL; steps += 23) {
        const double first = steps == 1 ? last : NAME_arc_bend(0.6 * length);
        NAME_set_arc(bearing, side * first, angle);
        NAME_arc(first, p);
        NAME_guess(hypot(p[0], p[1]) * cos(bearing), hypot(p[0], p[1]) * sin(bearing), angle, f);
        for (int step = 1; step <= steps; step++) {
            NAME_arc(first + (last - first) * step / steps, p);
            const double way = step < steps ? hypot(p[0], p[1]) : hypot(x, y);
            total = NAME_force(way * cos(bearing), way * sin(bearing), f);
        }
    }
    return total;
}

static void NAME_find(double x, double y, double *angle)
{
    const double now = angle[0], bearing = atan2(y, x);
    double least = HUGE_VAL, best[2] = {0.0, 0.0}, f[2], alpha = 0.0, px = 0.0, py = 0.0;
    for (int side = 1; side >= -1; side -= 2) {
        const double total = NAME_from_arc(x, y, side, angle, f);
        if (total < least) {
            least = total;
            best[0] = f[0];
            best[1] = f[1];
        }
    }
    if (least < HUGE_VAL) {
        for (int k = 0; k < UPPER_JOINTS; k++) {
            angle[k] = NAME_within(k, (x - px) * best[1] - (y - py) * best[0]);
            alpha += angle[k];
            px += NAME_length[k] * cos(alpha);
            py += NAME_length[k] * sin(alpha);
        }
    } else
        NAME_set_arc(bearing, (bearing < 0.0 ? -1.0 : 1.0) * NAME_arc_bend(hypot(x, y)), angle);
    const double hub = NAME_turn(angle[0], now);
    if (NAME_range[0] <= hub && hub <= NAME_range[1]) angle[0] = hub;
}
