"""Films of an episode under one policy, or under several policies side by side.

    python -m flexarm_env.training.films --policy runs/ppo-FlexibleArm-v0-0,pd --out runs/beside.gif
    python -m flexarm_env.training.films --env TwoLinkFlexArm-v0 --policy pd,lqr --seed 10004 --out two.mp4 --size 480

--policy takes the same names as in `flexarm evaluate`. All policies act in episodes with the same seed. --labels takes
labels to print above the pictures, separated by commas.
"""

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from flexarm_env import validation as check
from flexarm_env.control import NamedPolicy
from flexarm_env.envs.video import film_path, write_film
from flexarm_env.episodes import periods
from flexarm_env.training.episodes import TEST
from flexarm_env.training.policies import choose
from flexarm_env.training.runs import command

Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class Arguments:
    """Arguments of `python -m flexarm_env.training.films`.

    Args:
        policy: the policy; several, separated by commas, are shown side by side.
        out: file of the film: .mp4, .gif, .webm, .mkv or .mov.
        env: id of the environment.
        env_kwargs: keywords of the environment, as JSON; they override the keywords with which a policy was trained.
        seed: seed of the episode.
        seconds: duration of the shown part of the episode, s; default: the whole episode.
        fps: pictures per second of film, at most one per control period.
        speed: seconds of the episode per second of film.
        size: side of each picture, pixels.
        labels: labels above the pictures, separated by commas; default: the policies' names.
    """

    policy: str
    out: Path
    env: str = "FlexibleArm-v0"
    env_kwargs: dict[str, Any] = field(default_factory=dict)
    seed: int = TEST
    seconds: float | None = None
    fps: float = 25.0
    speed: float = 1.0
    size: int = 640
    labels: str | None = None


def episode(env_id: str, chosen: NamedPolicy, kwargs: Mapping[str, Any], seed: int) -> Iterator[Picture]:
    """Yield the pictures (640, 640, 3) of an episode, one per control period."""
    env = gym.make(env_id, render_mode="rgb_array", **kwargs)
    policy = chosen.make(env)
    for _ in periods(env, policy, [seed]):
        yield np.asarray(env.render())
    env.close()


def film(env_id: str, chosen: NamedPolicy, kwargs: Mapping[str, Any], seed: int, path: Path) -> None:
    """Write an episode as a film, one picture per control period, at 50 pictures per second."""
    write_film(path, episode(env_id, chosen, kwargs, seed), 50.0)


def beside(films: Sequence[Iterator[Picture]], labels: Sequence[str], size: int) -> Iterator[Picture]:
    """Yield pictures of several episodes side by side under their labels; a finished episode shows its last picture."""
    from PIL import Image, ImageDraw, ImageFont

    head = round(0.09 * size)
    font = ImageFont.load_default(0.055 * size)
    last: list[Any] = [None] * len(films)
    while True:
        new = [next(one, None) for one in films]
        if all(picture is None for picture in new):
            return
        # finished episodes keep their last picture
        last = [old if picture is None else picture for old, picture in zip(last, new, strict=True)]
        sheet = Image.new("RGB", (size * len(films), size + head), tuple(last[0][-2, 1].tolist()))
        for k, (picture, label) in enumerate(zip(last, labels, strict=True)):
            sheet.paste(Image.fromarray(picture).resize((size, size), Image.Resampling.LANCZOS), (k * size, head))
            middle = ((k + 0.5) * size, 0.55 * head)
            ImageDraw.Draw(sheet).text(middle, label, (52, 62, 76), font=font, anchor="mm")
        yield np.asarray(sheet)


def make(arguments: Arguments) -> Path:
    """Write the film; return its path. Raises ValueError for invalid arguments."""
    film_path(arguments.out)
    words = arguments.policy.split(",")
    chosen = [choose(word, arguments.env) for word in words]
    labels = arguments.labels.split(",") if arguments.labels else [one.name for one in chosen]
    if len(labels) != len(words):
        raise ValueError(f"--labels {arguments.labels}: must be {len(words)}, one for each policy")
    kwargs = [dict(one.env_kwargs) | arguments.env_kwargs for one in chosen]
    films = [episode(arguments.env, one, own, arguments.seed) for one, own in zip(chosen, kwargs, strict=True)]
    env: Any = gym.make(arguments.env, **arguments.env_kwargs).unwrapped
    # the control period gives the pictures' spacing in time
    period = env.dt
    for name in ("fps", "speed", "size"):
        check.number(f"--{name}", getattr(arguments, name), above=0.0)
    # pictures to skip for the requested rate and speed
    every = max(1, round(arguments.speed / (arguments.fps * period)))
    count = None if arguments.seconds is None else round(arguments.seconds / period) + 1
    pictures = beside([islice(one, 0, count, every) for one in films], labels, arguments.size)
    return write_film(arguments.out, pictures, arguments.speed / (every * period))


main = partial(
    command, Arguments, "python -m flexarm_env.training.films", __doc__, lambda arguments: print(make(arguments))
)


if __name__ == "__main__":
    sys.exit(main())
