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

    A chain of N links in space, flexible or rigid, stands on a fixed base under gravity, with a motor at each joint.
    The goal is to move the tip to a target point and hold it there without residual vibration. Links are geometrically
    exact beams that bend in both planes, twist, stretch and shear (docs/theory.md, section 9), or floating frames.

    The default arm, `three_dof` (after shamilmamedov/flexible_arm), has a rigid pillar of 0.15 m that yaws about the
    vertical z axis, and two steel strips of 0.5 m, 50 mm wide and 2 mm thick, that pitch at shoulder and elbow. At
    joint angles 0 the arm is upright. `three_dof` has no payload; `three_dof_loaded` carries 0.1 kg. L, the sum of the
    lengths, is 1.15 m.

    `gymnasium.make("SpatialFlexArm-v0")` makes one arm, `gymnasium.make_vec("SpatialFlexArm-v0", num_envs=n)` makes n
    arms that one compiled call advances. A single arm and an arm among n arms give the same numbers, bit for bit.
    Without an import of the package use the id `flexarm_env:SpatialFlexArm-v0`.

    ## Action space

    `Box(-1, 1, (N,), float32)`: joint torques as shares of their limits (20, 10 and 10 N m). The torques are constant
    over one control period. Actions beyond +-1 are clipped. NaN or infinity ends the episode (`action_not_finite`).

    ## Observation space

    `Box` of 3 N + 6 F + 6 float32 in +-10 (sines and cosines in +-1), where F is the number of flexible links. The
    default arm has 27 entries. Each entry is divided by its scale and clipped to the bounds.

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

    - w_k = sqrt(tau_k pi/2 / I_k). tau_k is the torque limit of joint k. I_k is the inertia about joint k of the arm
      from this joint to the tip, laid out straight at a right angle to the joint's axis. For the default arm w_0 =
      8.518, w_1 = 7.738 and w_2 = 21.887 rad/s.
    - The last six entries are components along the axes of the root of link 0, which turn with the first joint.
    - The deflections of a link are the components of (tip - root) along the y and z axes of the link's root. The twist
      of a link is the x component of the rotation vector from the axes of the link's root to the axes of the link's
      tip.

    [Entries in space](options.md#entries-in-space) has the names of all entries, the sensors, and the entries of
    `task="track"`.

    ## Rewards

    The reward has the terms, weights and bounds of TwoLinkFlexArm-v0. e is the distance of the tip from the target
    divided by L, v the tip's speed divided by L (1/s; with "track" relative to the target), and d' are the rates of the
    deflections in both planes. Effort is -sum of a_k^2 over all N joints (weighted: -0.01 N to 0), and vibration is
    -min(sum of d'^2, 1) over all links, with weight 0.

    ## Starting state

    The arm is at rest with straight, stress-free links. In half of the episodes all joint angles are 0; in the other
    half the first joint is at -1 to 1 rad and each further joint at -3.6/N to 3.6/N rad. The target is the tip of the
    rigid arm with the first joint at -2 pi/3 to 2 pi/3 rad and each further joint at -3.6/N to 3.6/N rad. All draws are
    uniform and within the joint limits. Target angles at which the motors cannot hold the arm are drawn again.

    ## Episode end

    - Truncation: an episode is truncated after `duration` (5 s, in whole control periods) or `max_episode_steps`,
      whichever is first, or at the end of a prescribed motion.
    - Termination: an episode is terminated only by a failure, with `info["termination_reason"]` as in FlexibleArm-v0.
    - Success does not end an episode. `info["is_success"]` is true if, over the last 0.5 s, the tip was within 0.01 L
      of the target and slower than 0.05 L/s (with "track": relative to the target).

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

    [Options in space](options.md#options-in-space) describes the differences in space. Features that are not available
    in space raise an error that names the feature: [list](spatial_limits.md).

    ## Version history

    * v0: first version. Since 0.2.0 rewards and drawn targets follow [rules 2](options.md#rules); `rules=1` selects the
      former rules.
    """

    kind = SPACE


class SpatialFlexArmVectorEnv(VectorArmEnv, VectorEnv[Array32, Array32, NDArray[Any]]):
    """Vector environment of many SpatialFlexArm-v0; see :class:`SpatialFlexArmEnv`."""

    kind = SPACE
