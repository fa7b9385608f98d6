/*
@HEAD@
 *
 * An arm is made once (NAME_create: the only allocation), reset, and stepped by control periods. All functions are of
 * their arm alone: two arms may move in two threads, one arm in one at a time. Compile without -ffast-math.
 */
#ifndef UPPER_H
#define UPPER_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define UPPER_JOINTS @JOINTS@
#define UPPER_TARGET @GIVEN@ /* numbers that say a target */
#define UPPER_OBSERVATION @OBSERVATION@ /* numbers in an observation */
#define UPPER_PARAMETERS @PARAMETERS@
#define UPPER_PERIOD @PERIOD@ /* s, of control */
#define UPPER_STATE_BYTES @STATE@ /* of NAME_get_state */

/* Statuses: what NAME_reset, NAME_step and their likes return. */
@STATUSES@
#define UPPER_OVER (-1) /* the episode has ended, or none has begun: reset first; nothing has moved */
#define UPPER_REFUSED (-2) /* a number that is not allowed, NULL for what is needed; nothing has moved */

/* A sentence for each of them. */
const char *NAME_status(int status);

typedef struct NAME_arm NAME_arm;

/* What is told of the arm after a reset or a step. */
typedef struct {
@INFO@
} NAME_info;

/* Where a link is, and how it moves@FROM@. */
typedef struct {
@POSE@
} NAME_pose;

/* An arm, not yet started; NULL: no memory. */
NAME_arm *NAME_create(void);
void NAME_destroy(NAME_arm *arm);

/*
 * Start an episode. key: 64 random bits that all draws and noise follow from (in Python, of reset(seed=s):
 * numpy.random.Generator(numpy.random.PCG64(numpy.random.SeedSequence(s))).bit_generator.random_raw()).
 * angles (UPPER_JOINTS, rad), target (UPPER_TARGET numbers: @TARGET@), vibration (tip deflection over the arm's length,
 * in space of each mode): NULL or NAN: drawn. At most @FARTHEST@, @FAR_TARGET@ and @FAR_VIBRATION@ in size.
 */
int NAME_reset(NAME_arm *arm, uint64_t key, const double *angles, const double *target, double vibration);

/* One control period under an action, within +-1 (clipped): @ACTION@ */
int NAME_step(NAME_arm *arm, const double action[UPPER_JOINTS]);
@TORQUES@
const NAME_info *NAME_get_info(const NAME_arm *arm);
const NAME_pose *NAME_get_poses(const NAME_arm *arm); /* UPPER_JOINTS of them, from hub to tip */

/*
 * The environment's observation. Entries are value / scale, clipped at @CLIP@:
@ENTRIES@
 */
const float *NAME_get_observation(const NAME_arm *arm);
double NAME_get_reward(const NAME_arm *arm);
double NAME_get_time(const NAME_arm *arm); /* s since the reset */

/* All that the future depends on, as UPPER_STATE_BYTES bytes; of the same build of the same library alone. */
void NAME_get_state(const NAME_arm *arm, void *state);
int NAME_set_state(NAME_arm *arm, const void *state);

/*
 * Numbers of the arm that may be set between periods; a reset draws them, or puts them back. Those of joints are there
 * where the arm has them:
@TOLD@
 */
void NAME_get_parameters(const NAME_arm *arm, double parameters[UPPER_PARAMETERS]);
int NAME_set_parameters(NAME_arm *arm, const double parameters[UPPER_PARAMETERS]);
@DERIVATIVES@
#ifdef __cplusplus
}
#endif
#endif
