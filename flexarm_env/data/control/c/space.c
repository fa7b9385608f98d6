typedef struct {
    double place[UPPER_JOINTS][3], axis[UPPER_JOINTS][3], link[UPPER_JOINTS][9], tip[3];
} NAME_pose;

static void NAME_product(const double *a, const double *b, double *out)
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            out[3 * i + j] = 0.0;
            for (int k = 0; k < 3; k++) out[3 * i + j] += a[3 * i + k] * b[3 * k + j];
        }
}

static void NAME_cross(const double *a, const double *b, double *out)
{
    for (int i = 0; i < 3; i++) out[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
}

/* the rigid arm at joint angles: its joints, their axes, the links' axes in columns, the tip */
static void NAME_stand(const double *angle, NAME_pose *p)
{
    double A[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0}, B[9], R[9];
    for (int i = 0; i < 3; i++) p->tip[i] = 0.0;
    for (int k = 0; k < UPPER_JOINTS; k++) {
        const double *e = NAME_hinge + 3 * k, s = sin(angle[k]), c = cos(angle[k]);
        for (int i = 0; i < 9; i++) R[i] = (1.0 - c) * e[i / 3] * e[i % 3] + (i % 4 ? 0.0 : c);
        for (int i = 0; i < 3; i++) {
            R[3 * ((i + 2) % 3) + (i + 1) % 3] += s * e[i];
            R[3 * ((i + 1) % 3) + (i + 2) % 3] -= s * e[i];
        }
        NAME_product(A, NAME_mount + 9 * k, B);
        NAME_product(B, R, A);
        for (int i = 0; i < 9; i++) p->link[k][i] = A[i];
        for (int i = 0; i < 3; i++) {
            p->place[k][i] = p->tip[i];
            p->axis[k][i] = A[3 * i] * e[0] + A[3 * i + 1] * e[1] + A[3 * i + 2] * e[2];
        }
        for (int i = 0; i < 3; i++) p->tip[i] += NAME_length[k] * A[3 * i];
    }
}

/* torques that hold the rigid arm, and its inertia about the joints, (joints, joints), kg m^2 */
static void NAME_hold(const double *angle, double *torque, double *inertia)
{
    NAME_pose p;
    NAME_stand(angle, &p);
    for (int j = 0; j < UPPER_JOINTS; j++) {
        torque[j] = 0.0;
        for (int l = 0; l < UPPER_JOINTS; l++) inertia[UPPER_JOINTS * j + l] = j == l ? NAME_rotor[j] : 0.0;
    }
    for (int b = 0; b < UPPER_BODIES; b++) {
        const int k = (int)NAME_carrier[b];
        const double *A = p.link[k], *at = NAME_centre_of + 3 * b, *I = NAME_tensor + 9 * b, mass = NAME_mass[b];
        double r[3], swing[UPPER_JOINTS][3], own[UPPER_JOINTS][3];
        for (int j = 0; j <= k; j++) {
            for (int i = 0; i < 3; i++) {
                r[i] = p.place[k][i] - p.place[j][i] + A[3 * i] * at[0] + A[3 * i + 1] * at[1] + A[3 * i + 2] * at[2];
                own[j][i] = A[i] * p.axis[j][0] + A[3 + i] * p.axis[j][1] + A[6 + i] * p.axis[j][2];
            }
            NAME_cross(p.axis[j], r, swing[j]);
            for (int i = 0; i < 3; i++) torque[j] -= mass * swing[j][i] * NAME_gravity[i];
        }
        for (int jl = 0; jl < (k + 1) * (k + 1); jl++) {
            const int j = jl / (k + 1), l = jl % (k + 1);
            double *M = inertia + UPPER_JOINTS * j + l;
            for (int i = 0; i < 3; i++) {
                *M += mass * swing[j][i] * swing[l][i];
                for (int n = 0; n < 3; n++) *M += own[j][i] * I[3 * i + n] * own[l][n];
            }
        }
    }
}

static double NAME_turn(double angle, double now)
{
    const double whole = 2.0 * 3.14159265358979323846;
    return angle - whole * floor((angle - now) / whole + 0.5);
}

/* of the targets that are held the one nearest to where this one is: joint angles and torques of the rest there */
static void NAME_aim(NAME_memory *m, const double *v)
{
    NAME_pose p;
    double least = 1e300, target[3];
    int nearest = 0;
    for (int k = 0; k < UPPER_JOINTS; k++) m->angle[k] = atan2(v[NAME_sines[k]], v[NAME_cosines[k]]);
    NAME_stand(m->angle, &p);
    TOLD
    for (int t = 0; t < UPPER_TARGETS; t++) {
        double off = 0.0;
        for (int i = 0; i < 3; i++) off += (NAME_target[3 * t + i] - target[i]) * (NAME_target[3 * t + i] - target[i]);
        if (off < least) least = off, nearest = t;
    }
    m->posture = nearest;
    for (int k = 0; k < UPPER_JOINTS; k++) {
        m->goal[k] = NAME_rest[UPPER_JOINTS * nearest + k];
        m->torque[k] = NAME_rest_torque[UPPER_JOINTS * nearest + k];
    }
}

static void NAME_to_go(NAME_memory *m, const double *v, double *to_go)
{
    for (int k = 0; k < UPPER_JOINTS; k++) {
        m->angle[k] = NAME_turn(atan2(v[NAME_sines[k]], v[NAME_cosines[k]]), m->angle[k]);
        to_go[k] = m->goal[k] - m->angle[k];
    }
}
