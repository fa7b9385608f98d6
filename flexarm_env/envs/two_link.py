"""TwoLinkFlexArm-v0: two flexible links bring their tip to a point and settle there."""

from typing import Any

import gymnasium as gym
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from ..validation import Array32
from .single import SingleArmEnv
from .task import REACH
from .vector import VectorArmEnv


class TwoLinkFlexArmEnv(SingleArmEnv, gym.Env[Array32, Array32]):  # bases: see `single`
    """
    ## Description

    Two flexible links move in the horizontal plane, with motors at hub and elbow. The goal is to move the tip, which
    carries a payload, to a target point and hold it there without residual vibration. Both links are geometrically
    exact beams.

    The default arm, `de_luca_siciliano` (De Luca & Siciliano 1991), has two links of 0.5 m with 0.2 kg/m and EI = 1 N
    m^2. The hub has an inertia of 0.1 kg m^2. The elbow motor has a mass of 1 kg and an inertia of 0.1 kg m^2. One half
    of the inertia moves with link 1, the other half with link 2. The payload has a mass of 0.1 kg and an inertia of
    5e-4 kg m^2. The damping time constant tau_d = 6.63e-3 s gives a damping ratio of one percent at 0.48 Hz, the first
    natural frequency of link 1. L, the sum of the lengths, is 1 m.

    `gymnasium.make("TwoLinkFlexArm-v0")` creates one arm. `gymnasium.make_vec("TwoLinkFlexArm-v0", num_envs=n)` creates
    n arms that one compiled call advances. Each arm gives bitwise the same results as a single arm. The id
    `flexarm_env:TwoLinkFlexArm-v0` also works if the package has not been imported.

    ## Action space

    `Box(-1, 1, (2,), float32)`: torques of hub and elbow divided by their limits (1 and 0.3 N m for the default arm).
    The torques are constant over one control period. The elbow's torque acts on link 2, and with opposite sign on link
    1. Actions beyond +-1 are clipped. NaN or infinity ends the episode (`action_not_finite`).

    ## Observation space

    `Box(-10, 10, (14,), float32)`; the bounds of sines and cosines are +-1. Each entry is divided by its scale and
    clipped to the bounds.

    | # | name | entry | scale | unit |
    |---|---|---|---|---|
    | 0, 1 | `hub_sin`, `hub_cos` | sine and cosine of the hub angle | 1 | - |
    | 2, 3 | `elbow_sin`, `elbow_cos` | sine and cosine of the elbow angle | 1 | - |
    | 4, 5 | `hub_rate`, `elbow_rate` | rates of both angles | w_0, w_1 | rad/s |
    | 6, 7 | `tip_deflection_1`, `tip_deflection_2` | tip deflections of links 1 and 2 | 0.1 | link length |
    | 8, 9 | `tip_deflection_rate_1`, `tip_deflection_rate_2` | rates of the tip deflections | 0.3 w_0 | link length/s |
    | 10, 11 | `tip_velocity_x`, `tip_velocity_y` | tip velocity | w_0 L | m/s |
    | 12, 13 | `to_target_x`, `to_target_y` | vector from tip to target | 0.5 L | m |

    - w_k = sqrt(tau_k pi/2 / I_k). tau_k is the torque limit of joint k. I_k is the inertia, about joint k, of the part
      of the straight arm beyond joint k. For the default arm w_0 = 1.595 and w_1 = 2.371 rad/s.
    - The vectors in entries 10 to 13 have components in the frame that turns with the hub.
    - The elbow angle is the angle of link 2's root relative to link 1's tip.
    - The tip deflection of a link is the component of (tip - root) normal to the link's tangent at the root, divided by
    the link's length.

    With `task="track"` six entries follow, in the hub's frame: the target's velocity `target_velocity_x`,
    `target_velocity_y` (scale w_0 L), and the displacements of the target in the next 0.1 s, `target_ahead_1_x`,
    `target_ahead_1_y`, and 0.3 s, `target_ahead_2_x`, `target_ahead_2_y` (scale 0.5 L).

    The observation contains the following entries only if you select them by name. `hub_error` and `elbow_error` are
    goal angles minus present joint angles (scale 1 rad); at the goal angles the rigid arm's tip is at the target.
    `target_x` and `target_y` are the target in inertial axes (scale L). `previous_action` and `previous_action_1` are
    the previous actions of hub and elbow. Sensors have the entries `strain_gauge_1`, `tip_acceleration_x`,
    `tip_acceleration_y`, `camera_x` and `camera_y`. See [Entries of the observation](options.md#observation).

    ## Rewards

    The reward is the sum of the terms in the table, each multiplied by its weight; `info["reward_<name>"]` is the
    weighted term. In the table e is the distance of the tip from the target divided by L, and v is the speed of the tip
    divided by L (1/s; with task="track" the speed relative to the target). d_k' is the time derivative of the tip
    deflection of link k, and a_k is the action of joint k.

    | name | weight | term | bounds, weighted |
    |---|---|---|---|
    | accuracy | 0.5 | exp(-(e/0.1)^2) | 0 to 0.5 |
    | settle | 1 | exp(-(e/0.02)^2 - (v/0.1)^2) | 0 to 1 |
    | distance | 0.5 | 1 - min(e, 1) | 0 to 0.5 |
    | effort | 0.01 | -(a_0^2 + a_1^2) | -0.02 to 0 |
    | vibration | 0 | -min(d_1'^2 + d_2'^2, 1) | 0 |
    | failure | 58 | -1 in the step that ends an episode by failure | -58 to 0 |

    [Reward](options.md#reward) describes how to change weights and add terms of your own.

    ## Starting state

    The arm is at rest with straight links. In half of the episodes both joint angles are 0; in the other half they are
    random between -0.5 and 0.5 rad. The target is at a random distance of 0.3 L to 0.95 L from the root, in a random
    direction within +-120 degrees of the x axis. All distributions are uniform, within the joint limits. Targets that
    the arm cannot reach within the joint limits, or where the motors cannot hold the arm against gravity, are drawn
    again. If there is no possible target, `make` raises an error. [Starts and resets](options.md#starts-and-resets)
    describes how to set other initial states.

    ## Episode end

    - Truncation: an episode is truncated after `duration` (8 s, rounded down to whole control periods) or
      `max_episode_steps`, whichever is earlier, or at the end of a prescribed motion.
    - Termination: an episode is terminated only by a failure, with a reason as in FlexibleArm-v0. The reason
      `joint_limit` means that the elbow angle is beyond +-2.8 rad.
    - Success does not end an episode. `info["is_success"]` is true if, during the last 0.5 s, the tip was within 0.01 L
      of the target and its speed was below 0.05 L/s. An episode counts as a success if the value is true at its last
      step.

    ## Info

    `info` has the keys of FlexibleArm-v0, with `tip_deflection` (2,), `target` (2,) m and `joint_torque` (2,) N m.

    ## Arguments

    The environment has the arguments of FlexibleArm-v0 (:class:`flexarm_env.envs.flexible_arm.FlexibleArmEnv`). These
    defaults differ:

    | name | default | meaning |
    |---|---|---|
    | `arm` | "de_luca_siciliano" | or "quanser_2dsfl", "paper_two_link", a TOML file, a `flexarm_env.Arm` |
    | `duration` | 8.0 | length of an episode, s |
    | `task` | "reach" | or "track": moving target; "replay": prescribed motion; "press", "land": see options |

    The [options page](options.md#all-arguments) describes all arguments and the differences for arms with two or more
    links.

    ## Version history

    * v0: first version. Since 0.2.0 rewards, random initial angles and random targets follow
      [rules 2](options.md#rules). `rules=1` selects the former rules, with initial hub angles between -1 and 1 rad and
      initial elbow angles between -1.8 and 1.8 rad.
    """

    kind = REACH


class TwoLinkFlexArmVectorEnv(VectorArmEnv, VectorEnv[Array32, Array32, NDArray[Any]]):
    """Vector environment with the arms and tasks of TwoLinkFlexArm-v0; see :class:`TwoLinkFlexArmEnv`."""

    kind = REACH
