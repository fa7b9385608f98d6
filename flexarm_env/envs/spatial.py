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

    A chain of N links in space, flexible or rigid, with a motor at each joint, stands on a base that is held, under
    gravity. The agent is to bring the tip to a target point and to keep it there, still. Links are geometrically exact
    beams in space, which bend in both planes, twist, stretch and shear (docs: theory, section 9); or have floating
    frames.

    `gymnasium.make("SpatialFlexArm-v0")` is one arm, `gymnasium.make_vec("SpatialFlexArm-v0", num_envs=n)` n of them
    in one compiled call a step; the two agree bit for bit. In a process that has not imported the package:
    `gymnasium.make("flexarm_env:SpatialFlexArm-v0")`.

    The default arm, `three_dof` (after shamilmamedov/flexible_arm), has a rigid pillar of 0.15 m that yaws about the
    vertical, z, and two steel strips of 0.5 m, 50 mm wide and 2 mm thick, that pitch at shoulder and elbow. At angles 0
    it stands upright. It carries no payload that could be drawn or changed; `three_dof_loaded` does, 0.1 kg. L is the
    sum of the lengths, 1.15 m.

    ## Action space

    `Box(-1, 1, (N,), float32)`: torques of the joints, as shares of their limits (20, 10 and 10 N m), held over one
    control period. Beyond +-1 they are clipped; NaN or infinity ends the episode (`action_not_finite`).

    ## Observation space

    `Box` of 3 N + 6 F + 6 float32, F flexible links (27 for the default arm). Each entry is divided by its scale and
    clipped to +-10 (sines and cosines without noise to +-1). w_k = sqrt(tau_k pi/2 / I_k), tau_k the torque limit of
    joint k, I_k the inertia about it of all that is beyond, laid out straight at a right angle to the joint's axis; for
    the default arm w = 8.518, 7.738 and 21.887 rad/s.

    | # | entry | scale | unit |
    |---|---|---|---|
    | 0 to 2 N - 1 | sine and cosine of each joint's angle, the hub first | 1 | - |
    | 2 N to 3 N - 1 | rates of the joint angles | w_k | rad/s |
    | then for each flexible link | tip deflection along y and z of its root | 0.1 | link length |
    | | their rates | 0.3 w_0 | link length/s |
    | | twist | 0.1 | rad |
    | | its rate | 0.3 w_0 | rad/s |
    | the last six | tip velocity, x, y, z | w_0 L | m/s |
    | | from tip to target, x, y, z | 0.5 L | m |

    With `task="track"` nine more follow: the target's velocity (scale w_0 L), and from where it is to where it will be
    0.1 s and 0.3 s later (0.5 L).

    The last six, and these, are components along the axes of the root of link 0, which turn with the first joint. A
    link's deflections are the components of (tip - root) along y and z of its root's axes; its twist is the part about
    x of the rotation vector of its tip's axes against its root's.

    `observation` and `history` are as in FlexibleArm-v0. Entries by name: `hub_sin`, `hub_cos`, `elbow_1_sin`, ...,
    `hub_rate`, ..., `tip_deflection_y_2` (of the second link), `tip_deflection_z_2`, `tip_deflection_rate_y_2`,
    `tip_deflection_rate_z_2`, `twist_2`, `twist_rate_2`, ..., `tip_velocity_x`, ..., `to_target_x`, ..., with
    `task="track"` `target_velocity_x`, ..., `target_ahead_1_x`, ..., `target_ahead_2_x`, ...; `hub_error`,
    `elbow_1_error`, ...: joint angles at which the rigid arm reaches the target less the joints' (scale 1 rad);
    `target_x`, `target_y`, `target_z`: the target in fixed axes (scale L). Of sensors: `tip_acceleration_x`, `_y`, `_z`
    (m/s^2, scale w_0^2 L), `gyroscope_x`, `_y`, `_z` (rad/s, scale w_0), `camera_x`, `_y`, `_z` (m, scale L),
    `camera_rise_y`, `_z` (rad, scale 1), `strain_gauge_1`, ... (1/m, or strain; scale: under the full torque of the
    link's joint). `observation="measured"`: sines, cosines and rates of encoders, what of a moving target is known (in
    the axes of the root of link 0 as the first encoder reads it), these errors, the target, sensors.

    ## Reward

    The terms, weights and bounds of TwoLinkFlexArm-v0: e is the distance of the tip from the target over L, v its speed
    over L (1/s; with "track" relative to the target), d' the rates of the deflections in both planes. Two terms are
    sums over all N joints and links: effort is -sum of a_k^2 (weighted: -0.01 N to 0), vibration -min(sum of d'^2, 1),
    whose weight is 0.

    ## Starting state

    At rest with straight links, free of stress; half of the episodes with all joint angles 0, half with the first at -1
    to 1 and the others at -3.6/N to 3.6/N rad. The target is where the tip of the rigid arm is with its first joint at
    -2 pi/3 to 2 pi/3 and the others at -3.6/N to 3.6/N rad. All draws are uniform, within the joints' limits.

    `initial_vibration=x` adds three modes, each by a factor drawn from -x to x: the lowest ones of bending along y, of
    bending along z and of torsion (by what most strains the links), of the straight arm at joint angles 0, joints free,
    without weight. Times the factor's square all have the same energy: with that of x = 1 the softer bending would
    deflect a tip by its link's length. At other joint angles links move so against their roots with the same energy,
    and joints turn so that none has momentum, which would swing the arm.

    ## Episode end

    Truncated after the whole control periods in `duration` (5 s) or `max_episode_steps`, whichever comes first, or
    where a prescribed motion ends. Success never ends an episode: `info["is_success"]` says whether, over the trailing
    0.5 s, the tip has been within 0.01 L of the target and slower than 0.05 L/s throughout; with "track" than 0.05 L/s
    beside the target. Terminated by failure only, with `info["termination_reason"]`: `joint_limit`,
    `action_not_finite`, or the solver's status. The other arms of a vector go on untouched.

    ## Info

    As in TwoLinkFlexArm-v0, with `tip_position` (3,) and `target` (3,) m, `joint_torque` (N,) N m, `tip_deflection`
    (2 N,) over length, of all links along y, then along z, and `twist` (N,) rad; those of rigid links are 0. With
    `keep_out` also `clearance` and `penetration`, m, `cost` and `episode_cost`, as in FlexibleArm-v0; looked at are
    five points of each element, on the cubic between its ends, and of a rigid link. `cost` has limits on
    `deflection`, of all links or one each (the size of (y, z), over length), and on `strain`: of the surface at 0, 1/4,
    1/2 and 3/4 along each link that bends, at the corner of the rectangle that m, J and J_y tell, where the strains of
    both bendings add up.

    ## Arguments and options

    Those of FlexibleArm-v0 (:class:`flexarm_env.envs.flexible_arm.FlexibleArmEnv`) that the page on environments in
    space lists; what is not there yet is refused by name. Pushes come from all around; `info["push"]` (3,) N is along
    fixed axes. Where they differ:

    | name | default | meaning |
    |---|---|---|
    | `arm` | "three_dof" | another that leaves the plane, with torque limits and straight links |
    | `control_dt` | 0.01 | s |
    | `gravity` | (0, 0, -9.81) | (x, y, z), m/s^2 |
    | `formulation` | "geometrically_exact" | or "floating_frame", with `segments` or `modes` (at least 2) |
    | `elements`, `dt`, `tolerance` | 2, 0.0025, 1e-5 | elements a link; s; of Newton's increments |
    | `segments`, `dt`, `tolerance` | 2, 0.0025, 1e-6 | of floating frames |
    | `modes`, `segments`, `dt`, `tolerance` | -, 1, 0.005, 1e-6 | the same, reduced to bending modes of each plane |
    | `task` | "reach" | or "track": the target moves (`reference`: x, y, z over time, m; None: a circle); "replay" |
    | `randomization` | {} | `EI` is a factor on EI and EI_y; also `EI_y` (besides `EI`) and `GJ` |
    | `starts` | {} | `angles`: (low, high) of each joint, rad; `target`: of the joint angles there; `straight` |

    `reference` as in TwoLinkFlexArm-v0, of three functions or a table t, x, y, z; of drawn paths `bearing` is that
    about z from the x axis and `elevation` that above the x-y plane, rad. Circles lie in planes drawn from all there
    are, lines go past the point nearest to the root in any direction. Usual: distances 0.45 L to 0.65 L, radii 0.05 L
    to 0.15 L, elevations 30 to 60 degrees, the others as in the plane. A path to which no joint angles are found is
    refused.

    Options of reset: `start` (N angles, rad), `target` (x, y, z in m, a point that the rigid arm reaches), `motion` and
    `interpolation` as in FlexibleArm-v0: joint angles over time, with `joint_torque` what enforces them. `motion` of
    task="replay": None turns all joints to 1.5 rad in 5 s, smoothly, and lasts 9 s. With `initial_vibration` also
    `vibration`: the three factors. Goals of
    "residual_pd" are the joint angles that the target was drawn by, or those of least sum of squares that were found;
    of a target that moves those that follow on the goals before.

    ## Versions

    * v0: first version
    """

    kind = SPACE


class SpatialFlexArmVectorEnv(VectorArmEnv, VectorEnv[Array32, Array32, NDArray[Any]]):
    """Many SpatialFlexArm-v0 at once, each as :class:`SpatialFlexArmEnv` describes it."""

    kind = SPACE
