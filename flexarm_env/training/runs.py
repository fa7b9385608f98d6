"""Files that runs leave behind: written whole or not at all; and errors told in a sentence."""

import contextlib
import csv
import dataclasses
import functools
import io
import os
import pickle
import shutil
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self, TypeVar

from gymnasium.error import DependencyNotInstalled

from flexarm_env import validation as check
from flexarm_env.files import read_json as read_json
from flexarm_env.files import write_json as write_json
from flexarm_env.files import write_text as write_text
from flexarm_env.files import write_whole as write_whole
from flexarm_env.suite.results import versions as versions
from flexarm_env.suite.score import FIRST
from flexarm_env.training.arguments import parse

T = TypeVar("T")

INTERRUPTED = 130
MOST_SEED = FIRST - 1001
"""Of a training run, whose environments have the thousand seeds from it on."""


def write_rows(path: Path, heads: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> None:
    """Write a CSV file, whole or not at all."""
    text = io.StringIO()
    writer = csv.DictWriter(text, heads, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(path, text.getvalue())


def report(folder: Path, title: str, began: float, lines: list[str]) -> None:
    """Write report.md of what began at `began` (time.perf_counter), and print its lines."""
    made = " · ".join(f"{name} {version}" for name, version in versions().items())
    spent = f"{time.strftime('%Y-%m-%d')}, {time.perf_counter() - began:.0f} s in all"
    write_text(folder / "report.md", "\n".join([f"# {title}", "", f"{spent} · {made}", "", *lines]) + "\n")
    print("\n".join([*lines, f"The report: {folder / 'report.md'}"]), flush=True)


def own_folder(folder: Path, fresh: bool) -> Path:
    """The folder, made where it is not there; empty where it is to be begun anew."""
    if fresh and folder.exists():
        shutil.rmtree(folder)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def command(
    kind: type[T],
    program: str,
    description: str | None,
    work: Callable[[T], int | None],
    words: Sequence[str] | None = None,
) -> int:
    """Parse a command line (`arguments`) and do the work; exit code, 2 with a sentence for what is wrong or lacking."""
    arguments = parse(kind, program, description, words)
    try:
        return work(arguments) or 0
    except (ValueError, ImportError, DependencyNotInstalled) as error:
        return fail(error)


def fail(sentence: object) -> int:
    """Print what is wrong, in one line, on standard error; the exit code 2."""
    sys.stderr.write(f"{' '.join(str(sentence).split())}\n")
    return 2


# ------------------------------------------------------------------ run folders
@dataclass(frozen=True, kw_only=True)
class Training:
    """What programs take that train a policy.

    Args:
        env: id of the environment.
        config: file of hyper-parameters, RL Zoo format, or the name of one that comes with the package, such as robust;
            default configs/ppo/default.yml.
        env_kwargs: keywords of the environment, as JSON; they go before those of the config file.
        seed: of everything.
        n_timesteps: environment steps in all, whole rollouts of them; default the config's.
        out: run folder; default runs/ALGO-ENV-SEED.
        resume: go on from the run folder's last checkpoint, or anew where it has none yet (other flags are then those
            of the run).
        evaluate_every: environment steps from one evaluation to the next.
        eval_episodes: episodes of an evaluation.
        best_by: which policy is kept: "settling" (soonest at rest, with success) or "return".
        solved_at: success rate from which the task counts as solved.
        stop_when_solved: end the run there.
        checkpoint_every: environment steps from one checkpoint to the next.
        threads: of torch; networks this small are quickest with one.
        tensorboard: write curves for TensorBoard.
        progress: show a progress bar.
    """

    env: str = "FlexibleArm-v0"
    config: Path | None = None
    env_kwargs: dict[str, Any] = field(default_factory=dict)
    seed: int = 0
    n_timesteps: int | None = None
    out: Path | None = None
    resume: bool = False
    evaluate_every: int = 32_768
    eval_episodes: int = 100
    best_by: str = "settling"
    solved_at: float = 0.95
    stop_when_solved: bool = False
    checkpoint_every: int = 131_072
    threads: int = 1
    tensorboard: bool = True
    progress: bool = True

    def begun(self, *kept: str, algorithm: str | None = None) -> Self:
        """The arguments of the run, new, or those that the one to be gone on with was started with, but `kept` as given
        now. ValueError for one that is there already, that has finished or is another's, or whose seed is one of those
        that policies are judged on."""
        own = self._resumed(kept, algorithm) if self.resume else self
        if not isinstance(own.seed, int) or not 0 <= own.seed <= MOST_SEED:
            what = f"must be from 0 to {MOST_SEED}; those from {FIRST} on are for judging"
            raise ValueError(f"--seed {own.seed}: {what}")
        for name in ("n_timesteps", "evaluate_every", "eval_episodes", "checkpoint_every", "threads"):
            if getattr(own, name) is not None:
                check.integer(f"--{name.replace('_', '-')}", getattr(own, name), minimum=1)
        check.table_of("--env-kwargs", own.env_kwargs)
        check.number("--solved-at", own.solved_at, maximum=1.0)
        if own.folder.is_file():
            raise check.InvalidValue("--out", str(own.folder), "must be a folder, and this is a file")
        check.choice("--best-by", own.best_by, ("settling", "return"))
        if not own.resume and (own.folder / "run.json").exists():
            raise ValueError(f"{own.folder}: holds a run already; go on with it by --resume, or choose another --out")
        return own

    def _resumed(self, kept: Iterable[str], algorithm: str | None) -> Self:
        folder, record = self.folder, read_run(self.folder)
        if algorithm is not None and record["algorithm"] != algorithm:
            raise ValueError(f"{folder}: a run of {record['algorithm']}, not of {algorithm}")
        if record.get("finished"):
            raise ValueError(f"{folder}: that run has finished; there is nothing to resume")
        told = check.table_of(f"{folder / 'run.json'}: arguments", record.get("arguments"))
        values = {k: v for k, v in told.items() if k in check.names_of(self)}
        values |= {"config": folder / "config.yml", "out": folder, "resume": True}
        return type(self)(**values | {name: getattr(self, name) for name in kept})

    @property
    def folder(self) -> Path:
        """The run folder."""
        return self.out or Path("runs") / f"{self.name}-{self.env}-{self.seed}"

    @property
    def name(self) -> str:
        """What run folders are named for."""
        raise NotImplementedError


OF_POLICY = ("env_id", "env_kwargs", "layout", "scales", "torque_limits", "seed", "algorithm", "versions")
"""What a policy's file has of its run's record."""


def new_record(arguments: Any, algorithm: str, env_kwargs: dict[str, Any], setup: Any, **more: Any) -> dict[str, Any]:
    """What run.json says of a run at its start; setup: what `Setup.of` the environment it trains in."""
    given = {k: str(v) if isinstance(v, Path) else v for k, v in dataclasses.asdict(arguments).items()}
    return {
        "algorithm": algorithm, "env_id": arguments.env, "env_kwargs": env_kwargs, "layout": setup.layout,
        "scales": dict(zip(setup.names, setup.scales, strict=True)), "torque_limits": list(setup.torque_limits),
        "seed": arguments.seed, "arguments": given, "versions": versions(), "finished": False, **more,
    }  # fmt: skip


def read_run(run: Path) -> dict[str, Any]:
    """The record (run.json) of a run folder. ValueError with a sentence where there is none."""
    if not run.is_dir():
        raise ValueError(f"{run}: no such run folder")
    if not (run / "run.json").is_file():
        raise ValueError(f"{run}: not a run folder, it has no run.json")
    record = read_json(run / "run.json")
    for key in ("algorithm", "env_id", "env_kwargs", "layout"):
        if not isinstance(record, dict) or key not in record:
            raise ValueError(f"{run / 'run.json'}: damaged, it does not say {key}")
    check.table_of(f"{run / 'run.json'}: env_kwargs", record["env_kwargs"])
    return dict(record)


def checkpoints(folder: Path) -> list[Path]:
    """Complete checkpoints, oldest first."""
    return sorted(p for p in (folder / "checkpoints").glob("[0-9]*") if (p / "state.pkl").is_file())


@contextlib.contextmanager
def new_checkpoint(folder: Path, steps: int, best: Iterable[str]) -> Iterator[Path]:
    """A folder to be filled, which then is the checkpoint after so many steps, whole or not at all; the last two stay.

    best: files of the run folder's best so far, to fall back to together with the curve.
    """
    home = folder / "checkpoints"
    part, final = home / f".part-{os.getpid()}", home / f"{steps:012d}"
    shutil.rmtree(part, ignore_errors=True)
    try:
        part.mkdir(parents=True)
        for name in best:
            if (folder / name).is_file():
                shutil.copyfile(folder / name, part / f"best-{name}")
        yield part
        shutil.rmtree(final, ignore_errors=True)
        part.rename(final)
    except OSError as error:  # a full disk's does not say what it is about
        raise OSError(error.errno, error.strerror or str(error), os.fspath(home)) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    for old in checkpoints(folder)[:-2]:
        shutil.rmtree(old)


def restored(folder: Path, read: Callable[[Path, Any], T]) -> T:
    """What `read` makes of the last checkpoint that can be read, its folder and state; the best files come back too."""
    problem = f"{folder}: no checkpoint to resume from"
    for path in reversed(checkpoints(folder)):
        try:
            with (path / "state.pkl").open("rb") as file:
                found = read(path, pickle.load(file))
        except Exception as error:
            problem = f"{path}: damaged, or of other arguments ({type(error).__name__})"
            continue
        for kept in path.glob("best-*"):
            write_whole(folder / kept.name.removeprefix("best-"), functools.partial(shutil.copyfile, kept))
        return found
    raise ValueError(problem)


def load_model(folder: Path, algorithm: str) -> tuple[Any, Any]:
    """Model and VecNormalize statistics (or None) of a folder; ValueError with a sentence where they cannot be read."""
    import torch

    from flexarm_env.training.config import algorithm_class

    path = folder / "model.zip"
    if not path.is_file():
        raise ValueError(f"{path}: no such file")
    try:
        model = algorithm_class(algorithm).load(path, device="cpu")
    except Exception as error:  # a damaged zip fails in many ways
        raise ValueError(f"{path}: damaged, or of other versions ({type(error).__name__})") from error
    for name, values in model.policy.state_dict().items():
        if not torch.isfinite(values).all():
            raise ValueError(f"{path}: {name} holds numbers that are not finite")
    statistics = folder / "vecnormalize.pkl"
    if not statistics.is_file():
        return model, None
    normaliser = load_normaliser(statistics, model)
    normaliser.training = False
    return model, normaliser


def load_normaliser(path: Path, model: Any) -> Any:
    """The VecNormalize statistics of a model in a file. ValueError for what is none, or another model's."""
    try:
        with path.open("rb") as file:
            found = pickle.load(file)
        taken, given = found.observation_space.shape, model.observation_space.shape
    except Exception as error:
        raise ValueError(f"{path}: damaged ({type(error).__name__})") from error
    if taken != given:
        raise ValueError(f"{path}: of observations of shape {taken}; the model's are {given}")
    return found
