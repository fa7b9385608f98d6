"""`flexarm view`: a page that plays scenes, trajectories, episodes, controllers and policies in a browser."""

from __future__ import annotations

import argparse
import math
import webbrowser
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from flexarm_env import control, scenes
from flexarm_env import validation as check
from flexarm_env.cli.parser import DONE
from flexarm_env.cli.play import DEFAULT_ENV, NOT_PLAYED, Player, choose, play
from flexarm_env.cli.progress import ProgressBar, show
from flexarm_env.envs.ids import PACKAGE, own_ids
from flexarm_env.recording import EpisodeRecorder, load_episodes
from flexarm_env.scene import Scene
from flexarm_env.trajectory import Trajectory
from flexarm_env.view import Clip
from flexarm_env.view import Player as Page

OF_THE_POLICY = ("action_mode", "residual_share", "observation", "history", "sensors")
"""Keywords of a policy's environment that say what it sees and sets: a controller beside it has its own."""
PICTURES = 300
"""Instants of a scene that is run for the page, at least, where its steps are as many."""


def run(args: argparse.Namespace) -> int:
    """Make the page and say where it is."""
    target = Path(args.out if args.out is not None else f"{Path(args.runs[0].partition('@')[0]).stem}.html")
    if target.suffix.lower() not in (".html", ".htm"):
        raise check.InvalidValue("--out", args.out, "must end in .html")
    seed = check.integer("--seed", args.seed, minimum=0)
    shared = _shared(args)
    clips = [clip for word in args.runs for clip in _clips(word, seed, args, shared)]
    page = Page(clips, args.title)
    path = page.save(target)
    if args.open:
        webbrowser.open(path.resolve().as_uri())
    values = {"view": str(path), "runs": [clip.label for clip in clips], "bytes": path.stat().st_size}
    show(values | {"instants": [len(clip.t) for clip in clips]}, args.json)
    return DONE


def _clips(word: str, seed: int, args: argparse.Namespace, shared: dict[str, Any]) -> Iterator[Clip]:
    """What a word stands for."""
    path = Path(word)
    if path.suffix == ".npz" and path.is_file() and not _is_policy(path):
        yield from _of_file(path, args)
    elif word in scenes.names(parameter_sets=True) or path.suffix == ".toml" or ".toml@" in word:
        yield _of_scene(scenes.resolve(word), word, args).clip(Path(word).stem if path.is_file() else word)
    elif word in (*control.NAMES, *control.policy_names()) or path.exists():
        yield _of_player(choose(word), seed, shared)
    else:
        known = (*scenes.names(), *control.NAMES, *control.policy_names())
        raise check.UnknownKey(word, known, "scene, controller or policy (and no file or folder)")


def _is_policy(path: Path) -> bool:
    with np.load(path, allow_pickle=False) as data:
        return "meta" in data.files and "lengths" not in data.files


def _of_file(path: Path, args: argparse.Namespace) -> Iterator[Clip]:
    """A trajectory, or the episodes of a recording (--episode: one of them)."""
    with np.load(path, allow_pickle=False) as data:
        episodes = "lengths" in data.files
    if not episodes:
        yield Trajectory.from_npz(path).clip(path.stem)
        return
    kept = load_episodes(path)
    k = 0 if args.episode is None else check.integer("--episode", args.episode, minimum=0, maximum=len(kept) - 1)
    yield kept[k].clip(f"{path.stem}, episode {k}" if len(kept) > 1 else path.stem, args.env)


def _of_scene(scene: Scene, word: str, args: argparse.Namespace) -> Trajectory:
    from flexarm_env.simulation import simulate

    length = scene.duration if args.duration is None else check.number("--duration", args.duration, "s", above=0.0)
    usual = scene.sample or scene.dt
    finer = max(1, math.ceil(min(usual * PICTURES / length, usual / scene.dt) - 1e-9))
    sample = usual / finer if args.sample is None else args.sample
    bar = ProgressBar(word)
    try:
        return simulate(scene, args.formulation, duration=length, sample=sample, progress=bar, estimate_error=False)
    finally:
        bar.close()


def _shared(args: argparse.Namespace) -> dict[str, Any]:
    """The environment that controllers play in: that of the first policy named, or --env."""
    for word in args.runs:
        if word in control.policy_names() or (Path(word).is_dir()) or word.endswith("policy.npz"):
            player = choose(word)
            kwargs = {k: v for k, v in player.env_kwargs.items() if k not in OF_THE_POLICY}
            return {"env": _registered(args.env or player.env_id), "kwargs": kwargs}
    return {"env": _registered(args.env or DEFAULT_ENV), "kwargs": {}}


def _registered(env_id: str) -> str:
    """An id without the package, which `gymnasium.make` may be given before it."""
    return env_id.removeprefix(f"{PACKAGE}:")


def _of_player(player: Player, seed: int, shared: dict[str, Any]) -> Clip:
    """An episode of a controller or a policy."""
    env_id, kwargs = (player.env_id, player.env_kwargs) if player.env_id else (shared["env"], shared["kwargs"])
    env_id = _registered(env_id)
    if env_id != shared["env"]:
        what = f"must be of {shared['env']}, as the first policy or --env, not of {env_id}"
        raise check.InvalidValue("RUN", player.name, what)
    if env_id not in own_ids():
        raise check.UnknownKey(env_id, own_ids(), "environment")
    env = EpisodeRecorder(gym.make(env_id, **{k: v for k, v in kwargs.items() if k not in NOT_PLAYED}))
    try:
        for _ in play(env, player, range(seed, seed + 1), []):
            pass
    finally:
        env.close()
    return env.episodes[0].clip(player.name)
