"""Model arms as MuJoCo's users do: chains of hinges, stepped in C by `mujoco.rollout` or as Gymnasium environments.

The chains omit all that the task does not need: they have no contacts, constraints, shapes or sensors. Tip positions
are computed from the recorded states, outside of the timed part.
"""

import dataclasses
import time
from typing import Any
from xml.etree import ElementTree

import gymnasium as gym
import mujoco
import mujoco.rollout
import numpy as np

from flexarm_env.exchange import Chain, calibrated, chain_modes, chain_of, mjcf
from flexarm_env.parameters import Arm
from flexarm_env.rigid import rigid_inertia
from flexarm_env.validation import Array

# an unstable run is a result here, not worth a line and a log file for each
mujoco.set_mju_user_warning(lambda message: None)

Case = dict[str, Any]
"""Settings of a MuJoCo chain.

Keys: springs (number per link), placement, fitted (to the first frequency), axes (hinges of a spring: "z", "xz" or
"xyz"), integrator, step (s).
"""


def chain(arm: Arm, case: Case) -> Chain:
    """Return the chain of rigid bodies for a case."""
    made = chain_of(dataclasses.replace(arm, joint_limits=None), case["springs"], case["placement"])
    axes = case.get("axes", "xyz")
    if axes != "xyz":
        # hinges for bending across the plane, and for torsion, are left out: rigid there
        kept = [
            dataclasses.replace(body, hinges=tuple(
                hinge for hinge in body.hinges if hinge.joint >= 0 or "xyz"[int(np.argmax(hinge.axis))] in axes
            )) for body in made.bodies
        ]  # fmt: skip
        made = dataclasses.replace(made, bodies=tuple(kept))
    return calibrated(made)[0] if case["fitted"] else made


def model_of(arm: Arm, case: Case, gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Any:
    """Return the compiled MuJoCo model of a case."""
    text = mjcf(chain(arm, case), gravity=gravity, timestep=case["step"], integrator=case["integrator"])
    root = ElementTree.fromstring(text)
    for parent in list(root.iter()):
        for geom in parent.findall("geom"):
            parent.remove(geom)
    sensors = root.find("sensor")
    assert sensors is not None
    root.remove(sensors)
    for motor in root.iter("motor"):
        motor.attrib.pop("ctrlrange", None)
    flag = root.find("option/flag")
    assert flag is not None
    flag.attrib.update({"constraint": "disable", "contact": "disable", "autoreset": "disable"})
    model = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
    model.opt.timestep = case["step"]
    return model


ROD = """<mujoco><option integrator="discrete" timestep="{step}" gravity="0 0 0" solver="Newton">
<flag contact="disable" autoreset="disable"/></option><worldbody><body name="hub"><joint name="joint0" axis="0 0 1"/>
<inertial pos="0 0 0" mass="1e-9" diaginertia="{hub} {hub} {hub}"/>
<flexcomp name="rod" type="direct" dim="1" point="{points}" element="{edges}" mass="{mass}" radius="{radius}">
<contact selfcollide="none"/><edge equality="true" solref="0.0005 1" solimp="0.9999 0.9999 0.001 0.5 2"/>
<elasticity young="{young}" poisson="0.3" damping="{tau}"/><pin id="0 1"/></flexcomp></body></worldbody>
<actuator><motor name="motor0" joint="joint0"/></actuator></mujoco>"""
"""MuJoCo model of a discrete elastic rod, the successor of the cable plugin.

The first edge is clamped to the hub. Stiff constraints preserve the edges' lengths.
"""


def rod_of(arm: Arm, springs: int, step: float) -> tuple[Any, str]:
    """Return a one-link arm with a uniform section as MuJoCo's elastic rod, and the name of the body at the tip.

    The first and the last edge are half as long as the others, so that the vertices, at which the rod bends, are the
    midpoints of equal pieces. The rod's round section has the link's EI.
    """
    (link,) = arm.links
    section = link.uniform
    assert section is not None
    places = np.array([0.0, *(np.arange(springs) + 0.5) / springs, 1.0]) * link.length
    edges = np.diff(places)
    # masses of vertices: half of each edge beside them
    masses = 0.5 * section.m * (np.append(edges, 0.0) + np.insert(edges, 0, 0.0))
    radius = 0.01 * link.length
    text = ROD.format(
        step=step, hub=float(arm.hub_inertia) + masses[1] * places[1] ** 2, tau=arm.tau_d, radius=radius,
        points=" ".join(f"{x:.12g} 0 0" for x in places), mass=link.mass, young=section.EI / (np.pi * radius**4 / 4.0),
        edges=" ".join(f"{i} {i + 1}" for i in range(springs + 1)),
    )  # fmt: skip
    model = mujoco.MjModel.from_xml_string(text)
    for i in range(2, springs + 2):
        model.body_mass[model.body(f"rod_{i}").id] = masses[i] + (arm.payload.mass if i == springs + 1 else 0.0)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model, f"rod_{springs + 1}"


def start_of(model: Any, angles: Array) -> Array:
    """Return the full physics state of an arm at rest with straight links and the given joint angles, rad."""
    data = mujoco.MjData(model)
    for k, angle in enumerate(angles):
        data.joint(f"joint{k}").qpos[:] = angle
    mujoco.mj_forward(model, data)
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    return state


def explicit_step(made: Chain) -> float:
    """Return the largest stable step of RK4, s: h omega < 2.8, and h 2 zeta omega < 2.8."""
    frequencies, ratios = chain_modes(made, clamped=False)
    omega = 2.0 * np.pi * frequencies
    return float(2.8 / (omega * np.maximum(1.0, 2.0 * ratios)).max())


class Rollouts:
    """Episodes of a model under torques that are constant in each control period, run by `mujoco.rollout`.

    torques (periods, episodes, joints): N m. starts (episodes, joints): rad. period: s. tip_body: name of the body at
    the tip; empty: the site "tip".
    """

    def __init__(self, model: Any, torques: Array, starts: Array, period: float, tip_body: str = "") -> None:
        self.model, self.period, self.tip_body = model, period, tip_body
        self.per = round(period / model.opt.timestep)
        self.control = np.ascontiguousarray(np.repeat(torques.transpose(1, 0, 2), self.per, axis=1))
        self.starts = np.array([start_of(model, angles) for angles in starts])

    def run(self, episodes: int, threads: int = 1, periods: int | None = None) -> tuple[Array, float, float]:
        """Run episodes; return tip positions (periods, episodes, 3), m, CPU time, s, and wall time, s."""
        steps = self.control.shape[1] if periods is None else periods * self.per
        count = len(self.control)
        # more arms than episodes repeat them
        chosen = np.arange(episodes) % count
        control, starts = np.ascontiguousarray(self.control[chosen, :steps]), self.starts[chosen]
        data = [mujoco.MjData(self.model) for _ in range(threads)]
        with mujoco.rollout.Rollout(nthread=threads) as rollout:
            cpu, wall = time.process_time(), time.perf_counter()
            states, _ = rollout.rollout(self.model, data, starts, control)
            cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        return self.tips(states[:, self.per - 1 :: self.per]), cpu, wall

    def tips(self, states: Array) -> Array:
        """Return tip positions (periods, episodes, 3), m, from states (episodes, periods, numbers)."""
        data, model = mujoco.MjData(self.model), self.model
        place = data.body(self.tip_body).xpos if self.tip_body else data.site("tip").xpos
        found = np.full((states.shape[1], states.shape[0], 3), np.nan)
        for e, k in np.ndindex(states.shape[:2]):
            data.qpos[:] = states[e, k, 1 : 1 + model.nq]
            if np.isfinite(data.qpos).all():
                mujoco.mj_kinematics(model, data)
                found[k, e] = place
        return found


class MujocoArm(gym.Env[Any, Any]):
    """MuJoCo chain as a minimal Gymnasium environment: one control period is one call of `mj_step`.

    The observation contains cosines and sines of the joint angles, their rates, and the tip's position and displacement
    per period. The reward is minus the distance of the tip from a target.
    """

    def __init__(self, model: Any, joints: int, period: float, limits: Array) -> None:
        self.model, self.data = model, mujoco.MjData(model)
        self.steps, self.limits = round(period / model.opt.timestep), np.asarray(limits, np.float64)
        names = [f"joint{k}" for k in range(joints)]
        self.places = np.array([model.jnt_qposadr[model.joint(name).id] for name in names])
        self.rates = np.array([model.jnt_dofadr[model.joint(name).id] for name in names])
        self.action_space = gym.spaces.Box(-1.0, 1.0, (joints,), np.float32)
        self.observation_space = gym.spaces.Box(-np.inf, np.inf, (3 * joints + 6,), np.float32)
        self.target = np.zeros(3)
        self.before = np.zeros(3)

    def _observe(self) -> tuple[Any, Array]:
        # step leaves the places of bodies as they were before it
        mujoco.mj_kinematics(self.model, self.data)
        angles, tip = self.data.qpos[self.places], self.data.site_xpos[0].copy()
        speed = tip - self.before
        self.before = tip
        parts = (np.cos(angles), np.sin(angles), self.data.qvel[self.rates], tip, speed)
        return np.concatenate(parts).astype(np.float32), tip

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """Reset the arm to rest."""
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_forward(self.model, self.data)
        return self._observe()[0], {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Advance by one control period."""
        self.data.ctrl[:] = self.limits * action
        mujoco.mj_step(self.model, self.data, self.steps)
        observation, tip = self._observe()
        distance = float(np.linalg.norm(tip - self.target))
        return observation, -distance, False, False, {"tip_position": tip}


def judged(policy: Any, env: Any, model: Any, seed: int) -> tuple[bool, float, float]:
    """Run an episode of `FlexibleArm-v0` under a policy, in the environment and on a MuJoCo chain.

    The policy observes the chain through the documented entries: sine and cosine of the hub angle and its rate, the
    tip's deflection and its rate, and the target minus the tip angle.

    Returns:
        Success in MuJoCo (0.5 s within 1 degree, with the deflection's rate below 0.01 L/s). Largest distance of the
        two tips, over L. Success in the environment, 1.0 or 0.0.
    """
    observation, info = env.reset(seed=seed)
    plan = env.unwrapped.plan
    arm, target = plan.arm, float(info["target"])
    hub = float(np.arctan2(observation[0], observation[1]))
    rate_scale = float(np.sqrt(arm.torque_limits[0] * (np.pi / 2.0) / rigid_inertia(arm, np.zeros((1, 1)))[0, 0, 0]))
    data, length, period = mujoco.MjData(model), arm.total_length, plan.period
    data.joint("joint0").qpos[:] = hub
    steps = round(period / model.opt.timestep)
    before, calm, apart, success = None, 0, 0.0, False
    angle_before, turns = hub, 0.0
    for _ in range(round(4.0 / period)):
        mujoco.mj_forward(model, data)
        x, y = data.site("tip").xpos[:2]
        angle, own_rate = float(data.joint("joint0").qpos[0]), float(data.joint("joint0").qvel[0])
        deflection = (y * np.cos(angle) - x * np.sin(angle)) / length
        # unwrapped tip angle
        polar = float(np.arctan2(y, x))
        turns += 2.0 * np.pi * np.round((angle_before - polar - turns) / (2.0 * np.pi))
        angle_before = polar + turns
        # rate of the deflection: velocity of the tip across the hub's tangent, less that of the turning frame
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, model.site("tip").id, velocity, 0)
        vx, vy = velocity[3:5]
        along = x * np.cos(angle) + y * np.sin(angle)
        rate = (vy * np.cos(angle) - vx * np.sin(angle) - own_rate * along) / length
        error = target - angle_before
        seen = np.array([
            np.sin(angle), np.cos(angle), own_rate / rate_scale, deflection / 0.1, rate / (0.3 * rate_scale), error,
        ])  # fmt: skip
        calm = calm + 1 if abs(error) < np.deg2rad(1.0) and abs(rate) < 0.01 else 0
        success = calm * period >= 0.5
        if before is not None:
            apart = max(apart, float(np.hypot(*(np.array([x, y]) - before))) / length)
        action = policy.act(np.clip(seen, -10.0, 10.0).astype(np.float32))
        data.ctrl[:] = arm.torque_limits[0] * np.clip(action, -1.0, 1.0)
        mujoco.mj_step(model, data, steps)
        observation, _, _, _, info = env.step(policy.act(observation))
        before = info["tip_position"]
    return success, apart, float(info["is_success"])
