"""Stable-Baselines3 callback that evaluates a run, writes learning curve and checkpoints, and shows progress."""

import io
import pickle
import random
import time
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecMonitor, unwrap_vec_wrapper

from flexarm_env.around import AroundControllerVector
from flexarm_env.control.policy import AroundPolicy
from flexarm_env.training import episodes
from flexarm_env.training.policies import acting
from flexarm_env.training.progress import Progress, after, bar, write_curve
from flexarm_env.training.runs import Training, load_normaliser, new_checkpoint, restored, write_whole
from flexarm_env.training.starts import staggered


class Watch(BaseCallback):
    """Evaluate between rollouts, keep the best model, save checkpoints, and stop the run when the task is solved.

    Args:
        arguments: arguments of the run. env: the vector environment for evaluation. meta: metadata of the exported
            policy.
        progress: progress up to the checkpoint from which the run resumes. total: environment steps of the whole run.
    """

    def __init__(self, arguments: Training, env: Any, meta: dict[str, Any], progress: Progress, total: int) -> None:
        """Store the arguments and the state of the run."""
        super().__init__()
        self.arguments, self.folder = arguments, arguments.folder
        self.eval_env, self.meta, self.state, self.total = env, meta, progress, total
        self.inside: Any = None
        self._over = False
        self._wall = self._cpu = 0.0

    # --- clocks: what evaluation and checkpoints take is not training -------------------------------
    def _tick(self) -> None:
        """Add the time since the last call to the training time (wall-clock and CPU time, s)."""
        wall, cpu = time.perf_counter(), time.process_time()
        self.state.wall_s += wall - self._wall
        self.state.cpu_s += cpu - self._cpu
        self._wall, self._cpu = wall, cpu

    def _reset_clock(self) -> None:
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    # --- events --------------------------------------------------------------------------------------
    def _on_training_start(self) -> None:
        """Schedule evaluations and checkpoints and start the clock."""
        self._next_evaluation = after(self.num_timesteps - 1, self.arguments.evaluate_every)
        self._next_checkpoint = after(self.num_timesteps, self.arguments.checkpoint_every)
        self._bar = bar(self.arguments.progress, self.total, self.num_timesteps)
        self._reset_clock()

    def _on_rollout_start(self) -> None:
        """Evaluate or save a checkpoint if one is due, outside the training clock."""
        steps = self.num_timesteps
        self._tick()
        if steps >= self._next_evaluation:
            self._next_evaluation = after(steps, self.arguments.evaluate_every)
            if not self.state.judged(steps):  # a resumed run may have been judged here
                self.judge()
        if steps >= self._next_checkpoint:
            self._next_checkpoint = after(steps, self.arguments.checkpoint_every)
            save_checkpoint(self.folder, self.model, self.state)
        self._reset_clock()
        self._bar.update(steps - self._bar.n)

    def _on_step(self) -> bool:
        return not self._over

    def _on_training_end(self) -> None:
        """Evaluate the final model if it is not yet evaluated, and close the progress bar."""
        self._tick()
        if not self._over and not self.state.judged(self.num_timesteps):
            self.judge()
        self._bar.update(self.num_timesteps - self._bar.n)
        self._bar.close()

    # --- evaluation ----------------------------------------------------------------------------------
    def judge(self) -> None:
        """Evaluate on the validation episodes, record the result, and save the model after the best result so far."""
        policy = acting(self.model, self.meta, self.model.get_vec_normalize_env())
        if isinstance(policy, AroundPolicy):
            # one controller for all validations: in space it stores the rests at their targets
            policy.controller = self.inside = self.inside or policy.inside.made(self.eval_env)
        result = episodes.run(self.eval_env, policy, episodes.VALIDATION)
        state = self.state
        # standard deviation of the policy's noise, if it has one
        std = getattr(self.model.policy, "log_std", None)
        better = state.add(
            result, self.num_timesteps, self.arguments.solved_at, self.arguments.best_by,
            train_return=float(np.mean([e["r"] for e in self.model.ep_info_buffer or []] or [np.nan])),
            std=float(np.exp(std.detach().numpy()).mean()) if std is not None else float("nan"),
            learning_rate=float(self.model.lr_schedule(self.model._current_progress_remaining)),
        )  # fmt: skip
        if better:
            save_model(self.folder, self.model)
        row = state.curve[-1]
        self._over = self.arguments.stop_when_solved and state.solved is not None
        write_curve(self.folder / "learning_curve.csv", state.curve)
        for name in ("success_rate", "settling_mean", "settling_median", "return_mean"):
            self.logger.record(f"validation/{name}", row[name])
        self._bar.set_postfix(success=f"{row['success_rate']:.2f}", settling=f"{row['settling_median']:.2f} s")


def save_model(folder: Path, model: Any) -> None:
    """Write model.zip and, if observations are normalized, vecnormalize.pkl."""
    archive = io.BytesIO()  # PyTorch's own writer reports a full disk incomprehensibly
    model.save(archive)
    write_whole(folder / "model.zip", lambda part: part.write_bytes(archive.getbuffer()))
    normaliser = model.get_vec_normalize_env()
    if normaliser is not None:
        write_whole(folder / "vecnormalize.pkl", lambda part: normaliser.save(str(part)))


# ------------------------------------------------------------------ starts
def start_staggered(model: Any, seed: int) -> None:
    """Start the model's environments at times spread over an episode (see `starts.staggered`)."""
    venv = model.env
    venv.reset()
    observation = staggered(venv.unwrapped.env, seed)
    if observation is None:
        return
    normaliser = model.get_vec_normalize_env()
    if normaliser is not None:
        normaliser.old_obs = model._last_original_obs = observation
        observation = normaliser.normalize_obs(observation)
    model._last_obs = observation
    model._last_episode_starts = np.ones(venv.num_envs, bool)


# ------------------------------------------------------------------ checkpoints
def save_checkpoint(folder: Path, model: Any, progress: Progress) -> None:
    """Save the complete state of a run, so that a resumed run continues as if it had not been interrupted."""
    import torch

    with new_checkpoint(folder, model.num_timesteps, ("model.zip", "vecnormalize.pkl")) as part:
        save_model(part, model)
        if hasattr(model, "replay_buffer"):
            model.save_replay_buffer(part / "replay.pkl")
        state = {
            "progress": progress,
            "torch": torch.get_rng_state(),
            "numpy": np.random.get_state(),
            "python": random.getstate(),
            "envs": env_states(model.env),
            "returns": getattr(model.get_vec_normalize_env(), "returns", None),  # of which its own file has none
        }
        with (part / "state.pkl").open("wb") as file:
            pickle.dump(state, file)


def restore(folder: Path, algorithm: Any, env: Any) -> tuple[Any, Progress]:
    """Restore model, progress, environments and random generators from the last readable checkpoint."""
    import torch

    def read(path: Path, state: dict[str, Any]) -> tuple[Any, Progress]:
        """Load the model, its buffers, environments and generators from a checkpoint folder."""
        model = algorithm.load(path / "model.zip", env=env, force_reset=False, device="cpu")
        if (path / "replay.pkl").is_file():
            model.load_replay_buffer(path / "replay.pkl")
        set_env_states(model.env, state["envs"])
        normaliser = model.get_vec_normalize_env()
        if normaliser is not None or (path / "vecnormalize.pkl").is_file():
            kept = load_normaliser(path / "vecnormalize.pkl", model)  # after the reset of `set_env_states`
            normaliser.obs_rms, normaliser.ret_rms = kept.obs_rms, kept.ret_rms
            normaliser.returns = state["returns"]
        torch.set_rng_state(state["torch"])
        np.random.set_state(state["numpy"])
        random.setstate(state["python"])
        return model, state["progress"]

    return restored(folder, read)


MONITOR = ("episode_returns", "episode_lengths", "episode_count")


def env_states(venv: Any) -> dict[str, Any]:
    """Return the states of the environments and the counters of VecMonitor."""
    monitor = unwrap_vec_wrapper(venv, VecMonitor)
    counted = {k: np.copy(getattr(monitor, k)) for k in MONITOR}
    native = venv.unwrapped.env
    states = {"native": native.unwrapped.get_state(), "monitor": counted}
    return states | ({"around": native.memory()} if isinstance(native, AroundControllerVector) else {})


def set_env_states(venv: Any, states: dict[str, Any]) -> None:
    """Restore states that `env_states` returned."""
    venv.reset()
    venv.unwrapped.env.unwrapped.set_state(states["native"])
    if isinstance(venv.unwrapped.env, AroundControllerVector):
        venv.unwrapped.env.remember(states["around"])
    monitor = unwrap_vec_wrapper(venv, VecMonitor)
    for k, value in states["monitor"].items():
        setattr(monitor, k, value.copy() if value.ndim else value.item())
