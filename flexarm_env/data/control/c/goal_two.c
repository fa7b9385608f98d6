/* of both solutions for two links the one that the joints come to sooner */
static void NAME_find(double x, double y, double *angle)
{
    const double a = NAME_length[0], b = NAME_length[1], cosine = (x * x + y * y - a * a - b * b) / (2.0 * a * b);
    const double bend = acos(cosine < -1.0 ? -1.0 : cosine > 1.0 ? 1.0 : cosine);
    const double inner = atan2(b * sin(bend), a + b * cos(bend)), was[2] = {angle[0], angle[1]};
    double inertia[4], least = HUGE_VAL;
    NAME_rigid_inertia(was, inertia);
    for (int side = 1; side >= -1; side -= 2) {
        const double elbow = side * bend, hub = NAME_turn(atan2(y, x) - side * inner, was[0]);
        const double first = fabs(hub - was[0]) * inertia[0] / NAME_limit[0];
        const double second = fabs(elbow - was[1]) * inertia[3] / NAME_limit[1];
        double way = first > second ? first : second;
        if (elbow < NAME_range[2] || elbow > NAME_range[3]) way += 1e6;
        if (way < least) {
            least = way;
            angle[0] = hub;
            angle[1] = elbow;
        }
    }
}
