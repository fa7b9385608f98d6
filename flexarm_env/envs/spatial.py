"""SpatialFlexArm-v0: an arm with yaw, shoulder and elbow brings its tip to a point in space and settles there."""

from typing import Any

import gymnasium as gym
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from ..validation import Array32
from .single import SingleArmEnv
from .space import SPACE
from .vector import VectorArmEnv


class SpatialFlexArmEnv(SingleArmEnv, gym.Env[Array32, Array32]):  # bases: see `single`
    """
    ## Description

    A chain of N flexible or rigid links in space is mounted on a fixed base under gravity, with a motor at each joint.
    The goal is to move the tip to a target point and hold it there without residual vibration. Flexible links are
    geometrically exact beams, which bend in both planes, twist, stretch and shear (docs/theory.md, section 9); the
    formulation "floating_frame" is available, too.

    The default arm, `three_dof` (after shamilmamedov/flexible_arm), has three links. The first link is a rigid column
    of 0.15 m, which turns about the vertical z axis (yaw). The second and the third link are steel strips of 0.5 m
    length, 50 mm width and 2 mm thickness, which turn about horizontal axes at shoulder and elbow (pitch). At joint
    angles 0 the arm is upright. `three_dof` has no payload; the arm `three_dof_loaded` carries 0.1 kg. L, the sum of
    the lengths, is 1.15 m.

    `gymnasium.make("SpatialFlexArm-v0")` creates one arm. `gymnasium.make_vec("SpatialFlexArm-v0", num_envs=n)` creates
    n arms that one compiled call advances. Each arm gives bitwise the same results as the single environment. The id
    `flexarm_env:SpatialFlexArm-v0` also works if the package has not been imported.

    ## Action space

    `Box(-1, 1, (N,), float32)`: joint torques divided by their limits (20, 10 and 10 N m for the default arm). The
    torques are constant over one control period. Actions beyond +-1 are clipped. An action with NaN or infinity ends
    the episode (`action_not_finite`).

    ## Observation space

    `Box` of 3 N + 6 F + 6 float32 entries in +-10 (sines and cosines in +-1), where F is the number of flexible links.
    The default arm has 27 entries. Each entry is divided by its scale and clipped to the bounds.

    | # | entry | scale | unit |
    |---|---|---|---|
    | 0 to 2 N - 1 | sine and cosine of each joint angle, the hub first | 1 | - |
    | 2 N to 3 N - 1 | rates of the joint angles | w_k | rad/s |
    | then for each flexible link | tip deflection along y and z of its root | 0.1 | link length |
    | | rates of both tip deflections | 0.3 w_0 | link length/s |
    | | twist | 0.1 | rad |
    | | rate of the twist | 0.3 w_0 | rad/s |
    | the last six | tip velocity, x, y, z | w_0 L | m/s |
    | | vector from tip to target, x, y, z | 0.5 L | m |

    - w_k = sqrt(tau_k pi/2 / I_k). tau_k is the torque limit of joint k. I_k is the inertia about joint k of all links
      from joint k to the tip, for straight links at a right angle to the joint's axis. For the default arm w_0 = 8.518,
      w_1 = 7.738 and w_2 = 21.887 rad/s.
    - The last six entries are components along the axes of the root of link 0, which turn with the first joint.
    - The deflections of a link are the components of (tip - root) along the y and z axes of the link's root. The twist
      of a link is the x component of the rotation vector from the axes of the link's root to the axes of the link's
      tip.

    [Entries in space](options.md#entries-in-space) has the names of all entries, the sensors, and the entries of
    `task="track"`.

    ## Rewards

    The reward has the terms, weights and bounds of TwoLinkFlexArm-v0. The error e is the distance of the tip from the
    target divided by L, and v is the tip's speed divided by L (1/s). With task="track" v is the speed relative to the
    target. The term effort is -sum of a_k^2 over all N joints (weighted: -0.01 N to 0). The term vibration is -min(sum
    of d'^2, 1) with weight 0; the sum extends over the deflection rates d' of all links in both planes.

    ## Starting state

    The arm is at rest with straight, stress-free links. In half of the episodes all joint angles are 0. In all other
    episodes the joint angles are random: the first between -1 and 1 rad, all others between -3.6/N and 3.6/N rad. The
    target is the position of the rigid arm's tip at a second set of random joint angles: the first between -2 pi/3 and
    2 pi/3 rad, all others between -3.6/N and 3.6/N rad. All distributions are uniform, within the joint limits. A
    target is drawn again if the motors cannot hold the arm there.

    ## Episode end

    - Truncation: an episode is truncated after `duration` (5 s, rounded down to whole control periods) or
      `max_episode_steps`, whichever is earlier, or at the end of a prescribed motion.
    - Termination: an episode is terminated only by a failure, with `info["termination_reason"]` as in FlexibleArm-v0.
    - Success does not end an episode. `info["is_success"]` is true if, during the last 0.5 s, the tip was within 0.01 L
      of the target and its speed (with task="track" relative to the target) was below 0.05 L/s.

    ## Info

    `info` has the keys of TwoLinkFlexArm-v0, with `tip_position` (3,) and `target` (3,) m, `joint_torque` (N,) N m,
    `tip_deflection` (2 N,) divided by link length (all links along y, then along z), and `twist` (N,) rad. Deflections
    and twists of rigid links are 0.

    ## Arguments

    The environment has the arguments of FlexibleArm-v0 (:class:`flexarm_env.envs.flexible_arm.FlexibleArmEnv`). These
    defaults differ:

    | name | default | meaning |
    |---|---|---|
    | `arm` | "three_dof" | an arm that leaves the plane, with torque limits and straight links |
    | `control_dt` | 0.01 | control period, s |
    | `duration` | 5.0 | length of an episode, s |
    | `gravity` | (0, 0, -9.81) | (x, y, z), m/s^2 |
    | `formulation` | "geometrically_exact" | or "floating_frame", with `segments` or `modes` (at least 2) |
    | `task` | "reach" | or "track": moving target; "replay": prescribed motion; "press": see options |

    [Options in space](options.md#options-in-space) describes how arguments differ in space. [Limits in
    space](spatial_limits.md) lists the features that are not available in space and raise an error.

    ## Version history

    * v0: first version. Since 0.2.0 rewards and random targets follow [rules 2](options.md#rules); `rules=1` selects
      the former rules.
    """

    kind = SPACE


class SpatialFlexArmVectorEnv(VectorArmEnv, VectorEnv[Array32, Array32, NDArray[Any]]):
    """Vector environment with the arms and tasks of SpatialFlexArm-v0; see :class:`SpatialFlexArmEnv`."""

    kind = SPACE
