"""`flexarm play`: show an environment in a window or a film, controlled by keyboard, a controller or a policy."""

import argparse
import dataclasses
import json
import sys
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from flexarm_env import validation as check
from flexarm_env.cli.codes import DONE
from flexarm_env.cli.progress import show
from flexarm_env.cli.replay import writable
from flexarm_env.control import NamedPolicy, find_policy
from flexarm_env.envs.ids import make_registered, permitted
from flexarm_env.envs.options import ARGUMENTS
from flexarm_env.envs.video import film_path, write_film
from flexarm_env.episodes import periods
from flexarm_env.recording import EpisodeRecorder, save_episodes
from flexarm_env.training.episodes import judged_in

KEYBOARD = "keyboard"
DEFAULT_ENV = "FlexibleArm-v0"
KEYS = {"left": (0, 1.0), "right": (0, -1.0), "up": (1, 1.0), "down": (1, -1.0)}
"""Joint and direction of the joint's torque for each key."""
GENTLE = 0.3
"""Share of the torque limit while a shift key is held."""


class Keyboard:
    """Policy that maps the pressed keys to torques."""

    def __init__(self, joints: int, held: Callable[[str], bool]) -> None:
        self.joints, self.held = joints, held

    def reset(self, observation: NDArray[np.float32]) -> None:
        """Do nothing, because keyboard control has no memory."""

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the full torque in the direction of each pressed key; with shift, a smaller torque."""
        action = np.zeros(self.joints, np.float32)
        for key, (joint, way) in KEYS.items():
            if joint < self.joints and self.held(key):
                action[joint] += way
        gentle = self.held("left shift") or self.held("right shift")
        return action * np.float32(GENTLE if gentle else 1.0)


def run(args: argparse.Namespace) -> int:
    """Run the episodes and print a summary of each; return the exit code."""
    count = check.integer("--episodes", args.episodes, minimum=1)
    seed = check.integer("--seed", args.seed, minimum=0)
    player = choose(args.policy)
    if player.name == KEYBOARD and (args.headless or args.video is not None):
        raise check.InvalidValue("--policy", KEYBOARD, "must be a controller or a policy with --video or --headless")
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


def choose(word: str, flag: str = "--policy") -> NamedPolicy:
    """Return the policy that a name denotes; "keyboard" denotes `Keyboard`. Raises ValueError for an unknown name."""
    if word == KEYBOARD:
        return NamedPolicy(word, "", {}, _keyboard)
    found = find_policy(word, flag)
    return dataclasses.replace(found, env_kwargs=judged_in(found.env_kwargs, found.asked))


def play(env: Any, player: NamedPolicy, seeds: range, outcomes: list[dict[str, Any]]) -> Iterator[NDArray[np.uint8]]:
    """Run an episode for each seed, yield its pictures, and append its summary to `outcomes`.

    The episodes end when the window is closed.
    """
    env.reset(seed=seeds[0])
    policy = player.make(env)
    total = 0.0
    for now in periods(env, policy, seeds):
        total = total + float(now.reward) if now.period else 0.0
        yield from _picture(env)
        renderer, escaped = env.unwrapped.renderer, player.name == KEYBOARD and policy.held("escape")
        if now.period and (escaped or (renderer is not None and renderer.closed)):
            return
        if now.terminated or now.truncated:
            ended = now.info.get("termination_reason", "failure" if now.terminated else "") or "time"
            outcomes.append({
                "seed": now.seeds[0], "success": now.info["is_success"], "return": total,
                "seconds": now.period * env.unwrapped.dt, "ended": ended,
            })  # fmt: skip


def _picture(env: Any) -> Iterator[NDArray[np.uint8]]:
    """Return the present picture of the environment; None if the environment has a window."""
    if env.render_mode == "rgb_array":
        yield env.render()


def keywords(text: str | None) -> dict[str, Any]:
    """Parse the JSON object of the flag --env-kwargs; return {} if the flag is missing."""
    try:
        given = {} if text is None else json.loads(text)
    except (ValueError, RecursionError):
        raise check.InvalidValue("--env-kwargs", text, 'must be JSON such as {"duration": 8}') from None
    given = check.table_of("--env-kwargs", given)
    check.known_keys("--env-kwargs", given, [key for key in ARGUMENTS if key != "render_mode"], "argument")
    return given


def _environment(args: argparse.Namespace, player: NamedPolicy, mode: str | None) -> Any:
    """Make the environment, with a recorder of its episodes.

    The environment's keywords are the policy's keywords; the user's keywords override them.
    """
    env_id = args.env or player.env_id or DEFAULT_ENV
    if player.env_id and env_id != player.env_id:
        raise check.InvalidValue("ENV", env_id, f"must be {player.env_id}, which {player.name} was trained on")
    own: dict[str, Any] = {}
    if player.env_id:
        env_id, own = permitted(player.name, player.env_id, player.env_kwargs, args.env)
    given = keywords(args.env_kwargs)
    return EpisodeRecorder(make_registered(gym.make, env_id, render_mode=mode, **{**own, **given}))


def _keyboard(env: Any) -> Keyboard:
    """Return the keyboard of the environment's window. Raises ValueError if there is no window."""
    renderer = env.unwrapped.renderer
    if renderer is None or not renderer.visible:
        raise check.InvalidValue("--policy", KEYBOARD, "must be a controller or a policy: there is no window")
    sys.stderr.write("keys: left and right turn the hub, up and down the elbow; shift reduces the torque; Esc quits\n")
    return Keyboard(env.action_space.shape[0], renderer.held)
