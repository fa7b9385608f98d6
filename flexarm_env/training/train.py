"""Train a policy with Stable-Baselines3: PPO, or with --algo sac, tqc, recurrent_ppo, gradient another.

    flexarm train --env FlexibleArm-v0
    flexarm train --env TwoLinkFlexArm-v0 --config configs/ppo/residual.yml
    flexarm train --env FlexibleArm-v0 --out runs/mine --resume

The run folder holds model.zip (the best on the validation episodes), vecnormalize.pkl where observations are
normalised, policy.npz (the same for NumPy alone), config.yml (resolved), run.json (arguments, versions, layout of the
observation, what it came to), learning_curve.csv and .png, tensorboard/ and checkpoints/. model.zip, vecnormalize.pkl
and the checkpoints are pickles, which can run any code when they are read: resume your own runs alone, and give
policy.npz to others.
"""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexarm_env.training import config as configs
from flexarm_env.training import episodes
from flexarm_env.training.arguments import parse
from flexarm_env.training.progress import Progress, finish, training_program
from flexarm_env.training.runs import OF_POLICY, Training, checkpoints, new_record, write_json, write_text


@dataclass(frozen=True, kw_only=True)
class Arguments(Training):
    """What `flexarm train` takes.

    Args:
        algo: "ppo", "sac", "tqc", "gradient" (through the arms, see gradient.py beside this), or "recurrent_ppo", whose
            policy stays a model.zip (policy.npz has no memory).
        config: file of hyper-parameters, RL Zoo format, or the name of one that comes with the package, such as robust;
            default configs/ALGO/default.yml, of tasks of the suite suite.yml.
    """

    algo: str = "ppo"

    @property
    def name(self) -> str:
        """The algorithm."""
        return self.algo


def train(arguments: Arguments) -> Any:
    """Train, and return what it came to (`Progress`). ValueError with a sentence for what is wrong."""
    folder, arguments = arguments.folder, arguments.begun("progress")
    config = configs.load(arguments.config, arguments.algo, arguments.env).lasting(arguments.n_timesteps)
    import torch

    torch.set_num_threads(arguments.threads)
    from flexarm_env.control import Setup
    from flexarm_env.sb3 import make_sb3_vec
    from flexarm_env.training import watch
    from flexarm_env.training.export_policy import UNEXPORTED, export

    kwargs = {**config.env_kwargs, **arguments.env_kwargs}
    judged = episodes.validation(arguments.env, kwargs)
    eval_env = episodes.make_episodes(arguments.env, arguments.eval_episodes, **judged)
    setup = Setup.of(eval_env)
    env = make_sb3_vec(arguments.env, config.n_envs, seed=arguments.seed, normalize=config.normalize or False, **kwargs)
    algorithm = configs.algorithm_class(config.algorithm)
    record = new_record(arguments, config.algorithm, kwargs, setup)
    if arguments.resume and checkpoints(folder):
        model, progress = watch.restore(folder, algorithm, env)
    else:
        with configs.fitting(config.algorithm):
            model = algorithm(env=env, seed=arguments.seed, device="cpu", **config.arguments())
        progress = Progress()
        if config.algorithm != "gradient":  # whose arms are spread already
            watch.start_staggered(model, arguments.seed)
        write_text(folder / "config.yml", configs.text_of(config, arguments.env))
        write_json(folder / "run.json", record)
    _log(model, folder, arguments)
    meta = {key: record[key] for key in OF_POLICY}
    watcher = watch.Watch(arguments, eval_env, meta, progress, config.n_timesteps)
    left = config.n_timesteps - model.num_timesteps
    if left > 0:
        try:
            model.learn(left, callback=watcher, reset_num_timesteps=False)
        except ValueError as error:
            if "found invalid values" not in str(error):  # torch's, of the actions' distribution
                raise
            what = f"training diverged after {model.num_timesteps} steps, the network's outputs are no numbers any more"
            raise ValueError(f"{folder}: {what}; take a smaller learning_rate, gamma or log_std_init") from error
    finish(folder, record, progress)
    if config.algorithm not in UNEXPORTED:
        export(folder)
    shutil.rmtree(folder / "checkpoints", ignore_errors=True)
    env.close()
    eval_env.close()
    return progress


def _log(model: Any, folder: Path, arguments: Arguments) -> None:
    """Where Stable-Baselines3 writes its own curves."""
    from importlib.util import find_spec

    from stable_baselines3.common.logger import configure

    wanted = arguments.tensorboard and find_spec("tensorboard") is not None
    model.set_logger(configure(str(folder / "tensorboard"), ["tensorboard"]) if wanted else configure(None, []))


def main(program: str = "flexarm train", words: Sequence[str] | None = None) -> int:
    """Run the command."""
    return training_program(program, train, parse(Arguments, program, __doc__, words))
