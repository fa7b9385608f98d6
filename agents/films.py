"""A film of one episode."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from agents.policies import Chosen
from agents.runs import write_whole


def film(env_id: str, chosen: Chosen, kwargs: Mapping[str, Any], seed: int, path: Path) -> None:
    """Write an episode as an .mp4 file."""
    try:
        from moviepy import ImageSequenceClip
    except ImportError as error:
        raise ValueError('films need moviepy and pygame-ce: pip install "flexarm_env[render]"') from error
    env = gym.make(env_id, render_mode="rgb_array", **kwargs)
    policy = chosen.make(env)
    observation, _ = env.reset(seed=seed)
    policy.reset(observation)
    frames: list[Any] = [env.render()]
    over = False
    while not over:
        observation, _, terminated, truncated, _ = env.step(policy.act(observation))
        frames.append(np.asarray(env.render()))
        over = bool(terminated or truncated)
    fps = env.metadata.get("render_fps", 50)
    env.close()
    clip = ImageSequenceClip(frames, fps=fps)
    write_whole(path, lambda part: clip.write_videofile(str(part), codec="libx264", audio=False, logger=None))
