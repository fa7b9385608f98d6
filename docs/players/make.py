"""Makes the data of the players in this site, docs/players/*.json; the pages around it are made when the site is built.

    python docs/players/make.py [NAME ...]

A few minutes; of NAMEs alone where some are given. The suite's tasks have players by their ids.
"""

import math
import sys
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

import gymnasium as gym

from flexarm_env import control, named, scenes, simulate, suite
from flexarm_env.control import load_policy
from flexarm_env.recording import EpisodeRecorder
from flexarm_env.shapes import Cylinder, HalfSpace
from flexarm_env.suite.policies import choose
from flexarm_env.training.episodes import judged_in
from flexarm_env.view import Clip, Player, SpaceClip

HOME = Path(__file__).parent
Clips = list[Clip | SpaceClip]
MOST_BYTES, THREE = 180_000, 590_000
"""Of a page, and what three.js in it takes; a player of the site shows fewer instants than one that `flexarm view`
writes."""
SEED, SECONDS = 20_000, 5.0
"""Of a task's episode, which no policy is trained or judged on; what is shown of it."""
BESIDE = ("lqg", "lqr", "zvd")
"""What a task's player has beside PD: the first that acts on what the task shows."""


def scene(name: str) -> Clips:
    """A named scene as it stands."""
    own = named(name)
    usual = own.sample or own.dt
    finer = max(1, round(min(150.0 * usual / own.duration, usual / own.dt)))
    return [simulate(own, sample=usual / finer, estimate_error=False).clip(name)]


def played(
    env_id: str, seed: int, words: dict[str, str], most: float = math.inf,
    make: Callable[[str, Any], Any] = control.make, **kwargs: object,
) -> Clips:  # fmt: skip
    """An episode, or its first `most` s, under controllers and packaged policies, by label."""
    clips: Clips = []
    for label, word in words.items():
        policy = load_policy(word) if word in control.policy_names() else None
        own = {} if policy is None else judged_in(policy.meta["env_kwargs"])
        env = EpisodeRecorder(gym.make(env_id, **{**kwargs, **own}))
        env.reset(seed=seed)
        player = make(word, env) if policy is None else policy
        observation, _ = env.reset(seed=seed)
        player.reset(observation)
        for k in count(1):
            observation, _, terminated, truncated, _ = env.step(player.act(observation))
            if terminated or truncated or k * env.unwrapped.dt > most - 1e-9:  # type: ignore[attr-defined]
                break
        env.close()
        clips.append(env.episodes[0].clip(label))
    return clips


def task(one: suite.Task) -> Clips:
    """The beginning of an episode of a task of the suite."""
    env, words = suite.make(one.id), {"PD": "pd"}
    env.reset(seed=SEED)
    for name in BESIDE:
        try:
            control.make(name, env)
        except ValueError:
            continue
        words[name.upper()] = name
        break
    return played(one.env_id, SEED, words, SECONDS, lambda word, env: choose(word, one).make(env))


MADE: dict[str, Callable[[], Clips]] = {
    **{name: lambda name=name: scene(name) for name in scenes.names()},  # type: ignore[misc]
    "policy_beside_pd": lambda: played(
        "TwoLinkFlexArm-v0", 10057, {"trained policy": "two_link", "PD": "pd"}, duration=3.2
    ),
    "flexible_arm": lambda: played("FlexibleArm-v0", 5, {"PD": "pd", "LQR": "lqr"}, duration=2.4),
    "two_link": lambda: played("TwoLinkFlexArm-v0", 3, {"PD": "pd", "LQR": "lqr"}, duration=5.0),
    "multi_link": lambda: played("MultiLinkFlexArm-v0", 2, {"PD": "pd"}, duration=6.0),
    "three_dof_slew": lambda: scene("three_dof_slew"),
    "spatial": lambda: played(
        "SpatialFlexArm-v0", 8, {"PD": "pd"}, duration=2.5, keep_out=[
            HalfSpace((-0.6, 0.0, 0.0), (1.0, 0.0, 0.0)), Cylinder((0.5, 0.5, 0.0), (0.5, 0.5, 0.7), 0.08),
        ],
    ),
    **{one.id: lambda one=one: task(one) for one in suite.tasks()},  # type: ignore[misc]
}


def main(wanted: list[str]) -> None:
    """Make all, or what is wanted."""
    for name in wanted or MADE:
        clips = MADE[name]()
        words = " and ".join(clip.label for clip in clips)
        title = {one.id: f"{one.title}: {words}" for one in suite.tasks()}.get(name)
        more = THREE if isinstance(clips[0], SpaceClip) else 0
        player = Player(clips, title, most_bytes=MOST_BYTES + more)
        (HOME / f"{name}.json").write_text(player.data + "\n", encoding="utf-8")
        print(f"{name}: {len(player.html) // 1000} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
