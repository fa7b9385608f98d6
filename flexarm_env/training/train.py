"""Train a policy by PPO (Stable-Baselines3) or by another algorithm (--algo).

    flexarm train --env FlexibleArm-v0
    flexarm train --env TwoLinkFlexArm-v0 --config configs/ppo/residual.yml
    flexarm train --env FlexibleArm-v0 --out runs/mine --resume

The run folder contains these files:

    model.zip            the model with the best result on the validation episodes
    vecnormalize.pkl     its VecNormalize statistics, if observations are normalized
    policy.npz           the same policy, for NumPy alone
    config.yml           hyper-parameters and environment keywords of the run, changes by flags included
    run.json             arguments, versions, layout of the observation, results
    learning_curve.csv   learning curve; .png is its figure
    tensorboard/, checkpoints/

model.zip, vecnormalize.pkl and the checkpoints are pickles, which can execute any code when they are loaded. Resume
only your own runs, and share a policy as policy.npz.
"""

import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from flexarm_env import arms
from flexarm_env import validation as check
from flexarm_env.control.around import Inside, linear_law, restarting
from flexarm_env.control.base import RESIDUAL_SHARE
from flexarm_env.rigid import timescales
from flexarm_env.training import blas, episodes
from flexarm_env.training import config as configs
from flexarm_env.training.arguments import parse
from flexarm_env.training.progress import Progress, finish, training_program
from flexarm_env.training.runs import OF_POLICY, Training, checkpoints, new_record, read_run, write_json, write_text

NEEDED = {"torch": "torch", "stable_baselines3": "stable-baselines3", "yaml": "pyyaml", "tqdm": "tqdm"}
"""Modules that training requires, each with its package in the extra `train`."""


@dataclass(frozen=True, kw_only=True)
class Arguments(Training):
    """Arguments of `flexarm train`.

    Args:
        algo: algorithm: "ppo", "sac", "tqc", "gradient" (gradients through the simulation), or "recurrent_ppo" (saved
            only as model.zip, because policy.npz cannot store a recurrent network).
        config: file of hyper-parameters in RL Zoo's format, or the name of such a file of the package, for example
            robust; default configs/ALGO/default.yml, or suite.yml for tasks of the suite.
        around: classical controller whose torque is added to the network's torque: for example pd, or pd@FILE with
            gains from a file of `flexarm tune`. By default the config names the controller; most configs name no
            controller.
        share: largest torque of the network with --around, as a fraction of the torque limits; default 0.7.
    """

    algo: str = "ppo"
    around: str = ""
    share: float | None = None

    @property
    def name(self) -> str:
        """Name of the learning algorithm."""
        return self.algo


def train(arguments: Arguments) -> Any:
    """Train a policy; return its `Progress`. Raises ValueError for invalid arguments."""
    _check_installed()
    folder, arguments = arguments.folder, arguments.begun("progress")
    config = configs.load(arguments.config, arguments.algo, arguments.env)
    config = config.changed(arguments.set, arguments.env).lasting(arguments.n_timesteps)
    import torch

    torch.set_num_threads(arguments.threads)
    blas.set_threads(arguments.threads)
    from flexarm_env.control import Setup
    from flexarm_env.sb3 import make_sb3_vec
    from flexarm_env.training import watch
    from flexarm_env.training.export_policy import UNEXPORTED, export

    config, chosen = fitted(config, arguments)
    kwargs = {**config.env_kwargs, **chosen, **arguments.env_kwargs}
    if config.algorithm == "gradient" and episodes.LENGTHS in kwargs:
        what = "must be left out with --algo gradient, whose arms share one length"
        raise check.InvalidValue("env_kwargs.lengths", kwargs[episodes.LENGTHS], what)
    asked = episodes.user_keywords(arguments.env, {**chosen, **arguments.env_kwargs})
    if arguments.resume:  # among them what was chosen for the arm at the run's start
        asked = read_run(folder).get("asked", asked)
    judged = episodes.validation(arguments.env, kwargs, asked)
    eval_env = episodes.make_episodes(arguments.env, arguments.eval_episodes, **judged)
    setup = Setup.of(eval_env)
    inside = controller_inside(config, arguments, eval_env)
    env = make_sb3_vec(
        arguments.env, config.n_envs, seed=arguments.seed, normalize=config.normalize or False, around=inside, **kwargs
    )
    algorithm = configs.algorithm_class(config.algorithm)
    record = new_record(arguments, config.algorithm, kwargs, setup, asked=asked, validation=judged)
    if inside is not None:
        record["around"] = inside.table()
        config = replace(config, around=inside.table())
    if arguments.resume and checkpoints(folder):
        model, progress = watch.restore(folder, algorithm, env)
        sys.stderr.write(f"{folder}: resuming at {model.num_timesteps} of {config.n_timesteps} steps\n")
    else:
        with configs.fitting(config.algorithm):
            model = algorithm(env=env, seed=arguments.seed, device="cpu", **config.arguments())
        progress = Progress()
        if config.algorithm != "gradient":  # whose arms are spread already
            watch.start_staggered(model, arguments.seed)
    write_text(folder / "config.yml", configs.text_of(replace(config, env_kwargs=kwargs), arguments.env))
    write_json(folder / "run.json", record)
    _log(model, folder, arguments)
    meta = {key: record[key] for key in OF_POLICY if key in record}
    watcher = watch.Watch(arguments, eval_env, meta, progress, config.n_timesteps)
    left = config.n_timesteps - model.num_timesteps
    if left > 0:
        try:
            model.learn(left, callback=watcher, reset_num_timesteps=False)
        except ValueError as error:
            if "found invalid values" not in str(error):  # torch's, of the actions' distribution
                raise
            what = f"training diverged after {model.num_timesteps} steps, the network's outputs are not finite"
            raise ValueError(f"{folder}: {what}; take a smaller learning_rate, gamma or log_std_init") from error
    finish(folder, record, progress)
    if config.algorithm not in UNEXPORTED:
        export(folder)
    _keep_last(folder, model, progress)
    env.close()
    eval_env.close()
    return progress


def controller_inside(config: configs.Config, arguments: Arguments, env: Any) -> Inside | None:
    """Create the controller whose torque is added to the network's torque; flags override the config.

    Returns None if neither flags nor config name a controller. env: an environment of the training. Raises ValueError
    for an invalid or an unsupported controller.
    """
    table, share = config.around, arguments.share
    if arguments.around and not (arguments.resume and table):
        table = {"controller": arguments.around} | ({} if share is None else {"share": share})
    if not table:
        if share is not None:
            raise check.InvalidValue("--share", share, "requires --around CONTROLLER")
        return None
    if config.algorithm == "recurrent_ppo":
        what = "must be left out with --algo recurrent_ppo; wrap its environment (flexarm_env.around.AroundController)"
        raise check.InvalidValue("--around", table.get("controller"), what)
    if "gains" in table:
        found = Inside.read({"share": RESIDUAL_SHARE} | dict(table))
    else:
        name = check.needed("around", table, "controller", "must be given")
        found = Inside.of(check.text("around.controller", name), env, table.get("share"))
    own = restarting(found, env)
    if config.algorithm == "gradient":
        linear_law(own)
    return found


def fitted(config: configs.Config, arguments: Arguments) -> tuple[configs.Config, dict[str, Any]]:
    """Choose discount factor, episode duration and control period for the user's own arm (`rigid.timescales`).

    Values from flags or from a config file take precedence. The function prints the chosen values. Returns the config,
    and the chosen environment keywords.
    """
    given, text = arguments.env_kwargs, dict(config.text)
    named = given.get("arm")
    if named is None or named in arms.names() or arguments.config is not None:
        return config, {}
    arm = arms.resolve(named)
    if arm.torque_limits is None:
        return config, {}  # which the environment refuses by name
    times = timescales(arm, given.get("control_dt"))
    chosen = {"duration": times.duration, "control_dt": times.control_dt}
    chosen = {key: value for key, value in chosen.items() if key not in given}
    if "gamma" in text:
        text["gamma"] = times.gamma
    said = ", ".join(f"{key} = {value:g}" for key, value in {**chosen, "gamma": times.gamma}.items())
    sys.stderr.write(f"arm {arm.name}: a quarter turn takes at least {times.slew:.3g} s; {said}\n")
    return replace(config, text=text), chosen


def _check_installed() -> None:
    """Raise one ValueError that names all missing packages of the extra `train`."""
    missing = [name for module, name in NEEDED.items() if find_spec(module) is None]
    if missing:
        hint = "; the CPU build of PyTorch suffices: see PyTorch's instructions"
        raise ValueError(check.lacking("training", " ".join(missing), "train") + hint * ("torch" in missing))


def _keep_last(folder: Path, model: Any, progress: Progress) -> None:
    """Delete all checkpoints but one, from which the run can be extended.

    A checkpoint with a replay buffer is deleted as well, because it is large.
    """
    from flexarm_env.training import watch

    if hasattr(model, "replay_buffer"):
        shutil.rmtree(folder / "checkpoints", ignore_errors=True)
        return
    watch.save_checkpoint(folder, model, progress)
    for old in checkpoints(folder)[:-1]:
        shutil.rmtree(old)


def _log(model: Any, folder: Path, arguments: Arguments) -> None:
    """Configure the logger of Stable-Baselines3."""
    from stable_baselines3.common.logger import configure

    wanted = arguments.tensorboard and find_spec("tensorboard") is not None
    model.set_logger(configure(str(folder / "tensorboard"), ["tensorboard"]) if wanted else configure(None, []))


def main(program: str = "flexarm train", words: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    return training_program(program, train, parse(Arguments, program, __doc__, words))
