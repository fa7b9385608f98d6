"""MultiLinkFlexArm-v0: a chain of flexible links brings its tip to a point and settles there."""

from typing import Any

import gymnasium as gym
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from ..validation import Array32
from .single import SingleArmEnv
from .task import CHAIN
from .vector import VectorArmEnv


class MultiLinkFlexArmEnv(SingleArmEnv, gym.Env[Array32, Array32]):  # bases: see `single`
    """
    ## Description

    A chain of N flexible links, N >= 2, with motors at the hub and at each elbow moves in the horizontal plane. The
    agent is to bring the tip, which carries a payload, to a target point and to keep it there, still. With N >= 3 there
    are many postures that reach it. With two links it is TwoLinkFlexArm-v0, to the last bit.

    `gymnasium.make("MultiLinkFlexArm-v0")` is one arm, `gymnasium.make_vec("MultiLinkFlexArm-v0", num_envs=n)` n of
    them in one compiled call a step; the two agree bit for bit. In a process that has not imported the package:
    `gymnasium.make("flexarm_env:MultiLinkFlexArm-v0")`.

    The default arm, `three_strips`, is made of the strip of `de_luca_siciliano`: links of 0.4, 0.35 and 0.25 m, 0.2
    kg/m and EI = 1 N m^2, 0.1 kg m^2 at the hub, elbow motors of 1 and 0.25 kg with 0.1 and 0.025 kg m^2 (half of it
    on each link), a payload of 0.1 kg with 5e-4 kg m^2, and tau_d = 6.63e-3 s. L is the sum of the lengths, 1 m.

    ## Action space

    `Box(-1, 1, (N,), float32)`: torques of hub and elbows, as shares of their limits (1, 0.3 and 0.075 N m), held over
    one control period; an elbow's acts + on the link beyond and - on the one before. Beyond +-1 they are clipped; NaN
    or infinity ends the episode (`action_not_finite`).

    ## Observation space

    `Box` of 5 N + 4 float32. Each entry is divided by its scale and clipped to +-10 (sines and cosines without noise to
    +-1). w_k = sqrt(tau_k pi/2 / I_k), tau_k the torque limit of joint k, I_k the inertia of the straight arm from
    there on about it; for the default arm w = 1.506, 1.735 and 2.410 rad/s.

    | # | entry | scale | unit |
    |---|---|---|---|
    | 0 to 2 N - 1 | sine and cosine of each joint's angle, the hub first | 1 | - |
    | 2 N to 3 N - 1 | rates of the joint angles | w_k | rad/s |
    | 3 N to 4 N - 1 | tip deflections of the links | 0.1 | link length |
    | 4 N to 5 N - 1 | their rates | 0.3 w_0 | link length/s |
    | 5 N, 5 N + 1 | tip velocity, along and across | w_0 L | m/s |
    | 5 N + 2, 5 N + 3 | from tip to target, along and across | 0.5 L | m |

    The last four are components in the frame that turns with the hub. An elbow angle is that of a link's root from the
    tip of the link before. With `task="track"` and strain gauges follow the entries that TwoLinkFlexArm-v0 has then.
    `observation` and `history` are those of TwoLinkFlexArm-v0, with `elbow_1`, `elbow_2`, ... where it has `elbow`.

    ## Reward

    The terms, weights and bounds of TwoLinkFlexArm-v0, with sums over all N joints and links: effort is -sum of a_k^2
    (weighted: -0.01 N to 0), vibration -min(sum of d_k'^2, 1), whose weight is 0.

    ## Starting state

    At rest with straight links; half of the episodes with all joint angles 0, half with the hub at -1 to 1 and the
    elbows at -3.6/N to 3.6/N rad. The target is 0.3 L to 0.95 L from the root, within +-120 degrees of the x axis. All
    draws are uniform, of angles within the joints' limits. `initial_vibration=x` adds a first mode in which link 1's
    tip deflects by at most x times its length, that of the nominal arm.

    ## Episode end and info

    As in TwoLinkFlexArm-v0, after `duration` = 10 s; `tip_deflection` and `joint_torque` have N entries.

    ## Arguments and options

    As in TwoLinkFlexArm-v0 (:class:`flexarm_env.envs.two_link.TwoLinkFlexArmEnv`), for an arm of N links:

    | name | default | meaning |
    |---|---|---|
    | `arm` | "three_strips" | another of two links or more: a name, a TOML file, a `flexarm_env.Arm` |
    | `duration` | 10.0 | s |
    | `joint_limits` | the arm's | [(low, high) or None for each joint], rad; None: none |

    Goals of "residual_pd" for N >= 3: of the joint angles of the rigid arm with its tip at the target those of least
    sum of squares, the hub as few turns away as can be (a target that moves: those that follow on the goals before).

    `task="replay"` without a `motion`: "two_link_motion", every further elbow as the first.

    ## Versions

    * v0: first version
    """

    kind = CHAIN


class MultiLinkFlexArmVectorEnv(VectorArmEnv, VectorEnv[Array32, Array32, NDArray[Any]]):
    """Many MultiLinkFlexArm-v0 at once, each as :class:`MultiLinkFlexArmEnv` describes it."""

    kind = CHAIN
