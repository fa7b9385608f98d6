"""`flexarm view`: write a page that shows simulations and episodes in a browser."""

import argparse
import math
import webbrowser
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium as gym

from flexarm_env import control, scenes
from flexarm_env import validation as check
from flexarm_env.cli.codes import DONE
from flexarm_env.cli.play import DEFAULT_ENV, choose, keywords, play
from flexarm_env.cli.progress import ProgressBar, show
from flexarm_env.control import NamedPolicy
from flexarm_env.envs.ids import PACKAGE, own_ids
from flexarm_env.episodes import Actions
from flexarm_env.files import npz_names
from flexarm_env.recording import EpisodeRecorder, load_episodes
from flexarm_env.scene import Scene
from flexarm_env.suite import best
from flexarm_env.suite.data import task
from flexarm_env.suite.score import FIRST
from flexarm_env.trajectory import MOST_SAMPLES, MOST_STEPS, Trajectory
from flexarm_env.view import Clip, SpaceClip
from flexarm_env.view import Player as Page

OF_THE_POLICY = ("action_mode", "residual_share", "observation", "history", "sensors")
"""Keywords of a policy's environment that define observation and action; controllers on the page do not use them."""
KINDS = {
    "episodes": "a file of recorded episodes", "scene": "a scene", "player": "a controller, a policy or a task",
}  # fmt: skip
FLAGS = {
    "episode": "episodes", "formulation": "scene", "duration": "scene", "sample": "scene", "seed": "player",
    "env_kwargs": "player",
}  # fmt: skip
"""Flags that apply to only one kind of run, each with its kind of run (a key of KINDS)."""
PICTURES = 300
"""Smallest number of instants of a simulated scene on the page, unless the scene has fewer steps."""


def run(args: argparse.Namespace) -> int:
    """Write the page and print its path; return the exit code."""
    target = Path(args.out if args.out is not None else f"{Path(args.runs[0].partition('@')[0]).stem}.html")
    if target.suffix.lower() not in (".html", ".htm"):
        raise check.InvalidValue("--out", args.out, "must end in .html")
    kinds = _checked(args)
    usual = FIRST if any(word in best.known() for word in args.runs) else 0
    seed = usual if args.seed is None else check.integer("--seed", args.seed, minimum=0)
    shared = _shared(args, kinds, seed)
    clips = [_clip(word, kind, seed, args, shared) for word, kind in zip(args.runs, kinds, strict=True)]
    page = Page(clips, args.title)
    path = page.save(target)
    if args.open:
        webbrowser.open(path.resolve().as_uri())
    values = {"view": str(path), "runs": [clip.label for clip in clips], "bytes": path.stat().st_size}
    show(values | {"instants": [len(clip.t) for clip in clips]}, args.json)
    if not args.json and not args.open:
        print(f"next: open {path} in a browser, or use --open")
    return DONE


def _checked(args: argparse.Namespace) -> list[str]:
    """Return the kind of each run that the command shows. Raises ValueError for an unknown word, or a flag that no run
    uses.
    """
    kinds = [_kind(word) for word in args.runs]
    for flag, kind in FLAGS.items():
        if getattr(args, flag) is not None and kind not in kinds:
            what = f"requires a run that is {KINDS[kind]}"
            raise check.InvalidValue(f"--{flag.replace('_', '-')}", getattr(args, flag), what)
    return kinds


def _kind(word: str) -> str:
    """Return the kind of run that a word names: "episodes", "trajectory", "scene" or "player" (policy, controller)."""
    path = Path(word)
    if path.suffix == ".npz" and path.is_file():
        held = npz_names(path, "trajectory, episodes or policy")
        return "episodes" if "lengths" in held else "player" if "meta" in held else "trajectory"
    if path.suffix in (".csv", ".gz", ".json", ".html") and path.is_file():
        what = f"must be a run as .npz (from simulate --out RUN.npz): a {path.suffix} file lacks data for the page"
        raise check.InvalidValue("RUN", word, what)
    if word.partition("@")[0] in control.NAMES:
        return "player"
    if word in scenes.names(parameter_sets=True, space=True) or path.suffix == ".toml" or ".toml@" in word:
        return "scene"
    players = (*control.NAMES, *control.policy_names(), *best.known())
    if word in players or path.exists() or ":" in word:
        return "player"
    known = (*scenes.names(space=True), *players)
    what = "scene, controller, policy, task with a record, file, folder or MODULE:NAME"
    raise check.UnknownKey(word, known, what)


def _clip(word: str, kind: str, seed: int, args: argparse.Namespace, shared: dict[str, Any]) -> Clip | SpaceClip:
    """Return the clip of the run that a word names; kind: the kind of this run."""
    path = Path(word)
    if kind == "episodes":
        return _of_episodes(path, args)
    if kind == "trajectory":
        return Trajectory.from_npz(path).clip(path.stem)
    if kind == "scene":
        return _of_scene(scenes.resolve(word), word, args).clip(path.stem if path.is_file() else word)
    return _of_player(_who(word, seed), seed, shared)


def _who(word: str, seed: int) -> NamedPolicy:
    """Return the policy that a word names; for a suite task, the best known policy of the episode with this seed."""
    if word not in best.known():
        return choose(word, "RUN")
    kept = best.record(task(word))
    n = kept.actions.shape[1]
    k = check.integer("--seed", seed, minimum=FIRST, maximum=FIRST + n - 1) - FIRST
    name, env_id = f"best known ({kept.by[k]})", task(word).registered
    return NamedPolicy(name, env_id, {}, lambda env: Actions(kept.actions[:, k]))


def _of_episodes(path: Path, args: argparse.Namespace) -> Clip | SpaceClip:
    """Return the clip of the recording's episode --episode, or of its first episode."""
    kept = load_episodes(path)
    k = 0 if args.episode is None else check.integer("--episode", args.episode, minimum=0, maximum=len(kept) - 1)
    with check.in_file(path):
        return kept[k].clip(f"{path.stem}, episode {k}" if len(kept) > 1 else path.stem, args.env)


def _of_scene(scene: Scene, word: str, args: argparse.Namespace) -> Trajectory:
    """Simulate a scene with enough samples for a smooth film."""
    from flexarm_env.simulation import simulate

    usual, length = scene.sample or scene.dt, scene.duration
    if args.duration is not None:
        most = min(MOST_STEPS * scene.dt, MOST_SAMPLES * (usual if args.sample is None else math.inf))
        length = check.number("--duration", args.duration, "s", above=0.0, maximum=most)
    finer = max(1, math.ceil(min(usual * PICTURES / length, usual / scene.dt) - 1e-9))
    sample = usual / finer if args.sample is None else args.sample
    with closing(ProgressBar(word)) as bar:
        return simulate(scene, args.formulation, duration=length, sample=sample, progress=bar, estimate_error=False)


def _shared(args: argparse.Namespace, kinds: Sequence[str], seed: int) -> dict[str, Any]:
    """Return id and keywords of the environment in which controllers play.

    The environment is --env, or that of the first named policy. The keywords are those of the first named policy,
    overridden by --env-kwargs.
    """
    given = keywords(args.env_kwargs)
    for word, kind in zip(args.runs, kinds, strict=True):
        if kind == "player" and (player := _who(word, seed)).env_id:
            kwargs = {k: v for k, v in player.env_kwargs.items() if k not in OF_THE_POLICY}
            return {"env": _registered(args.env or player.env_id), "kwargs": kwargs | given, "given": given}
    return {"env": _registered(args.env or DEFAULT_ENV), "kwargs": given, "given": given}


def _registered(env_id: str) -> str:
    """Return an id without the package's prefix, which `gymnasium.make` accepts."""
    return env_id.removeprefix(f"{PACKAGE}:")


def _of_player(player: NamedPolicy, seed: int, shared: dict[str, Any]) -> Clip | SpaceClip:
    """Return the clip of one episode played by a controller or policy."""
    env_id, kwargs = shared["env"], shared["kwargs"]
    if player.env_id:
        env_id, kwargs = player.env_id, {**player.env_kwargs, **shared["given"]}
    env_id = _registered(env_id)
    if env_id != shared["env"]:
        what = f"must play in {shared['env']}, the environment of the first policy or of --env, not in {env_id}"
        raise check.InvalidValue("RUN", player.name, what)
    if env_id not in own_ids():
        raise check.UnknownKey(env_id, own_ids(), "environment")
    env = EpisodeRecorder(gym.make(env_id, **kwargs))
    try:
        for _ in play(env, player, range(seed, seed + 1), []):
            pass
    finally:
        env.close()
    return env.episodes[0].clip(player.name)
