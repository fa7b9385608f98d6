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

    A chain of N flexible links, N >= 2, moves in the horizontal plane, with motors at the hub and at each elbow. The
    goal is to move the tip, which carries a payload, to a target point and hold it there without residual vibration.
    With N >= 3 many postures reach the target. With N = 2 the results are bitwise equal to those of TwoLinkFlexArm-v0.

    The default arm, `three_strips`, has links of 0.4, 0.35 and 0.25 m with the section of `de_luca_siciliano` (0.2
    kg/m, EI = 1 N m^2, tau_d = 6.63e-3 s). The hub has an inertia of 0.1 kg m^2. The elbow motors have masses of 1 and
    0.25 kg and inertias of 0.1 and 0.025 kg m^2. Half of each inertia moves with the link before the motor, and half
    with the link after the motor. The payload has a mass of 0.1 kg and an inertia of 5e-4 kg m^2. L is the sum of the
    lengths, 1 m.

    `gymnasium.make("MultiLinkFlexArm-v0")` creates one arm. `gymnasium.make_vec("MultiLinkFlexArm-v0", num_envs=n)`
    creates n arms that one compiled call advances. Each of the n arms gives bitwise the same results as a single arm.
    The id `flexarm_env:MultiLinkFlexArm-v0` also works if the package has not been imported.

    ## Action space

    `Box(-1, 1, (N,), float32)`: torques of hub and elbows divided by their limits (1, 0.3 and 0.075 N m for the default
    arm). The torques are constant over one control period. An elbow's torque acts on the link after the elbow, and with
    opposite sign on the link before the elbow. Actions beyond +-1 are clipped. An action with NaN or infinity ends the
    episode (`action_not_finite`).

    ## Observation space

    `Box` of 5 N + 4 float32 in +-10 (sines and cosines in +-1). Each entry is a quantity divided by its scale and
    clipped to the bounds.

    | # | entry | scale | unit |
    |---|---|---|---|
    | 0 to 2 N - 1 | sine and cosine of each joint angle, the hub first | 1 | - |
    | 2 N to 3 N - 1 | rates of the joint angles | w_k | rad/s |
    | 3 N to 4 N - 1 | tip deflections of the links | 0.1 | link length |
    | 4 N to 5 N - 1 | rates of the tip deflections | 0.3 w_0 | link length/s |
    | 5 N, 5 N + 1 | tip velocity, x and y | w_0 L | m/s |
    | 5 N + 2, 5 N + 3 | vector from tip to target, x and y | 0.5 L | m |

    The entries have the definitions, names and optional additions of TwoLinkFlexArm-v0; elbows are named `elbow_1`,
    `elbow_2` and so on. For the default arm the rate scales are w_0 = 1.506, w_1 = 1.735 and w_2 = 2.410 rad/s.

    ## Rewards

    The reward has the terms, weights and bounds of TwoLinkFlexArm-v0, with sums over all N joints and links. The term
    effort is -sum of a_k^2 (weighted: -0.01 N to 0). The term vibration is -min(sum of d_k'^2, 1) with the deflection
    rates d_k'; its weight is 0.

    ## Starting state

    The arm starts as in TwoLinkFlexArm-v0. Half of the episodes begin with random joint angles between -0.5 and 0.5
    rad. For N > 7 the elbow angles are between -3.6/N and 3.6/N rad.

    ## Episode end and info

    Episodes end as in TwoLinkFlexArm-v0, with `duration` = 10 s, and `info` has the keys of TwoLinkFlexArm-v0.
    `tip_deflection` and `joint_torque` have N entries.

    ## Arguments

    The environment has the arguments of TwoLinkFlexArm-v0 (:class:`flexarm_env.envs.two_link.TwoLinkFlexArmEnv`). These
    defaults differ:

    | name | default | meaning |
    |---|---|---|
    | `arm` | "three_strips" | name, TOML file, or `flexarm_env.Arm` of two links or more |
    | `duration` | 10.0 | length of an episode, s |

    The [options page](options.md#all-arguments) has all arguments.

    ## Version history

    * v0: first version. Since 0.2.0 rewards, random initial angles and random targets follow
      [rules 2](options.md#rules). `rules=1` selects the former rules, with initial hub angles between -1 and 1 rad and
      initial elbow angles between -3.6/N and 3.6/N rad.
    """

    kind = CHAIN


class MultiLinkFlexArmVectorEnv(VectorArmEnv, VectorEnv[Array32, Array32, NDArray[Any]]):
    """Vector environment with the arms and tasks of MultiLinkFlexArm-v0; see :class:`MultiLinkFlexArmEnv`."""

    kind = CHAIN
