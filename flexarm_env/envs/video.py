"""Compute the pictures of a recorded run, and write them to a film."""

import errno
import importlib
import os
import shutil
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from .. import validation as check
from ..trajectory import Trajectory
from .pictures import pictures_of
from .rendering import end_of_scale

FILMS = (".mp4", ".webm", ".mkv", ".mov")
"""File name endings of the films that imageio-ffmpeg writes; Pillow writes .gif."""

Draw = Callable[[int, Any], Any]

FEWEST = 1e-3
"""Smallest number of pictures per second in a film."""
LONGEST = 655.0
"""Longest film in a .gif, s: a .gif cannot show one picture, or equal pictures, for longer."""

ROOM = 1 << 20
"""Free space, bytes, below which a disk counts as full."""


def pictures(
    trajectory: Trajectory,
    fps: float = 25.0,
    speed: float = 1.0,
    size: tuple[int, int] = (640, 640),
    mode: str = "rgb_array",
) -> Iterator[NDArray[np.uint8]]:
    """Yield the pictures of a run at intervals of speed / fps seconds, each from the nearest recorded instant.

    Args:
        trajectory: a run. The film shows each instant once if the run was simulated with sample = speed / fps.
        fps: pictures per second. speed: seconds of the run per second of the film. size: width and height, pixels.
        mode: "rgb_array" yields (height, width, 3) uint8; "human" shows them in a window and yields nothing.
    Raises:
        ValueError: fps or speed is not positive.
    """
    fps, speed = check.number("fps", fps, "1/s", above=0.0), check.number("speed", speed, above=0.0)
    scene, t = trajectory.scene, trajectory.t
    arm, limits = scene.arm, scene.arm.torque_limits
    count = 1 + int(np.floor((t[-1] - t[0]) * fps / speed * (1.0 + 1e-9)))
    times = t[0] + np.arange(count) * speed / fps
    after = np.clip(np.searchsorted(t, times), min(1, t.size - 1), t.size - 1)
    nearest = np.where(times - t[after - 1] <= t[after] - times, after - 1, after) if t.size > 1 else 0 * after
    shares = np.zeros((1, 1)) if limits is None else trajectory.joint_torque / np.asarray(limits)
    usual: dict[str, Any] = {
        "size": size, "fps": fps, "hub": scene.root == "pinned", "payload": arm.payload.mass > 0.0,
        "deflection": end_of_scale(float(np.abs(trajectory.tip_deflection).max())),
        "torque": max(1.0, end_of_scale(float(np.abs(shares).max()))),
    }  # fmt: skip
    kind = pictures_of(scene.axes)
    renderer = kind.pen(arm, mode, min(float(trajectory.shapes[..., -1].min()), 0.0), **usual)
    draw = kind.of_run(renderer, trajectory)
    try:
        for i in nearest.tolist():
            picture = draw(i, None if limits is None else shares[i])
            if renderer.closed:
                break
            if picture is not None:
                yield picture
    finally:
        renderer.close()


def film_path(path: str | os.PathLike[str]) -> Path:
    """Return the path of a film; raise ValueError if films cannot have this extension."""
    target = Path(path)
    if target.suffix.lower() not in (*FILMS, ".gif"):
        raise ValueError(f"video = {os.fspath(path)!r}: must end with one of {', '.join((*FILMS, '.gif'))}")
    return target


def write_film(path: str | os.PathLike[str], frames: Iterable[NDArray[np.uint8]], fps: float = 25.0) -> Path:
    """Write pictures to a film atomically.

    Args:
        path: path with the extension .mp4, .webm, .mkv, .mov or .gif. frames: pictures, (height, width, 3) uint8 each.
            fps: pictures per second.
    Raises:
        ValueError: the extension is not supported, fps is below FEWEST, a .gif is longer than LONGEST s, or there is no
            picture. DependencyNotInstalled: no installed package writes this format. OSError: writing
            failed, for example on a full disk.
    """
    target, fps = film_path(path), check.number("fps", fps, "1/s", minimum=FEWEST)
    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_name(f".{target.stem}.{os.getpid()}.part{target.suffix}")
    write = _write_gif if target.suffix.lower() == ".gif" else _write_ffmpeg
    try:
        write(part, iter(frames), fps)
        part.replace(target)
    except OSError as error:  # ffmpeg says a page, and no path
        code = errno.ENOSPC if shutil.disk_usage(target.parent).free < ROOM else errno.EIO
        why = os.strerror(code) if code == errno.ENOSPC else error.strerror or str(error).partition("\n")[0]
        raise OSError(code, f"the film could not be written: {why}", os.fspath(target)) from error
    finally:
        part.unlink(missing_ok=True)
    return target


def _write_ffmpeg(path: Path, frames: Iterator[NDArray[np.uint8]], fps: float) -> None:
    """Encode frames as H.264, or VP9 for .webm; raise OSError if the file contains fewer frames than were written."""
    ffmpeg = _import("imageio_ffmpeg", "imageio-ffmpeg")
    first = _first(frames)
    how: dict[str, Any] = {"quality": 8}
    if path.suffix.lower() == ".webm":  # which holds no H.264
        swift = ["-crf", "24", "-b:v", "0", "-deadline", "realtime", "-cpu-used", "6"]
        how = {"codec": "libvpx-vp9", "quality": None, "output_params": swift}
    writer = ffmpeg.write_frames(
        str(path), (first.shape[1], first.shape[0]), fps=fps, macro_block_size=2, ffmpeg_log_level="error", **how
    )
    writer.send(None)
    count = 1
    try:
        writer.send(first)
        for frame in frames:
            writer.send(np.ascontiguousarray(frame))
            count += 1
    finally:
        writer.close()
    try:  # ffmpeg's last words are not heard: what it could not write shows in the file
        found = ffmpeg.count_frames_and_secs(str(path))[0]
    except RuntimeError:
        found = 0
    if found < count:
        raise OSError(errno.EIO, f"{found} of {count} pictures came to be in it")


def _write_gif(path: Path, frames: Iterator[NDArray[np.uint8]], fps: float) -> None:
    """Write frames as a GIF with one palette; raise `InvalidValue` if fps makes it longer than `LONGEST` s."""
    image = _import("PIL.Image", "Pillow")
    every = [_first(frames), *frames]
    if not len(every) / fps <= LONGEST:
        what = f"must be at least {len(every) / LONGEST:.2g} (1/s) for {len(every)} pictures in a .gif"
        raise check.InvalidValue("fps", fps, what)
    some = np.concatenate(every[:: max(1, len(every) // 8)])
    # small patches keep their colours, and large ones have theirs to the letter
    palette = image.fromarray(some).quantize(256, method=image.Quantize.MAXCOVERAGE, kmeans=1)
    first, *rest = (image.fromarray(frame).quantize(palette=palette, dither=image.Dither.NONE) for frame in every)
    first.save(path, save_all=True, append_images=rest, duration=max(20, round(1000.0 / fps)), loop=0)


def _first(frames: Iterator[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    first = next(frames, None)
    if first is None:
        raise ValueError("frames: must hold one picture or more")
    return np.ascontiguousarray(first)


def _import(module: str, package: str) -> Any:
    with check.needs("such a film", package, "render", DependencyNotInstalled):
        return importlib.import_module(module)
