/*
 * arm: a flexible-link robot arm, SpatialFlexArm-v0 {"elements": 1, "dt": 0.005}
 * written by flexarm_env 0.2.0: geometrically_exact, dt = 0.005 s; for x86-64-v2
 * Derivatives of a period are not in it: there are none in space.
 *
 * An arm is made once (arm_create: the only allocation), reset, and stepped by control periods. All functions are of
 * their arm alone: two arms may move in two threads, one arm in one at a time. Compile without -ffast-math.
 */
#ifndef ARM_H
#define ARM_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define ARM_JOINTS 3
#define ARM_TARGET 3 /* numbers that say a target */
#define ARM_OBSERVATION 27 /* numbers in an observation */
#define ARM_PARAMETERS 4
#define ARM_PERIOD 0.01 /* s, of control */
#define ARM_STATE_BYTES 11200 /* of arm_get_state */

/* Statuses: what arm_reset, arm_step and their likes return. */
#define ARM_OK 0
#define ARM_NEWTON_FAILED 1
#define ARM_DIVERGED 2
#define ARM_OUT_OF_RANGE 3
#define ARM_NOT_FINITE 4
#define ARM_TIMED_OUT 5
#define ARM_ACTION_NOT_FINITE 100
#define ARM_JOINT_LIMIT 101
#define ARM_OVER (-1) /* the episode has ended, or none has begun: reset first; nothing has moved */
#define ARM_REFUSED (-2) /* a number that is not allowed; nothing has moved */

/* A sentence for each of them. */
const char *arm_status(int status);

typedef struct arm_arm arm_arm;

/* What is told of the arm after a reset or a step. */
typedef struct {
    double success; /* 1 or 0 */
    double tip[3]; /* m, where the tip is; three numbers where a target has so many, in space */
    double deflection[2][3]; /* of each tip, over its length; in space along y, then z */
    double twist[3]; /* rad, in space: of each link */
    double target[3]; /* m or rad */
    double torque[3]; /* N m, of each joint, as applied */
    double terms[6]; /* of the reward, weighted; the last: of failure */
    double in_range; /* 1 where the formulation holds, or 0 */
    double error; /* estimate of the formulation's own error, over L */
    double reason; /* why the episode has ended; 0: it has not */
    struct {
    double kinetic; /* J */
    double strain; /* J */
    double gravity; /* J */
    double dissipated; /* J, by damping and friction */
    double work; /* J, of the motors */
    } energies;
    double reward; /* sum of the terms */
    double truncated; /* 1 or 0 */
    double motors[2][3]; /* rad, rad/s, their angles and rates, after the ratio, where energies are kept */
} arm_info;

/* Where a link is, and how it moves. */
typedef struct {
    double angle; /* rad, of the joint at the link's root */
    double rate; /* rad/s, its rate */
    double deflection[2]; /* m, of the tip along y and z of the root */
    double deflection_rate[2]; /* m/s */
    double twist; /* rad, of the tip against the root: x part of the rotation vector between them */
    double twist_rate; /* rad/s */
    double tip[3]; /* m, place */
    double velocity[3]; /* m/s, of the tip */
    double axes[3][3]; /* of the root */
} arm_pose;

/* An arm, not yet started; NULL: no memory. */
arm_arm *arm_create(void);
void arm_destroy(arm_arm *arm);

/*
 * Start an episode. key: 64 random bits that all draws and noise follow from (in Python, of reset(seed=s):
 * numpy.random.Generator(numpy.random.PCG64(numpy.random.SeedSequence(s))).bit_generator.random_raw()).
 * angles (ARM_JOINTS, rad), target (ARM_TARGET numbers: joint angles that bring the rigid arm's tip there, rad), vibration (tip deflection over the arm's length): NULL or NAN: drawn.
 */
int arm_reset(arm_arm *arm, uint64_t key, const double *angles, const double *target, double vibration);

/* One control period under an action, within +-1 (clipped): torques over 20, 10, 10 N m. */
int arm_step(arm_arm *arm, const double action[ARM_JOINTS]);

/* The same by the torques asked for, N m. */
int arm_step_torques(arm_arm *arm, const double torque[ARM_JOINTS]);

const arm_info *arm_get_info(const arm_arm *arm);
const arm_pose *arm_get_poses(const arm_arm *arm); /* ARM_JOINTS of them, from hub to tip */

/*
 * The environment's observation. Entries are value / scale, clipped at 10:
 *   0: hub_sin / 1
 *   1: hub_cos / 1
 *   2: elbow_1_sin / 1
 *   3: elbow_1_cos / 1
 *   4: elbow_2_sin / 1
 *   5: elbow_2_cos / 1
 *   6: hub_rate / 8.5179572
 *   7: elbow_1_rate / 7.73807585
 *   8: elbow_2_rate / 21.8865508
 *   9: tip_deflection_y_2 / 0.1
 *   10: tip_deflection_z_2 / 0.1
 *   11: tip_deflection_rate_y_2 / 2.55538716
 *   12: tip_deflection_rate_z_2 / 2.55538716
 *   13: twist_2 / 0.1
 *   14: twist_rate_2 / 2.55538716
 *   15: tip_deflection_y_3 / 0.1
 *   16: tip_deflection_z_3 / 0.1
 *   17: tip_deflection_rate_y_3 / 2.55538716
 *   18: tip_deflection_rate_z_3 / 2.55538716
 *   19: twist_3 / 0.1
 *   20: twist_rate_3 / 2.55538716
 *   21: tip_velocity_x / 9.79565078
 *   22: tip_velocity_y / 9.79565078
 *   23: tip_velocity_z / 9.79565078
 *   24: to_target_x / 0.575
 *   25: to_target_y / 0.575
 *   26: to_target_z / 0.575
 */
const float *arm_get_observation(const arm_arm *arm);
double arm_get_reward(const arm_arm *arm);
double arm_get_time(const arm_arm *arm); /* s since the reset */

/* All that the future depends on, as ARM_STATE_BYTES bytes; of the same build of the same library alone. */
void arm_get_state(const arm_arm *arm, void *state);
int arm_set_state(arm_arm *arm, const void *state);

/*
 * Numbers of the arm that may be set between periods; a reset draws them, or puts them back. Those of joints are there
 * where the arm has them:
 *   0: payload_mass, kg; of the arm
 *   1: EI_factor; on all stiffness to bending
 *   2: tau_d, s; of the damping
 *   3: torque_factor; on the motors' torques
 */
void arm_get_parameters(const arm_arm *arm, double parameters[ARM_PARAMETERS]);
int arm_set_parameters(arm_arm *arm, const double parameters[ARM_PARAMETERS]);

#ifdef __cplusplus
}
#endif
#endif
