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

    A flexible link turns about its hub in the horizontal plane. A motor turns the hub; the agent is to bring the tip,
    which carries a payload, to a target angle and to keep it there, still. The arm is a beam with exact geometry (any
    deflection), not a mass on a spring: what bends is computed, and vibrates.

    `gymnasium.make("FlexibleArm-v0")` is one arm, `gymnasium.make_vec("FlexibleArm-v0", num_envs=n)` n of them in one
    compiled call a step; the two agree bit for bit. In a process that has not imported the package:
    `gymnasium.make("flexarm_env:FlexibleArm-v0")`.

    The default arm, `strip`, is an aluminium strip of 1 m x 30 mm x 3.42 mm (EI about 7 N m^2, first frequency
    clamped and with its payload 8.89 rad/s) with 0.05 kg m^2 at the hub, 0.2 kg at the tip and one per cent of
    damping.

    ## Action space

    `Box(-1, 1, (1,), float32)`: the hub torque, as a share of the arm's torque limit (`strip`: 2 N m), held over one
    control period. Beyond +-1 it is clipped; NaN or infinity ends the episode (`action_not_finite`).

    ## Observation space

    `Box` of float32. Each entry is divided by its scale and clipped to +-10 (sine and cosine without noise to +-1). w =
    sqrt(tau pi/2 / I) is the top rate of a rigid quarter turn at full torque, tau the torque limit, I the inertia of
    the straight arm about the hub; for `strip` w = 3.029 rad/s.

    | # | entry | scale | unit |
    |---|---|---|---|
    | 0 | sine of the hub angle | 1 | - |
    | 1 | cosine of the hub angle | 1 | - |
    | 2 | rate of the hub angle | w | rad/s |
    | 3 | tip deflection | 0.1 | L |
    | 4 | rate of the tip deflection | 0.3 w | L/s |
    | 5 | target less tip angle, unwrapped | 1 | rad |

    The tip deflection is the component of (tip - root) normal to the link's tangent at its root, over the length L;
    the tip angle is the polar angle of the tip about the hub. With `task="track"` follow: 6 the target's rate (scale
    w), 7 and 8 the ways that the target will have gone 0.1 and 0.3 s ahead (scale 1 rad). Strain gauges come last:
    curvature, 1/m, over that under the full torque, tau/EI.

    That is `observation="full"`. `observation=("hub_sin", "hub_cos", "strain_gauge_1", ...)` takes entries by name, in
    this order: `hub_sin`, `hub_cos`, `hub_rate`, `tip_deflection`, `tip_deflection_rate`, `target_error`, with
    `task="track"` `target_rate`, `target_ahead_1` and `target_ahead_2`; `hub_error`, the target less the hub's angle
    (scale 1 rad); and those of sensors: `strain_gauge_1`, ... (with no word of sensors one, at the root),
    `tip_acceleration_x`, `tip_acceleration_y` (scale w^2 L), `camera_x`, `camera_y` (scale L).

    `observation="measured"` is what the sensors give and the target, and nothing else that is true of the tip:
    `hub_sin`, `hub_cos` and `hub_rate` of the encoder, what of a moving target is known, `hub_error` (the target less
    the encoder's angle), accelerometer, camera, strain gauges. An arm that names no sensors has an ideal encoder, its
    rate a filtered difference, and a gauge at the root. Success and reward are the true tip's.

    With `history=k` an observation is k of these in a row, the oldest first; at reset the first fills all k.

    ## Reward

    The sum of these terms, each in `info` as `reward_<name>`; e target less tip angle (rad), e' its rate, d' the rate
    of the tip deflection (L/s), a the action. `reward={"effort": 0.1}` changes weights.
    Two terms are there where they are given a weight: `change`, -(a less the action before)^2, -4 to 0; `cost`, with
    the options `cost` or `keep_out`, -1 in each period that costs.

    | name | weight | term | bounds |
    |---|---|---|---|
    | accuracy | 0.5 | exp(-(e/0.1)^2) | 0 to 0.5 |
    | settle | 1 | exp(-(e/0.02)^2 - (e'/0.2)^2) | 0 to 1 |
    | distance | 0.5 | -min(abs(e), 1) | -0.5 to 0 |
    | effort | 0.01 | -a^2 | -0.01 to 0 |
    | vibration | 0.02 | -min(d'^2, 1) | -0.02 to 0 |
    | failure | 5 | -1 in the step that ends an episode by failure | -5 to 0 |

    ## Starting state

    Straight and at rest at a hub angle from -pi to pi, within the joint's limits (targets are not held to them), with a
    target within +-pi/2 of it; `initial_vibration=x` adds the first mode of vibration, in which the tip deflects by at
    most x L (drawn from -x to x; of the nominal arm: one of half its stiffness deflects by 1.4 times as much). All
    draws are uniform.

    ## Episode end

    Truncated after the whole control periods in `duration` (4 s) or `max_episode_steps`, whichever comes first, or
    where a prescribed motion ends. Success never ends an episode: `info["is_success"]` says whether, over the trailing
    0.5 s, the tip angle has been within 1 degree of the target and the rate of the deflection below 0.01 L/s
    throughout; an episode's success is its value at the last step. Terminated by failure only, with
    `info["termination_reason"]`: `joint_limit` (a joint beyond its limits), `action_not_finite`, or the solver's status
    (`newton_failed`, `out_of_range`, `diverged`, `not_finite`). After the last two kinds the observation is the last
    good one. The other arms of a vector go on untouched.

    ## Info

    The same keys and types at every reset and step, float64 and SI units: `is_success` (bool), `tip_position` (2,) m,
    `tip_deflection` (over L), `target` rad, `hub_torque` N m (as applied, under a lag what the motor has come to; where
    the hub's motion is prescribed, what enforces it), `joint_torque` (1,) N m, `reward_<name>`, `in_range` (bool: the
    formulation holds), `deflection_bound` (over L, beyond which it does not: infinite but for `modes`),
    `error_estimate` (over L: what leaving out stretch and shear costs the elastica under the largest torques, mesh and
    step not in it; infinite for others: not known), `solver_status` ("ok" or what failed), `termination_reason` ("" or
    why). With `step_tolerance` also `step_error` (over L: what the period added; above the tolerance where five
    halvings of `dt` were not enough). With `info_level="full"` also `energy_kinetic`, `energy_strain`,
    `energy_gravity`, `energy_dissipated` and `work` (of the motor), J. With `randomization` also `drawn_<key>` of each
    of its keys: the episode's factor. Where a delay is drawn `drawn_command_delay`, of the period's commands, with its
    jitter (at reset without), and `drawn_observation_delay`, s; `drawn_<reading>_gain` of sensors whose gain is drawn
    (`strain_gauge_1`, `hub_angle`, `camera_x`, ...).

    ## Arguments

    | name | default | meaning |
    |---|---|---|
    | `arm` | "strip" | name, TOML file, or `flexarm_env.Arm` of one link with a torque limit |
    | `base` | the arm's | `mass` (kg), `inertia` (kg m^2) of what carries the arm and floats freely, see below |
    | `formulation` | "elastica" | or "geometrically_exact", "floating_frame"; with its options as flat keywords |
    | `nodes`, `elements`, `order` | | mesh of the formulation, see below |
    | `segments`, `modes`, `frame`, `coupling`, `multipliers` | | likewise, "floating_frame" |
    | `rho_inf`, `newmark` (beta, gamma), `tolerance`, `newton`, `max_iterations`, `max_halvings` | | of its solver |
    | `period_correction` | False | of "geometrically_exact": take the integrator's error of the period out of steps |
    | `step_tolerance` | None | error that a period may add, over L: each arm halves `dt` where needed |
    | `control_dt` | 0.02 | control period, s |
    | `dt` | 0.02/3 | solver's step, s; a whole number of them makes a control period |
    | `action_mode` | "torque" | or "residual_pd", "current", "voltage", see below |
    | `residual_share` | 0.7 | s of "residual_pd" |
    | `duration` | 4.0 | s |
    | `task` | "slew" | or "track": the target moves; "replay": every episode follows `motion` |
    | `reference` | None | for "track": angle (rad) over time, a table or TimeFunction; None: drawn each time; or what \
    it is drawn from, see below |
    | `motion` | None | for "replay", as in the options of reset; None: the paper's robot_arm_motion |
    | `reward` | {} | weights by name; with `change`: -|a_k - a_(k-1)|^2, what actions change by, 0 before the first |
    | `randomization` | {} | `payload`, `EI`, `damping`, `torque_constant` (or an amplifier's gain), `payload_inertia` \
    (besides `payload`), `hub_inertia`, and, where joints have them, `friction`, `backlash`, `motor_inertia`: \
    (low, high) factors on the nominal value |
    | `observation` | "full" | or "measured", or names of entries in the order wanted, see below |
    | `history` | 1 | the last so many observations in one, the oldest first |
    | `sensors` | {} | `noise`, `delay`, `strain_gauges`, `encoders`, `accelerometer`, `camera`, see below |
    | `actuator` | {} | `lag`, `delay`, `jitter`, `saturation`, `viscous`, `coulomb`, see below |
    | `cost` | None | `deflection` (over L), `strain`: limits beyond which a period costs 1, see below |
    | `keep_out` | None | shapes that the arm is to stay out of, see below |
    | `pushes` | None | `wait`, `force`, `lasting`, `until`: forces on the tip at random times, see below |
    | `payload_change` | None | `time`, `factor`, `gripped`: a payload gripped or let go, see below |
    | `success` | {} | bounds `position` (rad), `speed` (of the tip's angle less the target's, rad/s), `vibration` \
    (1/s), `hold` (s); `once`: a success stays one; `paid`: bounds not given are none, and settle pays \
    1 / (1 + r^4), r^2 the sum of squares of what is bound over its bound |
    | `turns` | "exact" | or "any": the target is met at any number of whole turns from it |
    | `starts` | {} | ranges that starts are drawn from: `angles` [(low, high)], `target` (low, high) rad; `absolute`: \
    target angles as they stand, not from where the arm starts |
    | `initial_vibration` | 0.0 | largest initial tip deflection of the first mode, over L |
    | `joint_limits` | the arm's | [(low, high)] rad of the hub angle; None: none |
    | `gravity` | None | (x, y), m/s^2 |
    | `info_level` | "standard" | or "full", or "numbers": without words, for libraries that make tensors of it |
    | `render_mode` | None | "rgb_array" or "human" |
    | `max_episode_steps` | None | control periods; single: Gymnasium's `TimeLimit`, which states do not carry |

    Formulations, with what an environment takes where nothing is said: "elastica" (`nodes` 4, `dt` 0.02/3 s,
    `tolerance` 1e-5), "geometrically_exact" (`elements` 3, `order` 2, `dt` 0.0025 s, `tolerance` 1e-6) and
    "floating_frame" (`segments` 2, `dt` 0.0025 s, or with `modes`, alone or beside `segments`, 0.005 s, `tolerance`
    1e-6). The step is made shorter where it does not divide `control_dt`. All options are those of
    `flexarm_env.Settings`; why these: docs/results/default_settings.md.

    make_vec also takes `autoreset_mode` ("NextStep", the default, "SameStep", "Disabled") and `threads` (as many as
    there are processors, one for each 128 arms at most).

    "residual_pd": torque = k (goal - angle) - d rate + s tau a, within +-tau, with k = tau / (pi/4), d = 2 sqrt(k I),
    s `residual_share` and the target angle as goal. Where the arm's joints
    are not ideal (`Arm.joints`), angle and rate are those of the motors. "current" and "voltage" need a `Motor` in each
    joint: the torque is r k i, or r k (V - r k_e w) / R at the rate w of the motor over the ratio r, within the limits
    of current and torque, which are looked at at each period's start; back-emf acts throughout.

    Sensors: `noise` is a standard deviation, one share of the scale for all entries, or a dict by entry (the names
    above), each in its unit; `delay` a whole number of control periods, s, or (low, high): drawn for each episode;
    `strain_gauges` places along the link from 0 (root) to 1 (tip), or tables. `encoders` is a table (`counts`, `side`,
    `rate_frequency`; {}: ideal), which then says `hub_sin`, `hub_cos` and `hub_rate`; `accelerometer` and `camera`
    (`period`) tables that add their entries before the gauges'. Each may have `gain`, `bias`, `noise`, `low_pass`
    (`frequency`, `order`, `damping`), `quantum` and `delay`: docs/tutorials/sensors.md, `flexarm_env.sensors`. Those of
    the arm itself hold where `observation` is not "full" and nothing else is said. A `gyroscope` is one of space.

    Actuator: `lag` is the time constant of the motor, s (its torque acts by its mean over each solver's step, nearly so
    where it reaches its limit); `delay` a whole number of solver's steps, s, or (low, high): drawn for each episode;
    `jitter` the most that is added to it, s, drawn for each period in whole steps; `saturation` a share of the torque
    limit; `viscous` (N m s/rad) and `coulomb` (N m) friction is added to what the arm's joints have
    (`Joint.friction_viscous`, `friction_coulomb`): it sticks, and sets no limit to `dt`; its loss is part of
    `energy_dissipated`. What is left at its default costs nothing.

    Targets that move: `reference={"path": "swing", "width": (low, high), "period": (low, high)}` draws swings to and
    fro (rad, s), `{"path": "line", "behind": ..., "rate": ...}` targets that come from behind (rad) and run on at a
    rate (rad/s). What is left out is as usual. Success is position and speed: to catch is to have kept with the
    target, say with `success={"hold": 0.1, "speed": 0.1, "once": True}`.

    Cost: `info["cost"]` is 1 in a control period at whose end a limit is passed, by the tip's deflection or by the
    strain of the surface at one of the places 0, 1/4, 1/2 and 3/4 along the link, otherwise 0; `info["episode_cost"]`
    its sum.

    Keep out: `keep_out` is a shape, a list of them, or a table of `shapes`, `of` ("arm", the default, or "tip") and
    `margin` (m, 0). A shape is one of `flexarm_env.shapes` or a table: `shape` "half_space" (`point`, `normal`, which
    points to where the arm may be), "sphere" (`center`, `radius`), "box" (`center`, `sides`, `turn`) or, in space,
    "cylinder" (`start`, `end`, `radius`). `info["clearance"]` is the signed distance, m, of the nearest shape from the
    nearest of points along the arm (joints and tip among them, at most a sixteenth of its length apart, the root left
    out), negative within a shape; `info["penetration"]` how deep that point is in it; a period at whose end the
    clearance is below `margin` costs 1, as above. Nothing is pushed back: contact is not computed.

    Pushes: `wait` s (drawn) after the start, or after the last push, a force (`force`, N, drawn; in any direction of
    the plane) acts on the tip for `lasting` s (a control period); none begins after `until` s. `info["push"]` (2,) N.
    Times come at control instants. The pushes' work is part of `work`.

    Payload: at a control instant about `time` s (drawn) the payload becomes `factor` (drawn) times the nominal one,
    mass and inertia; `info["payload_mass"]`, kg. What is gripped rests (`gripped="resting"`): positions and momentum
    stay, velocities jump, and what the impact takes is part of `energy_dissipated`; or it moves with the tip
    (`gripped="moving"`). What is let go takes its own along. The energy that comes or goes with it is part of `work`.

    Prescribed motions do not go together with `cost`, `keep_out`, `pushes` and `payload_change`; `turns="any"`, where
    the term `distance` is paid in half turns and not in rad, not with "residual_pd" and "measured".

    Base: with `base` the root is not held. A rigid body whose centre of mass is at the hub carries the arm and floats
    freely, as a satellite does; the hub's torque acts + on link 1 and - on the base, and nothing else acts from
    outside: linear and angular momentum stay 0, to round-off. It starts at the origin with attitude 0. Angle and rate
    of the hub, its limits and its encoder are those of link 1's root against the base. The target stays where it is in
    the axes of the start; that of one link is the direction of the tip from the hub, wherever that is. Seven entries
    follow those above: `base_sin`, `base_cos` (of the attitude), `base_rate` (scale sqrt(tau pi/2 / J), J its inertia),
    `base_velocity_x`, `_y` (of the hub; scale s w_0 L, s the arm's share of all the mass), `base_offset_x`, `_y` (of
    the hub from where it started; scale 0.5 s L), vectors in the frame that turns with link 1's root. info has
    `base_attitude` (rad) and `base_position` (2,) m of the hub. The reward has a term more, `attitude`, -min(psi^2, 1)
    of the attitude psi in rad (weight 0.5); `success` may bound it (`attitude`, rad; usual: inf). Targets of two links
    and more are drawn from 0.3 L to 0.95 (L - 2 c), c the largest distance of the centre of mass of all from the hub.
    Joints have no angles that reach a target: "residual_pd", "measured", "track", "replay" and motions go without a
    base, and so do `pushes`, `payload_change`, `initial_vibration`, `gravity`, and a hub that is not ideal.
    `linearize(discrete=...)` is then the exponential of the continuous model.

    Joints that are not ideal: the torque acts on the motor, and with `info_level` "full" info has `motor_angle` and
    `motor_rate`, (N,) each, after the ratio.

    ## Options of reset

    `start` (hub angle, rad), `target` (rad), `vibration` (over L, where `initial_vibration` is given), and `motion`:
    the hub's angle is prescribed, the action ignored. A motion is the name of one ("robot_arm_motion",
    "robot_arm_motion_smooth", "spin_up"), a table of columns t, psi[, psi_dot[, psi_ddot]] as an array, a list of rows,
    a dict or a CSV file, or a `flexarm_env.TimeFunction`; with psi alone it is a C2 cubic spline, or with
    `interpolation="linear"` straight between rows, each of them a kink. The arm starts where the motion does, the
    episode ends where the motion ends, and nothing else about the arm changes; the target is where the motion ends.
    Motors are ideal then, and without controllers. The vector environment also takes `reset_mask`, an array of bools,
    and a list of one motion for each arm (None: an ordinary episode).

    ## Further methods

    `get_state()` and `set_state(state)`: go back to a state bit for bit (vector: lists, with `indices`).
    `linearize(discrete=None)`: the linear model at the present state (vector: of an arm by its index). The vector
    environment's `call(name, ..., indices=None)` gives what these give for each arm. `render()` of the vector
    environment is a tuple of pictures, or one window with the first 16 arms.

    ## Versions

    * v0: first version
    """

    kind = SLEW


class FlexibleArmVectorEnv(VectorArmEnv, VectorEnv[Array32, Array32, NDArray[Any]]):
    """Many FlexibleArm-v0 at once, each as :class:`FlexibleArmEnv` describes it."""

    kind = SLEW
