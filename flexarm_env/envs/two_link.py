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

    Two flexible links with motors at hub and elbow move in the horizontal plane. The agent is to bring the tip, which
    carries a payload, to a target point and to keep it there, still. Both links are beams with exact geometry.

    `gymnasium.make("TwoLinkFlexArm-v0")` is one arm, `gymnasium.make_vec("TwoLinkFlexArm-v0", num_envs=n)` n of them
    in one compiled call a step; the two agree bit for bit. In a process that has not imported the package:
    `gymnasium.make("flexarm_env:TwoLinkFlexArm-v0")`.

    The default arm, `de_luca_siciliano` (De Luca & Siciliano 1991), has links of 0.5 m, 0.2 kg/m and EI = 1 N m^2,
    0.1 kg m^2 at the hub, an elbow motor of 1 kg and 0.1 kg m^2 (half of it on each link), a payload of 0.1 kg with
    5e-4 kg m^2, and tau_d = 6.63e-3 s (one per cent of damping at link 1's 0.48 Hz). L is the sum of the lengths, 1
    m.

    ## Action space

    `Box(-1, 1, (2,), float32)`: torques of hub and elbow, as shares of their limits (1 and 0.3 N m), held over one
    control period; the elbow's acts + on link 2 and - on link 1. Beyond +-1 they are clipped; NaN or infinity ends
    the episode (`action_not_finite`).

    ## Observation space

    `Box` of float32. Each entry is divided by its scale and clipped to +-10 (sines and cosines without noise to +-1).
    w_k = sqrt(tau_k pi/2 / I_k), tau_k the torque limit of joint k, I_k the inertia of the straight arm from there on
    about it; for the default arm w_0 = 1.595 and w_1 = 2.371 rad/s.

    | # | entry | scale | unit |
    |---|---|---|---|
    | 0, 1 | sine and cosine of the hub angle | 1 | - |
    | 2, 3 | sine and cosine of the elbow angle | 1 | - |
    | 4, 5 | rates of hub and elbow angle | w_0, w_1 | rad/s |
    | 6, 7 | tip deflections of links 1 and 2 | 0.1 | link length |
    | 8, 9 | their rates | 0.3 w_0 | link length/s |
    | 10, 11 | tip velocity, along and across | w_0 L | m/s |
    | 12, 13 | from tip to target, along and across | 0.5 L | m |

    Entries 10 to 13 are components in the frame that turns with the hub. The elbow angle is that of link 2's root
    from link 1's tip. A link's tip deflection is the component of (tip - root) normal to its tangent at the root,
    over its length. With `task="track"` follow: 14, 15 the target's velocity (scale w_0 L), 16, 17 and 18, 19 the
    ways that the target will have gone 0.1 and 0.3 s ahead (scale 0.5 L), all in the hub's frame. Strain gauges come
    last: curvature, 1/m, over that under the full torque of the link's joint, tau_k/EI.

    `observation` and `history` are as in FlexibleArm-v0. Entries by name: `hub_sin`, `hub_cos`, `elbow_sin`,
    `elbow_cos`, `hub_rate`, `elbow_rate`, `tip_deflection_1`, `tip_deflection_2`, `tip_deflection_rate_1`,
    `tip_deflection_rate_2`, `tip_velocity_x`, `tip_velocity_y`, `to_target_x`, `to_target_y`, with `task="track"`
    `target_velocity_x`, `target_velocity_y`, `target_ahead_1_x`, `target_ahead_1_y`, `target_ahead_2_x`,
    `target_ahead_2_y`; `hub_error`, `elbow_error`: joint angles at which the rigid arm reaches the target (those of
    "residual_pd") less the joints' (scale 1 rad); `target_x`, `target_y`: the target in fixed axes (scale L); and those
    of sensors, as there (`strain_gauge_1`, ...). `observation="measured"` are sines and cosines of both encoders, their
    rates, what of a moving target is known (in the frame that turns with the hub's encoder), `hub_error`,
    `elbow_error`, `target_x`, `target_y`, accelerometer, camera, strain gauges (with no word of sensors one at the root
    of each link).

    ## Reward

    The sum of these terms, each in `info` as `reward_<name>`; e distance of the tip from the target over L, v its
    speed over L (1/s; with "track" relative to the target), d' rates of the deflections, a the action. With weights of
    their own there are `change`, -sum of (a_k less that of the action before)^2, and `cost`, as in FlexibleArm-v0.

    | name | weight | term | bounds |
    |---|---|---|---|
    | accuracy | 0.5 | exp(-(e/0.1)^2) | 0 to 0.5 |
    | settle | 1 | exp(-(e/0.02)^2 - (v/0.1)^2) | 0 to 1 |
    | distance | 0.5 | -min(e, 1) | -0.5 to 0 |
    | effort | 0.01 | -(a_0^2 + a_1^2) | -0.02 to 0 |
    | vibration | 0 | -min(d_1'^2 + d_2'^2, 1) | 0 |
    | failure | 5 | -1 in the step that ends an episode by failure | -5 to 0 |

    ## Starting state

    At rest with straight links; half of the episodes with both joint angles 0, half with the hub at -1 to 1 and the
    elbow at -1.8 to 1.8 rad. The target is 0.3 L to 0.95 L from the root, within +-120 degrees of the x axis. All draws
    are uniform, of angles within the joints' limits. `initial_vibration=x` adds a first mode in which link 1's tip
    deflects by at most x times its length, that of the nominal arm.

    ## Episode end

    Truncated after the whole control periods in `duration` (8 s) or `max_episode_steps`, whichever comes first, or
    where a prescribed motion ends. Success never ends an episode: `info["is_success"]` says whether, over the trailing
    0.5 s, the tip has been within 0.01 L of the target and slower than 0.05 L/s throughout; an episode's success is its
    value at the last step. Terminated by failure only, with `info["termination_reason"]`: `joint_limit` (the elbow
    beyond +-2.8 rad), `action_not_finite`, or the solver's status (`newton_failed`, `out_of_range`, `diverged`,
    `not_finite`). After the last two kinds the observation is the last good one. The other arms of a vector go on
    untouched.

    ## Info

    As in FlexibleArm-v0, with `tip_deflection` (2,), `target` (2,) m and `joint_torque` (2,) N m.

    ## Arguments and options

    As in FlexibleArm-v0 (:class:`flexarm_env.envs.flexible_arm.FlexibleArmEnv`), for an arm of two links:

    | name | default | meaning |
    |---|---|---|
    | `arm` | "de_luca_siciliano" | or "quanser_2dsfl", "paper_two_link", a TOML file, a `flexarm_env.Arm` |
    | `action_mode` | "torque" | or "residual_pd": k_k (goal_k - angle_k) - d_k rate_k + s tau_k a_k, within +-tau_k |
    | `residual_share` | 0.7 | s of "residual_pd" |
    | `duration` | 8.0 | s |
    | `task` | "reach" | or "track": the target moves (`reference`: x and y over time, m; None: a circle); "replay" |
    | `joint_limits` | the arm's | [(low, high) or None for each joint], rad; None: none |
    | `success` | {} | bounds `position` (over L), `speed` (tip less target, over L, 1/s), `hold` (s); `once`, `paid` |
    | `starts` | {} | `angles`: (low, high) of each joint, rad; `target`: of distance (m) and bearing (rad); \
    `straight`: share with all joints at 0 |

    `reference={"path": "circle", "distance": (low, high), "period": ..., "radius": ..., "bearing": ...}` draws
    circles by the distance (m) and bearing (rad) of their centres, {"path": "line", "distance": ..., "time": ...,
    "speed": ..., "bearing": ...} straight lines by their point nearest to the root, when they pass there (s), and how
    fast (m/s). What is left out is as usual. A limit of `cost` may be one for all links, or one each.

    Controllers of "residual_pd": k_k = tau_k / (pi/4), d_k = 2 sqrt(k_k I_k); the goals are the angles of the rigid
    arm with its tip at the target; of the two solutions the one sooner reached, joint k taking a time that goes as
    sqrt(|angle to go|) / w_k (a target that moves: sooner reached from the goals before).

    On a `base` that floats, the entries that FlexibleArm-v0 describes come after number 13.

    Strain gauges are given as (link, place), friction for both joints or one each. `noise` by entry: the names above.

    Options of reset: `start` (two angles, rad), `target` (x, y
    in m, within reach), `vibration`, and `motion`: one for the hub, a list of two or a dict by "joint0" and "joint1"
    (None: that joint keeps its action and starts at 0 or at `start`); "two_link_motion" is the paper's. For a vector
    of two arms a list of two holds a motion for each arm; a dict says joints.

    ## Versions

    * v0: first version
    """

    kind = REACH


class TwoLinkFlexArmVectorEnv(VectorArmEnv, VectorEnv[Array32, Array32, NDArray[Any]]):
    """Many TwoLinkFlexArm-v0 at once, each as :class:`TwoLinkFlexArmEnv` describes it."""

    kind = REACH
