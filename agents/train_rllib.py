"""Train a policy with PPO of Ray RLlib, on one machine or on a cluster.

    make setup-ray                                               # .venv-ray, once
    .venv-ray/bin/python -m agents.train_rllib --env FlexibleArm-v0 --runners 2
    .venv-ray/bin/python -m agents.train_rllib --env TwoLinkFlexArm-v0 --address auto --runners 30 --envs-per-runner 16
    .venv-ray/bin/python -m agents.train_rllib --out runs/mine --resume

Hyper-parameters are those of configs/ppo/default.yml, as for Stable-Baselines3. The run folder has the layout of
`agents.train_ppo`: policy.npz (the best on the validation episodes, for NumPy alone), config.yml, run.json,
learning_curve.csv and .png, and tensorboard/. The run folder also contains module.pt (weights of that policy's
RLModule) and, until the run has finished, checkpoints/ (each with RLlib's own checkpoint in algorithm/).
"""

import contextlib
import math
import pickle
import shutil
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agents.rllib import cluster, setup
from flexarm_env import validation as check
from flexarm_env.training import config as configs
from flexarm_env.training import episodes
from flexarm_env.training.arguments import parse
from flexarm_env.training.progress import Progress, after, bar, finish, training_program, write_curve
from flexarm_env.training.runs import (
    OF_POLICY,
    Training,
    checkpoints,
    fail,
    new_checkpoint,
    new_record,
    restored,
    write_json,
    write_text,
    write_whole,
)

FAILED = 1


@dataclass(frozen=True, kw_only=True)
class Arguments(Training):
    """Arguments of `python -m agents.train_rllib`.

    Args:
        out: run folder; default runs/rllib-ENV-SEED.
        resume: continue from the run folder's last checkpoint, or start if it has none yet. All other flags, except
            those of processes, are then those of the run.
        address: HOST:PORT of a Ray cluster's head, or auto for the cluster of this machine; default: Ray is started on
            this machine.
        runners: number of processes that step environments, one processor each; 0: the training process steps them.
        envs_per_runner: number of environments that a runner steps together; default the config's n_envs divided
            among the runners.
        learners: number of processes that update the network, one processor each; 0: the training process does it.
        sampler: native (whole arrays a step) or rllib (RLlib's own loop over environments).
        threads: number of torch threads in the training process; runners and learners have one each.
        verbose: show Ray's own messages.
    """

    address: str | None = None
    runners: int = 2
    envs_per_runner: int | None = None
    learners: int = 0
    sampler: str = "native"
    checkpoint_every: int = 65_536
    verbose: bool = False

    @property
    def name(self) -> str:
        """Name of the library."""
        return "rllib"


PROCESSES = ("address", "runners", "envs_per_runner", "learners", "sampler", "threads", "progress", "verbose")
"""Names of arguments that a resumed run reads from the command line, since the machine may have changed."""


def train(arguments: Arguments) -> Progress:
    """Train a policy and return the run's progress. ValueError describes invalid arguments."""
    arguments = arguments.begun(*PROCESSES, algorithm="rllib_ppo")
    cluster.need_ray()
    config = setup.load(arguments.config, arguments.env).lasting(arguments.n_timesteps)
    kwargs = {**config.env_kwargs, **arguments.env_kwargs}
    _check(arguments, kwargs)
    judged = episodes.validation(arguments.env, kwargs, episodes.user_keywords(arguments.env, arguments.env_kwargs))
    eval_env = episodes.make_episodes(arguments.env, arguments.eval_episodes, **judged)
    setup.split(config, arguments.runners, arguments.learners, arguments.envs_per_runner)
    cluster.connect(arguments.address, arguments.runners + arguments.learners, arguments.verbose)
    import torch

    torch.set_num_threads(arguments.threads)
    algorithm = setup.build(
        setup.algorithm_config(
            arguments.env, config, kwargs, seed=arguments.seed, runners=arguments.runners, learners=arguments.learners,
            envs_per_runner=arguments.envs_per_runner, native=arguments.sampler == "native",
        )
    )  # fmt: skip
    run = Run(arguments, config, kwargs, algorithm, eval_env)
    try:
        run.begin()
        run.learn()
        run.finish()
    finally:
        run.close()
    return run.state


class Run:
    """Training run: the algorithm, the progress, and the folder."""

    def __init__(
        self, arguments: Arguments, config: configs.Config, kwargs: dict[str, Any], algorithm: Any, eval_env: Any
    ) -> None:
        """Store the parts of a run and begin the run's record."""
        from flexarm_env.control import Setup

        self.arguments, self.config, self.algorithm, self.eval_env = arguments, config, algorithm, eval_env
        self.folder, self.state, self.steps, self.workers_cpu = arguments.folder, Progress(), 0, 0.0
        self.record = new_record(arguments, "rllib_ppo", kwargs, Setup.of(eval_env), runners=self._places())
        self.record["asked"] = episodes.user_keywords(arguments.env, arguments.env_kwargs)
        self.meta = {key: self.record[key] for key in OF_POLICY if key in self.record}  # no controller inside
        self._board: Any = None
        self._bar: Any = None

    # --- begin and end -------------------------------------------------------------------------------
    def begin(self) -> None:
        """Restore the last checkpoint, or write the files of a new run."""
        arguments = self.arguments
        if arguments.resume and checkpoints(self.folder):
            self._restore()
        else:
            self._sync()
            write_text(self.folder / "config.yml", configs.text_of(self.config, arguments.env))
            write_json(self.folder / "run.json", self.record)
        if arguments.tensorboard:
            from tensorboardX import SummaryWriter

            self._board = SummaryWriter(str(self.folder / "tensorboard"), purge_step=self.steps)
        self._bar = bar(arguments.progress, self.config.n_timesteps, self.steps)

    def _places(self) -> dict[str, int]:
        """Return the nodes of the cluster and the initial number of runners on each."""
        import ray

        nodes = self.algorithm.env_runner_group.foreach_env_runner(
            lambda _: ray.get_runtime_context().get_node_id()[:8], local_env_runner=False
        )
        return {node: nodes.count(node) for node in sorted(set(nodes))}

    def finish(self) -> None:
        """Write the files of a finished run."""
        finish(self.folder, self.record, self.state)
        shutil.rmtree(self.folder / "checkpoints", ignore_errors=True)

    def close(self) -> None:
        """Stop the processes of this run."""
        for closing in (self._bar, self._board, self.eval_env):
            if closing is not None:
                closing.close()
        with contextlib.suppress(Exception):  # of a cluster that has gone
            self.algorithm.stop()

    # --- training ------------------------------------------------------------------------------------
    def learn(self) -> None:
        """Train to the end; evaluate and save between iterations."""
        arguments, state, total = self.arguments, self.state, self.config.n_timesteps
        evaluation = after(self.steps - 1, arguments.evaluate_every)
        checkpoint = after(self.steps, arguments.checkpoint_every)
        result: Mapping[str, Any] = {}
        while True:
            if (self.steps >= evaluation or self.steps >= total) and not state.judged(self.steps):
                evaluation = after(self.steps, arguments.evaluate_every)
                self.judge(result)
            if self.steps >= total or (arguments.stop_when_solved and state.solved is not None):
                return
            if self.steps >= checkpoint:
                checkpoint = after(self.steps, arguments.checkpoint_every)
                self.save()
            wall, cpu = time.perf_counter(), time.process_time()
            result = self.algorithm.train()
            state.wall_s += time.perf_counter() - wall
            state.cpu_s += time.process_time() - cpu
            self._note(result)

    def _note(self, result: Mapping[str, Any]) -> None:
        """Store the counts of an iteration, unless all runners were lost in it and are being restarted."""
        runners = result.get("env_runners", {})
        self.steps = max(self.steps, int(runners.get("num_env_steps_sampled_lifetime", 0)))
        spent = float(runners.get("cpu_s", 0.0))
        if self.arguments.runners > 0 and spent > self.workers_cpu:
            self.state.cpu_s += spent - self.workers_cpu
            self.workers_cpu = spent
        self._bar.update(self.steps - self._bar.n)
        if self._board is not None:
            for name, value in _curves(result).items():
                self._board.add_scalar(name, value, self.steps)

    def judge(self, result: Mapping[str, Any]) -> None:
        """Evaluate on the validation episodes, record the result, and save the policy if it is the best so far."""
        from agents.rllib.module import deviation, numpy_policy
        from flexarm_env.training.export_policy import save

        module, state = self.module, self.state
        policy = numpy_policy(module, self.meta)
        found = _curves(result)
        better = state.add(
            episodes.run(self.eval_env, policy, episodes.VALIDATION), self.steps, self.arguments.solved_at,
            self.arguments.best_by, train_return=found.get("rollout/ep_rew_mean", float("nan")), std=deviation(module),
            learning_rate=found.get("train/learning_rate", float("nan")),
        )  # fmt: skip
        if better:
            import torch

            weights = module.state_dict()
            write_whole(self.folder / "module.pt", lambda part: torch.save(weights, part))
            save(policy, self.folder / "policy.npz")
        write_curve(self.folder / "learning_curve.csv", state.curve)
        row = state.curve[-1]
        if self._board is not None:
            for name in ("success_rate", "settling_mean", "settling_median", "return_mean"):
                self._board.add_scalar(f"validation/{name}", row[name], self.steps)
        self._bar.set_postfix(success=f"{row['success_rate']:.2f}", settling=f"{row['settling_median']:.2f} s")

    @property
    def module(self) -> Any:
        """Return the network in this process, with the learners' weights."""
        return self.algorithm.get_module()

    def _sync(self) -> None:
        """Copy the learners' weights to all runners, the one in this process included."""
        self.algorithm.env_runner_group.sync_weights(
            from_worker_or_learner_group=self.algorithm.learner_group, inference_only=True
        )

    # --- checkpoints ---------------------------------------------------------------------------------
    def save(self) -> None:
        """Save all data that resuming the run requires."""
        with new_checkpoint(self.folder, self.steps, ("policy.npz", "module.pt")) as part:
            self.algorithm.save_to_path((part / "algorithm").absolute())
            with (part / "state.pkl").open("wb") as file:
                pickle.dump({"progress": self.state, "steps": self.steps}, file)

    def _restore(self) -> None:
        """Restore the last readable checkpoint."""

        def read(path: Path, kept: dict[str, Any]) -> tuple[Progress, int]:
            self.algorithm.restore_from_path((path / "algorithm").absolute())
            return kept["progress"], kept["steps"]

        self.state, self.steps = restored(self.folder, read)
        self._sync()


def _curves(result: Mapping[str, Any]) -> dict[str, float]:
    """Return the scalars for TensorBoard under Stable-Baselines3's names."""
    runners, learner = result.get("env_runners", {}), result.get("learners", {}).get("default_policy", {})
    timers = result.get("timers", {})
    found = {
        "rollout/ep_rew_mean": runners.get("episode_return_mean"),
        "rollout/ep_len_mean": runners.get("episode_len_mean"),
        "train/learning_rate": learner.get("default_optimizer_learning_rate"),
        "train/value_loss": learner.get("vf_loss"),
        "train/policy_gradient_loss": learner.get("policy_loss"),
        "train/entropy": learner.get("entropy"),
        "train/explained_variance": learner.get("vf_explained_var"),
        "time/sampling": timers.get("env_runner_sampling_timer"),
        "time/learning": timers.get("learner_update_timer"),
    }
    return {name: float(value) for name, value in found.items() if value is not None and math.isfinite(value)}


def _check(arguments: Arguments, env_kwargs: Mapping[str, Any]) -> None:
    """Raise ValueError with a sentence for an impossible number or word."""
    for name in ("runners", "learners"):
        check.integer(name, getattr(arguments, name), minimum=0)
    if arguments.envs_per_runner is not None:
        check.integer("envs_per_runner", arguments.envs_per_runner, minimum=1)
    check.choice("sampler", arguments.sampler, ("native", "rllib"))
    mode = env_kwargs.get("autoreset_mode", "NextStep")
    if mode != "NextStep":
        raise ValueError(f"env_kwargs.autoreset_mode = {mode!r}: must be 'NextStep', which is what RLlib takes")


def main() -> int:
    """Run the command."""
    arguments = parse(Arguments, "python -m agents.train_rllib", __doc__)
    try:
        return training_program("python -m agents.train_rllib", train, arguments)
    except Exception as error:
        if not type(error).__module__.startswith("ray."):
            raise
        again = f"go on with: python -m agents.train_rllib --out {arguments.folder} --resume"
        fail(f"Ray lost a process that the run cannot do without ({type(error).__name__}); {again}")
        return FAILED


if __name__ == "__main__":
    sys.exit(main())
