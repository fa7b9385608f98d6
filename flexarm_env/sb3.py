"""Vector environments for Stable-Baselines3: an adapter from Gymnasium's VectorEnv to VecEnv.

    from flexarm_env.sb3 import make_sb3_vec
    env = make_sb3_vec("FlexibleArm-v0", n_envs=64, seed=0, normalize=True)
    PPO("MlpPolicy", env).learn(1_000_000)
"""

import inspect
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from flexarm_env import validation as check
from flexarm_env.around import AroundControllerVector, Inside
from flexarm_env.envs.lengths import LengthsVectorEnv
from flexarm_env.envs.options import ARGUMENTS
from flexarm_env.envs.spec import CHANGEABLE, same
from flexarm_env.envs.vector import SINGLE_NAMES

with check.needs("flexarm_env.sb3", "stable-baselines3", "train"):
    from stable_baselines3.common.env_util import is_wrapped
    from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize

Indices = None | int | Iterable[int]
Infos = list[dict[str, Any]]


def make_sb3_vec(
    env_id: str,
    n_envs: int = 1,
    seed: int | None = None,
    *,
    monitor: bool | str = True,
    normalize: bool | Mapping[str, Any] = False,
    info_keys: Sequence[str] = (),
    vectorization_mode: str = "vector_entry_point",
    wrappers: Sequence[Callable[[gym.Env[Any, Any]], gym.Env[Any, Any]]] = (),
    lengths: Sequence[float | Sequence[float]] = (),
    around: Inside | None = None,
    **kwargs: Any,
) -> VecEnv:
    """Create a Stable-Baselines3 VecEnv of n_envs environments that are stepped together.

    Args:
        env_id: a registered id, such as "FlexibleArm-v0". n_envs: number of environments.
        seed: environment i has the seed `seed` + i at the first reset; None: the operating system provides seeds.
        monitor: True to wrap the environment in VecMonitor (episode returns and lengths, `is_success`); a string is the
            path of the monitor's file.
        normalize: True to wrap the environment in VecNormalize; a mapping contains keywords of VecNormalize, e.g.
            {"norm_reward": False, "gamma": 0.98}.
        info_keys: entries of the environment's info that every step returns. The other entries of info are returned
            only at the end of an episode, because Stable-Baselines3 does not read them earlier.
        vectorization_mode: "vector_entry_point" for the native vector environment, "sync" or "async" for n_envs single
            environments.
        wrappers: functions or classes that wrap each single environment, the first one innermost. The native vector
            environment has no single environments, so with wrappers "vector_entry_point" means "sync".
        lengths: factors on the links' lengths, each of which applies to a part of the environments (`envs.lengths`).
        around: controller whose torques are added to the actions (`flexarm_env.around.AroundControllerVector`).
        kwargs: keyword arguments of the environment.
    Returns:
        The environment VecNormalize(VecMonitor(GymnasiumVecEnv)), without the wrappers that are not requested.
    Raises:
        ValueError: n_envs is below 1, the native vector environment does not support same-step autoreset, or a
            keyword argument of the environment is invalid.
    """
    n_envs = check.integer("n_envs", n_envs, minimum=1)
    seed = seed if seed is None else check.integer("seed", seed, minimum=0)
    keywords = normalize if isinstance(normalize, Mapping) else {} if check.flag("normalize", normalize) else None
    mode: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP}
    if wrappers:
        each = check.sequence("wrappers", wrappers, "functions of an environment")
        vectorization_mode = "sync" if vectorization_mode == "vector_entry_point" else vectorization_mode
        kwargs = {"wrappers": each} | kwargs
    lengths = check.sequence("lengths", lengths, "factors on lengths")
    if lengths and vectorization_mode != "vector_entry_point":
        what = "must be left out with wrappers or another vectorization_mode than 'vector_entry_point'"
        raise check.InvalidValue("lengths", lengths, what)
    kwargs = mode | kwargs if vectorization_mode == "vector_entry_point" else {"vector_kwargs": mode} | kwargs
    native: VectorEnv[Any, Any, Any]
    try:
        if lengths:
            native = LengthsVectorEnv(env_id, n_envs, lengths, **kwargs)
        else:
            native = gym.make_vec(env_id, num_envs=n_envs, vectorization_mode=vectorization_mode, **kwargs)
    except TypeError as error:
        if "'autoreset_mode'" not in str(error):
            raise
        what = f"must be 'sync' or 'async' for {env_id}, whose own vector environment has no same-step autoreset"
        raise check.InvalidValue("vectorization_mode", vectorization_mode, what) from error
    native = native if around is None else AroundControllerVector(native, inside=around)
    adapter = GymnasiumVecEnv(native, info_keys)
    if seed is not None:
        adapter.seed(seed)
        adapter.action_space.seed(seed)
    env: VecEnv = adapter
    if monitor:
        env = VecMonitor(env, monitor if isinstance(monitor, str) else None)
    if keywords is not None:
        env = VecNormalize(env, **keywords)
    return env


class GymnasiumVecEnv(VecEnv):
    """Adapter from a Gymnasium VectorEnv in same-step autoreset mode to a VecEnv.

    Args:
        env: the vector environment with same-step autoreset. info_keys: entries of the environment's info that every
            step returns. The last step of an episode returns all entries of info, and also "terminal_observation" and
            "TimeLimit.truncated".
    Raises:
        ValueError: the autoreset mode is not same-step. Stable-Baselines3 requires same-step autoreset: the last step
            of an episode must return the first observation of the next episode.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], info_keys: Sequence[str] = ()) -> None:
        """Store the environment; raise ValueError unless its autoreset mode is same-step."""
        mode = env.metadata.get("autoreset_mode")
        if mode != AutoresetMode.SAME_STEP:
            raise ValueError(f"metadata['autoreset_mode'] = {mode}: must be {AutoresetMode.SAME_STEP}")
        self.env = env
        self.info_keys = check.sequence("info_keys", info_keys, "names of infos")
        self._actions: NDArray[Any] | None = None
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self.metadata = dict(env.metadata)

    # ------------------------------------------------------------- episodes
    def reset(self) -> Any:
        """Reset all environments and return their first observations.

        The reset uses the seeds and options that the methods `seed` and `set_options` have stored.
        """
        seeds, options = self._seeds, self._options
        self._reset_seeds()
        self._reset_options()
        seed: Any = seeds
        if seeds[0] is None:
            seed = None
        elif seeds == list(range(seeds[0], seeds[0] + self.num_envs)):  # what an int means to every VectorEnv
            seed = int(seeds[0])
        alike = all(own is options[0] or same(options[0], own) for own in options)
        observations, infos = self.env.reset(seed=seed, options=(options[0] or None) if alike else None)
        self.reset_infos = [_info_of(infos, i) for i in range(self.num_envs)]
        for i, own in enumerate(options):
            if own and not alike:
                observations = self._reset_some([i], seed, own)[0]
        return observations

    def _reset_some(self, indices: Sequence[int], seed: Any, options: Mapping[str, Any]) -> tuple[Any, Infos]:
        """Reset some environments; return the observations of all and the infos of those that were reset."""
        mask = np.zeros(self.num_envs, dtype=np.bool_)
        mask[list(indices)] = True
        observations, infos = self.env.reset(seed=seed, options={**options, "reset_mask": mask})
        some = [_info_of(infos, i) for i in indices]
        for i, info in zip(indices, some, strict=True):
            self.reset_infos[i] = info
        return observations, some

    def step_async(self, actions: NDArray[Any]) -> None:
        """Store the actions (n_envs, ...), which `step_wait` then applies."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, NDArray[np.float32], NDArray[np.bool_], Infos]:
        """Step all environments with the stored actions.

        Returns observations, rewards (n,) float32, dones (n,) and infos. If an episode ended, the environment's
        observation is the first observation of the next episode.
        """
        observations, rewards, terminated, truncated, info = self.env.step(self._actions)
        dones = np.logical_or(terminated, truncated)
        infos: Infos = [{} for _ in range(self.num_envs)]
        for key in self.info_keys:
            for i, value in enumerate(info[check.choice("info_keys", key, tuple(info))]):
                infos[i][key] = value
        for i in map(int, np.flatnonzero(dones)):
            infos[i] = _info_of(info.get("final_info", {}), i)
            infos[i]["terminal_observation"] = _item(info["final_obs"], i)
            infos[i]["TimeLimit.truncated"] = bool(truncated[i] and not terminated[i])
            self.reset_infos[i] = {
                key: value for key, value in _info_of(info, i).items() if key not in ("final_info", "final_obs")
            }
        return observations, np.asarray(rewards, dtype=np.float32), dones, infos

    def close(self) -> None:
        """Close the environments."""
        self.env.close()

    # --------------------------------------------------------------- images
    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Return a picture (height, width, 3) of each environment; the function requires render_mode="rgb_array"."""
        if self.render_mode != "rgb_array":
            warnings.warn(f"render_mode = {self.render_mode!r}: pictures need 'rgb_array'", stacklevel=2)
            return [None] * self.num_envs
        return list(self.env.render() or [None] * self.num_envs)  # type: ignore[arg-type]

    # ----------------------------------------- attributes, methods, wrappers
    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return an attribute of the environments in `indices`, as a list.

        An array, list or tuple with one entry per environment is split into its entries; any other value is returned
        for each environment.
        """
        name = SINGLE_NAMES.get(attr_name, attr_name)
        if hasattr(self.env, "get_attr") and name == attr_name and not hasattr(VectorEnv, name):
            values: Any = self.env.get_attr(name)
        elif not hasattr(self.env, name) and hasattr(self.env, "call"):
            values = self.env.call(name)
        else:
            values = _spread(getattr(self.env, name), self.num_envs)
        return [values[i] for i in self._indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set an attribute of the environments in `indices` to the same value.

        For example, the environments of this package have the attribute `starts`, the ranges from which initial states
        and targets are drawn.

        Raises:
            ValueError: `indices` selects some environments, but all environments share the attribute; or the attribute
                is a keyword argument of the environment that cannot be changed later.
        """
        chosen = self._indices(indices)
        if attr_name in ARGUMENTS and attr_name not in CHANGEABLE:
            what = f"must be given when the environment is made; what can be set later: {', '.join(CHANGEABLE)}"
            raise check.InvalidValue("attr_name", attr_name, what)
        if hasattr(self.env, "set_attr"):
            values = [value] * self.num_envs if len(set(chosen)) == self.num_envs else self.get_attr(attr_name)
            for i in chosen:
                values[i] = value
            self.env.set_attr(attr_name, values)
            return
        present = getattr(self.env, attr_name, None)
        if isinstance(present, np.ndarray) and present.shape[:1] == (self.num_envs,):
            rows = present.copy()
            rows[chosen] = value
            setattr(self.env, attr_name, rows)
            return
        self._check_all(chosen, attr_name)
        setattr(self.env, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the environments in `indices`; return the list of results.

        "reset" resets only these environments; its arguments are seed (environment i has the seed `seed` + i) and
        options. "render" renders only these environments. A method other than "reset" and "render" receives the indices
        if the method has a parameter `indices`.

        Raises:
            ValueError: `indices` selects some environments, but the method acts on all environments.
        """
        chosen = self._indices(indices)
        if method_name == "reset":
            observations, infos = self._reset_some(
                chosen, method_kwargs.get("seed"), method_kwargs.get("options") or {}
            )
            return [(_item(observations, i), info) for i, info in zip(chosen, infos, strict=True)]
        if method_name == "render":
            frames = _spread(self.env.render(), self.num_envs)
            return [frames[i] for i in chosen]
        if isinstance(singles := getattr(self.env, "envs", None), list):
            return [singles[i].get_wrapper_attr(method_name)(*method_args, **method_kwargs) for i in chosen]
        if _calls_some(self.env) or (hasattr(self.env, "call") and not hasattr(self.env, method_name)):
            method, method_args = self.env.call, (method_name, *method_args)  # type: ignore[attr-defined]
        else:
            method = getattr(self.env, method_name)
        if "indices" in inspect.signature(method).parameters:
            values = method(*method_args, indices=chosen, **method_kwargs)
            return list(_spread(values, len(chosen)))
        self._check_all(chosen, method_name)
        values = _spread(method(*method_args, **method_kwargs), self.num_envs)
        return [values[i] for i in chosen]

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: Indices = None
    ) -> list[bool]:
        """Return a list of booleans, one for each environment in `indices`: True if the environment has the wrapper.

        Native environments have no wrappers.
        """
        singles = getattr(self.env, "envs", None)
        chosen = self._indices(indices)
        if not isinstance(singles, list):
            return [False] * len(chosen)
        return [is_wrapped(singles[i], wrapper_class) for i in chosen]

    def _check_all(self, chosen: list[int], name: str) -> None:
        if len(set(chosen)) < self.num_envs:
            what = f"must be all {self.num_envs} environments, which share one '{name}'"
            raise check.InvalidValue("indices", chosen, what)

    def _indices(self, indices: Indices) -> list[int]:
        return [int(i) for i in self._get_indices(indices)]


def _calls_some(env: Any) -> bool:
    """Return whether the vector environment's `call` accepts the indices of environments."""
    return "indices" in inspect.signature(env.call).parameters if hasattr(env, "call") else False


# ---------------------------------------------------------------------- infos
def _info_of(infos: Mapping[str, Any], i: int) -> dict[str, Any]:
    """Return the info of environment i from Gymnasium's arrays and their masks."""
    info: dict[str, Any] = {}
    for key, values in infos.items():
        if key.startswith("_") and key[1:] in infos:
            continue
        mask = infos.get(f"_{key}")
        if mask is None or mask[i]:
            info[key] = _info_of(values, i) if isinstance(values, Mapping) else _scalar(values[i])
    return info


def _scalar(value: Any) -> Any:
    """Return Python numbers, and copies of arrays, so that no reference to shared arrays remains."""
    if isinstance(value, np.generic):
        return value.item()
    return value.copy() if isinstance(value, np.ndarray) else value


def _item(values: Any, i: int) -> Any:
    """Return entry i of a batched observation: a dict or tuple of arrays, an array, or a sequence."""
    if isinstance(values, Mapping):
        return {key: _item(value, i) for key, value in values.items()}
    if isinstance(values, tuple):
        return tuple(_item(value, i) for value in values)
    return np.array(values[i]) if isinstance(values[i], np.ndarray) else values[i]


def _spread(values: Any, n: int) -> Any:
    """Return one value per environment: the n rows of a value that has n rows, otherwise the value n times."""
    if isinstance(values, list | tuple) and len(values) == n:
        return values
    if isinstance(values, np.ndarray) and values.shape[:1] == (n,):
        return values
    return [values] * n
