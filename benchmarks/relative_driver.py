"""Drive shamilmamedov/flexible_arm, from a folder with its files, in an interpreter with CasADi and Gymnasium.

The program reads one line of JSON, {"elements", "torques" (T, 3), "state" (joint angles)}, and writes one line: the tip
positions (T, 3), m, and the processor time of the steps, s. The program runs the environment's simulator and computes
the tip, which is the environment's `step` without distance and observation. `step` itself cannot be used: with the
default observation, the true state, `step` raises an IndexError (commit fe633ce). Imports for planning and drawing are
omitted.
"""

import json
import os
import sys
import time
from typing import Any
from unittest.mock import MagicMock

import numpy as np


def main(folder: str) -> None:
    """Answer each request on standard input until the input ends."""
    for name in ("pinocchio", "pinocchio.visualize", "acados_template", "panda3d_viewer", "torch"):
        sys.modules[name] = MagicMock()
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # CasADi's warnings
    os.chdir(folder)
    sys.path.insert(0, folder)
    from envs.flexible_arm_env import FlexibleArmEnv, FlexibleArmEnvOptions  # type: ignore[import-not-found]

    made: dict[int, Any] = {}
    for line in sys.stdin:
        asked = json.loads(line)
        n, torques = asked["elements"], np.array(asked["torques"])
        if n not in made:
            made[n] = FlexibleArmEnv(FlexibleArmEnvOptions(n_seg=n, sim_noise_R=np.zeros((9, 9)), sim_time=30.0))
        model, simulator = made[n].model_sym, made[n].simulator
        state = np.zeros(model.nx)
        state[model.qa_idx] = asked["state"]
        simulator.reset(x0=state)
        tips, begun = [], time.process_time()
        for k, torque in enumerate(torques, 1):
            simulator.step(torque)
            tips.append(np.array(model.p_ee(simulator.x[k, : model.nq])).ravel().tolist())
        took = time.process_time() - begun
        print(json.dumps({"tips": tips, "cpu_s": took}), file=answers, flush=True)
