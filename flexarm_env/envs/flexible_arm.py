"""FlexibleArm-v0: one flexible link slews its tip to an angle and settles there."""

from typing import Any

import gymnasium as gym
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from ..validation import Array32
from .single import SingleArmEnv
from .task import SLEW
from .vector import VectorArmEnv


class FlexibleArmEnv(SingleArmEnv, gym.Env[Array32, Array32]):  # bases: see `single`
    """
    ## Description

    A motor at the hub turns a flexible link in the horizontal plane. The goal is to move the tip, which carries a
    payload, to a target angle and hold it there without residual vibration. The link is a geometrically exact beam: a
    continuous body whose bending may be large.

    The default arm, `strip`, is an aluminum strip of 1 m x 30 mm x 3.42 mm (EI about 7 N m^2) with a moment of inertia
    of 0.05 kg m^2 at the hub and a mass of 0.2 kg at the tip. With the hub clamped and the payload attached, the
    strip's first natural frequency is 8.89 rad/s, and its damping ratio is one percent.

    `gymnasium.make("FlexibleArm-v0")` creates one arm. `gymnasium.make_vec("FlexibleArm-v0", num_envs=n)` creates n
    arms that one compiled call advances. Each of the n arms gives bitwise the same results as a single arm. The id
    `flexarm_env:FlexibleArm-v0` also works if the package has not been imported.

    ## Action space

    `Box(-1, 1, (1,), float32)`: the hub torque divided by the arm's torque limit (`strip`: 2 N m). The torque is
    constant over one control period. Actions beyond +-1 are clipped. An action that is NaN or infinite ends the episode
    (`action_not_finite`).

    ## Observation space

    `Box(-10, 10, (6,), float32)`; the bounds of sine and cosine are +-1. Each entry is divided by its scale and clipped
    to the bounds.

    | # | name | entry | scale | unit |
    |---|---|---|---|---|
    | 0 | `hub_sin` | sine of the hub angle | 1 | - |
    | 1 | `hub_cos` | cosine of the hub angle | 1 | - |
    | 2 | `hub_rate` | rate of the hub angle | w | rad/s |
    | 3 | `tip_deflection` | tip deflection | 0.1 | L |
    | 4 | `tip_deflection_rate` | rate of the tip deflection | 0.3 w | L/s |
    | 5 | `target_error` | target angle minus tip angle, unwrapped | 1 | rad |

    - w = sqrt(tau pi/2 / I) is the largest rate of the rigid arm in its fastest quarter turn from rest to rest. tau is
      the torque limit, I the inertia of the straight arm about the hub. For `strip` w = 3.029 rad/s.
    - L is the length of the link.
    - The tip deflection is the component of (tip - root) normal to the link's tangent at its root, divided by L.
    - The tip angle is the polar angle of the tip about the hub.

    `observation="measured"` replaces the entries in the table by sensor readings. `observation=("hub_sin", ...)`
    selects entries by name. `history=k` stacks the last k observations. [Entries of the
    observation](options.md#observation) lists all names.

    ## Rewards

    The reward is the sum of the terms in the table, each multiplied by its weight. `info["reward_<name>"]` is the
    weighted term. In the table e is the target angle minus the tip angle (rad), e' the time derivative of e (rad/s), d'
    the time derivative of the tip deflection (L/s), and a the action.

    | name | weight | term | bounds, weighted |
    |---|---|---|---|
    | accuracy | 0.5 | exp(-(e/0.1)^2) | 0 to 0.5 |
    | settle | 1 | exp(-(e/0.02)^2 - (e'/0.2)^2) | 0 to 1 |
    | distance | 0.5 | 1 - min(abs(e), 1) | 0 to 0.5 |
    | effort | 0.01 | -a^2 | -0.01 to 0 |
    | vibration | 0.02 | -min(d'^2, 1) | -0.02 to 0 |
    | failure | 56 | -1 in the step that ends an episode by failure | -56 to 0 |

    `reward={"effort": 0.1}` changes weights, and `reward_terms` adds terms of your own ([Reward](options.md#reward)).
    The weight of failure is so large that a failure never increases the return of an episode. Weights are proportional
    to the control period, so the return of an episode is independent of the control period.

    ## Starting state

    The link is straight and at rest. The hub angle is random between -pi and pi, and the target angle is random within
    +-pi/2 of the hub angle, both with uniform distributions. A target is drawn again if it is outside the joint limits
    or if the motor cannot hold the arm there against gravity. If there is no possible target, `make` raises an error.
    [Starts and resets](options.md#starts-and-resets) describes how to set initial states and targets, and how to begin
    with a vibrating link.

    ## Episode end

    - Truncation: an episode is truncated after `duration` (4 s, rounded down to whole control periods) or
      `max_episode_steps`, whichever is earlier, or at the end of a prescribed motion.
    - Termination: an episode is terminated only by a failure. `info["termination_reason"]` is `joint_limit` (a joint
      beyond its limits), `action_not_finite`, or the status of the solver (`newton_failed`, `out_of_range`, `diverged`,
      `not_finite`). After `action_not_finite` or a failure of the solver, `step` returns the last observation before
      the failure. In a vector environment, episodes of all other arms continue.
    - Success does not end an episode. `info["is_success"]` is true if, during the last 0.5 s, the tip angle was within
      1 degree of the target and the magnitude of the deflection rate was below 0.01 L/s. An episode counts as a success
      if `info["is_success"]` is true at its last step.

    ## Info

    `info` of `reset` and `step` has the same keys and types, in SI units. Options add further keys
    ([Info](options.md#info)).

    | key | meaning |
    |---|---|
    | `is_success` | bool: see Episode end |
    | `tip_position` | (2,) m |
    | `tip_deflection` | tip deflection divided by L |
    | `target` | rad |
    | `hub_torque`, `joint_torque` | N m, as applied; `joint_torque` is (1,) |
    | `reward_<name>` | weighted terms of the reward |
    | `in_range` | bool: the formulation is valid at this deflection |
    | `deflection_bound` | largest valid deflection divided by L; infinite except with `modes` |
    | `error_estimate` | estimated largest error of the tip, divided by L; a constant ([meaning](options.md#info)) |
    | `solver_status` | "ok", or the kind of failure |
    | `termination_reason` | "", or the reason for the termination |

    ## Arguments

    All arguments are keyword arguments of `gymnasium.make` and `make_vec`. Most users need these eight:

    | name | default | meaning |
    |---|---|---|
    | `arm` | "strip" | name, TOML file, or `flexarm_env.Arm` of one link with a torque limit |
    | `formulation` | "elastica" | or "geometrically_exact", "floating_frame", "paper" (the solver of Meek & Liu) |
    | `control_dt` | 0.02 | control period, s |
    | `duration` | 4.0 | length of an episode, s |
    | `observation` | "full" | or "measured", or names of entries |
    | `reward` | {} | weights by name |
    | `randomization` | {} | ranges of factors on payload, stiffness, damping, ..., drawn for each episode |
    | `render_mode` | None | "rgb_array" or "human" |

    The [options page](options.md#all-arguments) has all arguments: sensors, motors, moving targets, costs, walls,
    pushes, a floating base, solver settings.

    ## Version history

    * v0: first version. Since 0.2.0 rewards and random targets follow [rules 2](options.md#rules); `rules=1` selects
      the former rules.
    """

    kind = SLEW


class FlexibleArmVectorEnv(VectorArmEnv, VectorEnv[Array32, Array32, NDArray[Any]]):
    """Vector environment with the arms and tasks of FlexibleArm-v0; see :class:`FlexibleArmEnv`."""

    kind = SLEW
