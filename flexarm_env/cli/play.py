"""`flexarm play`: an environment in a window or a film, under the keyboard, a controller or a trained policy."""

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from flexarm_env import control
from flexarm_env import validation as check
from flexarm_env.cli.codes import DONE
from flexarm_env.cli.progress import show
from flexarm_env.cli.replay import writable
from flexarm_env.control import Setup, load_policy
from flexarm_env.envs.ids import made, permitted
from flexarm_env.envs.options import ARGUMENTS
from flexarm_env.envs.video import film_path, write_film
from flexarm_env.recording import EpisodeRecorder, save_episodes
from flexarm_env.suite.policies import controller
from flexarm_env.training.episodes import judged_in
from flexarm_env.training.policies import Chosen

KEYBOARD = "keyboard"
DEFAULT_ENV = "FlexibleArm-v0"
KEYS = {"left": (0, 1.0), "right": (0, -1.0), "up": (1, 1.0), "down": (1, -1.0)}
"""Key -> joint and direction of its torque."""
GENTLE = 0.3
"""Share of the torque limit with a shift key held."""


class Keyboard:
    """Torques from the keys that are held."""

    def __init__(self, joints: int, held: Callable[[str], bool]) -> None:
        self.joints, self.held = joints, held

    def reset(self, observation: NDArray[np.float32]) -> None:
        """Nothing to remember."""

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Full torque one way or the other, less with shift."""
        action = np.zeros(self.joints, np.float32)
        for key, (joint, way) in KEYS.items():
            if joint < self.joints and self.held(key):
                action[joint] += way
        gentle = self.held("left shift") or self.held("right shift")
        return action * np.float32(GENTLE if gentle else 1.0)


def run(args: argparse.Namespace) -> int:
    """Play the episodes and print what came of them."""
    count = check.integer("--episodes", args.episodes, minimum=1)
    seed = check.integer("--seed", args.seed, minimum=0)
    player = choose(args.policy)
    if player.name == KEYBOARD and (args.headless or args.video is not None):
        raise check.InvalidValue("--policy", KEYBOARD, "must be a controller or a policy for --video and --headless")
    video = None if args.video is None else film_path(args.video)
    record = None if args.record is None else writable("record", args.record, (".npz",))
    mode = "rgb_array" if video is not None else None if args.headless else "human"
    env = _environment(args, player, mode)
    outcomes: list[dict[str, Any]] = []
    pictures = play(env, player, range(seed, seed + count), outcomes)
    values: dict[str, Any] = {"env": env.spec.id, "policy": player.name}
    try:
        if video is None:
            for _ in pictures:
                pass
        else:
            values["video"] = str(write_film(video, pictures, float(env.metadata["render_fps"])))
    finally:
        env.close()
    if record is not None:
        values["record"] = str(save_episodes(record, env.episodes))
    show(values | ({"episodes": outcomes} if args.json else {}), args.json)
    for outcome in () if args.json else outcomes:
        word = "success" if outcome["success"] else "no success"
        print(
            f"episode: seed {outcome['seed']}, {word}, return {outcome['return']:.2f}, "
            f"{outcome['seconds']:.2f} s, ended by {outcome['ended']}"
        )
    return DONE


def choose(word: str) -> Chosen:
    """Who a word names. ValueError with a sentence for a word that names nobody."""
    if word == KEYBOARD:
        return Chosen(word, "", {}, _keyboard)
    if word in control.NAMES:
        return Chosen(word, "", {}, lambda env: controller(word, env))
    if not Path(word).exists() and word not in control.policy_names():
        raise check.UnknownKey(word, (KEYBOARD, *control.NAMES, *control.policy_names()), "policy (and no policy.npz)")
    policy = load_policy(word)
    kwargs, env_id = judged_in(policy.meta["env_kwargs"]), str(policy.meta["env_id"])
    return Chosen(Path(word).stem, env_id, kwargs, lambda env: policy.check(Setup.of(env)))


def play(env: Any, player: Chosen, seeds: range, outcomes: list[dict[str, Any]]) -> Iterator[NDArray[np.uint8]]:
    """Play an episode a seed, yield its pictures, and append what came of it; ends where the window is closed."""
    env.reset(seed=seeds[0])
    policy = player.make(env)
    for seed in seeds:
        observation, info = env.reset(seed=seed)
        policy.reset(observation)
        yield from _picture(env)
        total, steps, over = 0.0, 0, False
        while not over:
            observation, reward, terminated, truncated, info = env.step(policy.act(observation))
            total, steps, over = total + float(reward), steps + 1, terminated or truncated
            yield from _picture(env)
            renderer = env.unwrapped.renderer
            if (renderer is not None and renderer.closed) or (player.name == KEYBOARD and policy.held("escape")):
                return
        seconds = steps * env.unwrapped.dt
        outcome = {"seed": seed, "success": info["is_success"], "return": total, "seconds": seconds}
        outcomes.append(outcome | {"ended": info.get("termination_reason", "failure" if terminated else "") or "time"})


def _picture(env: Any) -> Iterator[NDArray[np.uint8]]:
    """The picture, where there is no window that shows it."""
    if env.render_mode == "rgb_array":
        yield env.render()


def keywords(text: str | None) -> dict[str, Any]:
    """What --env-kwargs says."""
    try:
        given = {} if text is None else json.loads(text)
    except (ValueError, RecursionError):
        raise check.InvalidValue("--env-kwargs", text, 'must be JSON such as {"duration": 8}') from None
    given = check.table_of("--env-kwargs", given)
    check.known_keys("--env-kwargs", given, [key for key in ARGUMENTS if key != "render_mode"], "argument")
    return given


def _environment(args: argparse.Namespace, player: Chosen, mode: str | None) -> Any:
    env_id = args.env or player.env_id or DEFAULT_ENV
    if player.env_id and env_id != player.env_id:
        raise check.InvalidValue("ENV", env_id, f"must be {player.env_id}, which {player.name} was trained on")
    own: dict[str, Any] = {}
    if player.env_id:
        env_id, own = permitted(player.name, player.env_id, player.env_kwargs, args.env)
    given = keywords(args.env_kwargs)
    return EpisodeRecorder(made(gym.make, env_id, render_mode=mode, **{**own, **given}))


def _keyboard(env: Any) -> Keyboard:
    """The keyboard of the environment's window. ValueError where there is none."""
    renderer = env.unwrapped.renderer
    if renderer is None or not renderer.visible:
        raise check.InvalidValue("--policy", KEYBOARD, "must be a controller or a policy here: there is no window")
    sys.stderr.write("keys: left and right turn the hub, up and down the elbow, shift is gentle, Esc ends\n")
    return Keyboard(env.action_space.shape[0], renderer.held)
