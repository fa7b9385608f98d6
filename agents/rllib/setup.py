"""Set up RLlib's PPO from the same files of hyper-parameters as Stable-Baselines3."""

import contextlib
from pathlib import Path
from typing import Any

from flexarm_env import validation as check
from flexarm_env.training import config as configs

DEFAULTS: dict[str, Any] = {
    "n_envs": 64, "n_steps": 128, "batch_size": 1024, "n_epochs": 10, "gamma": 0.99, "gae_lambda": 0.95,
    "learning_rate": 3e-4, "clip_range": 0.2, "ent_coef": 0.0, "vf_coef": 0.5, "max_grad_norm": 0.5,
}  # fmt: skip
"""Hyper-parameters used if the file does not set them."""

KEYS = (*DEFAULTS, "n_timesteps", "policy", "policy_kwargs")
NETWORK = {"net_arch": [64, 64], "log_std_init": 0.0, "activation_fn": None}


def load(path: Path | None, env_id: str) -> configs.Config:
    """Read the hyper-parameters of an environment. ValueError names file, key and rule."""
    config = configs.load(path, "ppo", env_id, KEYS)
    where = f"{path or configs.default_path('ppo', env_id)}: {env_id}"
    check.choice(f"{where}.policy", config.text.get("policy", "MlpPolicy"), ("MlpPolicy",))
    for key in ("clip_range", "ent_coef"):
        check.number(f"{where}.{key}", config.text.get(key, DEFAULTS[key]))
    network = config.arguments().get("policy_kwargs", {})
    check.known_keys(f"{where}.policy_kwargs", network, NETWORK, "key of rllib")
    hidden = network.get("net_arch", NETWORK["net_arch"])
    if not isinstance(hidden, list | tuple) or not hidden or not all(isinstance(n, int) and n > 0 for n in hidden):
        raise ValueError(f"{where}.policy_kwargs.net_arch = {hidden!r}: must be a list of positive whole numbers")
    check.number(f"{where}.policy_kwargs.log_std_init", network.get("log_std_init", 0.0))
    activation = getattr(network.get("activation_fn"), "__name__", "Tanh")
    if activation not in ("Tanh", "ReLU"):
        raise ValueError(f"{where}.policy_kwargs.activation_fn = {activation}: must be nn.Tanh or nn.ReLU")
    return config


def split(config: configs.Config, runners: int, learners: int, envs_per_runner: int | None) -> tuple[int, int, int]:
    """Return the number of environments per runner, and the steps and the minibatch size of each learner.

    Raises ValueError if the environments or the batches cannot be divided evenly.
    """
    value = DEFAULTS | dict(config.text)
    value["n_envs"] = int(float(value["n_envs"]))
    sources, updates = max(1, runners), max(1, learners)
    if envs_per_runner is None:
        if value["n_envs"] % sources:
            raise ValueError(
                f"runners = {runners}: must divide n_envs = {value['n_envs']}, or say how many by --envs-per-runner"
            )
        envs_per_runner = value["n_envs"] // sources
    batch = envs_per_runner * sources * value["n_steps"]
    for name, total in (("n_envs n_steps", batch), ("batch_size", value["batch_size"])):
        if total % updates:
            raise ValueError(f"learners = {learners}: must divide {name} = {total}")
    return envs_per_runner, batch // updates, min(value["batch_size"], batch) // updates


def algorithm_config(
    env_id: str, config: configs.Config, env_kwargs: dict[str, Any], *, seed: int, runners: int, learners: int,
    envs_per_runner: int | None, native: bool,
) -> Any:  # fmt: skip
    """Return RLlib's PPOConfig (new API stack) for an environment and its hyper-parameters."""
    import gymnasium as gym
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.core.rl_module.rl_module import RLModuleSpec

    from agents.rllib.module import FreeDeviationModule
    from agents.rllib.runner import NativeEnvRunner

    value = DEFAULTS | dict(config.text)
    each, batch, minibatch = split(config, runners, learners, envs_per_runner)
    network = NETWORK | config.arguments().get("policy_kwargs", {})
    relu = getattr(network["activation_fn"], "__name__", "Tanh") == "ReLU"
    rate: Any = config.arguments().get("learning_rate", value["learning_rate"])
    if isinstance(rate, configs.Linear):
        rate = [[0, rate.first], [config.n_timesteps, 0.0]]
    model = {
        "fcnet_hiddens": list(network["net_arch"]), "fcnet_activation": "relu" if relu else "tanh",
        "vf_share_layers": False, "free_log_std": True, "log_std_init": float(network["log_std_init"]),
    }  # fmt: skip
    setup = (
        PPOConfig()
        .environment(f"flexarm_env:{env_id}", env_config={**env_kwargs, "threads": 1})
        .env_runners(
            num_env_runners=runners, num_envs_per_env_runner=each, rollout_fragment_length=int(value["n_steps"]),
            gym_env_vectorize_mode=gym.VectorizeMode.VECTOR_ENTRY_POINT,
        )
        .learners(num_learners=learners)
        .training(
            train_batch_size_per_learner=batch, minibatch_size=minibatch, num_epochs=int(value["n_epochs"]),
            gamma=float(value["gamma"]), lambda_=float(value["gae_lambda"]), lr=rate,
            clip_param=float(value["clip_range"]), entropy_coeff=float(value["ent_coef"]),
            vf_loss_coeff=float(value["vf_coef"]), vf_clip_param=float("inf"), use_kl_loss=False,
            grad_clip=float(value["max_grad_norm"]), grad_clip_by="global_norm",
        )
        .rl_module(rl_module_spec=RLModuleSpec(module_class=FreeDeviationModule, model_config=model))
        .fault_tolerance(
            restart_failed_env_runners=True, delay_between_env_runner_restarts_s=1.0,
            env_runner_health_probe_timeout_s=2.0,
        )
        .debugging(seed=seed, log_level="ERROR")
    )  # fmt: skip
    if native:
        setup = setup.env_runners(env_runner_cls=NativeEnvRunner)
    return setup


def build(setup: Any) -> Any:
    """Build the algorithm of an RLlib config, and remove RLlib's empty log folder."""
    algorithm = setup.build_algo()
    with contextlib.suppress(OSError):
        Path(algorithm.logdir).rmdir()
    return algorithm
