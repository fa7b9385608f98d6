"""Read and write the files of training runs; writing is atomic, and an error is reported in one sentence."""

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
from flexarm_env.records import choice, described, integer, number, rules, switch
from flexarm_env.suite.results import versions as versions
from flexarm_env.suite.score import FIRST
from flexarm_env.training.arguments import parse

T = TypeVar("T")

INTERRUPTED = 130
MOST_SEED = FIRST - 1001
"""Largest seed of a training run; its environments use a thousand seeds, beginning with it."""


def write_rows(path: Path, heads: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> None:
    """Write a CSV file atomically."""
    text = io.StringIO()
    writer = csv.DictWriter(text, heads, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(path, text.getvalue())


def report(folder: Path, title: str, began: float, lines: list[str]) -> None:
    """Write report.md with title, date, running time, versions and `lines`; print the lines.

    began: value of time.perf_counter at the start of the program.
    """
    made = " · ".join(f"{name} {version}" for name, version in versions().items())
    spent = f"{time.strftime('%Y-%m-%d')}, {time.perf_counter() - began:.0f} s in all"
    write_text(folder / "report.md", "\n".join([f"# {title}", "", f"{spent} · {made}", "", *lines]) + "\n")
    print("\n".join([*lines, f"The report: {folder / 'report.md'}"]), flush=True)


def own_folder(folder: Path, fresh: bool) -> Path:
    """Create the folder if it does not exist, and return it. fresh: True to empty the folder first."""
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
    """Parse a command line (`training.arguments.parse`) and call `work` with the result; return the exit code.

    An error is printed in one sentence, and the exit code is then 2.
    """
    arguments = parse(kind, program, description, words)
    try:
        return work(arguments) or 0
    except (ValueError, ImportError, DependencyNotInstalled) as error:
        return fail(error)


def fail(sentence: object) -> int:
    """Print an error in one line on standard error; return exit code 2."""
    sys.stderr.write(f"{' '.join(str(sentence).split())}\n")
    return 2


# ------------------------------------------------------------------ run folders
@described
@dataclass(frozen=True, kw_only=True)
class Training:
    """Arguments of programs that train a policy.

    Args:
        env: id of the environment.
        config: file of hyper-parameters in RL Zoo's format, or the name of such a file of the package, for example
            robust; default configs/ppo/default.yml.
        set: KEY=VALUE, a hyper-parameter that overrides the value in the config file; may be given several times.
        env_kwargs: keywords of the environment, as JSON; they override the keywords in the config file.
        out: run folder; default runs/ALGO-ENV-SEED.
        resume: continue from the last checkpoint in the run folder, or start a run if there is no checkpoint. Flags
            that would change the training are rejected.
    """

    env: str = "FlexibleArm-v0"
    config: Path | None = None
    set: tuple[str, ...] = ()
    env_kwargs: dict[str, Any] = field(default_factory=dict)
    seed: int = integer(
        "seed of all random numbers; larger seeds are reserved for evaluation", 0, minimum=0, maximum=MOST_SEED
    )
    n_timesteps: int | None = integer(
        "total number of environment steps, rounded to whole rollouts; default: the number in the config; with "
        "--resume, the new total of the run, even if it is finished", None, minimum=1, optional=True,
    )  # fmt: skip
    out: Path | None = None
    resume: bool = False
    evaluate_every: int = integer("environment steps from one evaluation to the next", 32_768, minimum=1)
    eval_episodes: int = integer("episodes per evaluation", 100, minimum=1)
    best_by: str = choice(
        ("settling", "return"), "criterion of the best policy: shortest settling time, or largest return", "settling",
    )  # fmt: skip
    solved_at: float = number("success rate at which the task counts as solved", "", 0.95, maximum=1.0)
    stop_when_solved: bool = switch("end the run when the task is solved", False)
    checkpoint_every: int = integer("environment steps from one checkpoint to the next", 131_072, minimum=1)
    threads: int = integer("threads of torch and NumPy; small networks are fastest with one", 1, minimum=1)
    tensorboard: bool = switch("write curves for TensorBoard", True)
    progress: bool = switch("show a progress bar", True)

    def begun(self, *kept: str, algorithm: str | None = None) -> Self:
        """Validate and return the arguments of a new run, or of a run to be resumed.

        A resumed run keeps its original arguments except the arguments named in `kept`. Raises ValueError in four
        cases: the folder of a new run already contains a run; a finished run is resumed without a larger --n-timesteps;
        the run belongs to another algorithm; or the seed is reserved for evaluation.
        """
        own = self._resumed(kept, algorithm) if self.resume else self
        if not isinstance(own.seed, int) or not 0 <= own.seed <= MOST_SEED:
            what = f"must be from 0 to {MOST_SEED}; seeds from {FIRST} on are reserved for evaluation"
            raise ValueError(f"--seed {own.seed}: {what}")
        for name, rule in rules(type(own)).items():
            rule(f"--{name.replace('_', '-')}", getattr(own, name))
        check.table_of("--env-kwargs", own.env_kwargs)
        if own.folder.is_file():
            raise check.InvalidValue("--out", str(own.folder), "must be a folder, and this is a file")
        if not own.resume and (own.folder / "run.json").exists():
            raise ValueError(f"{own.folder}: contains a run already; continue it with --resume or choose another --out")
        return own

    def _resumed(self, kept: Iterable[str], algorithm: str | None) -> Self:
        """Return the recorded arguments of the run to be resumed; raise ValueError if others would change it."""
        folder, record = self.folder, read_run(self.folder)
        if algorithm is not None and record["algorithm"] != algorithm:
            raise ValueError(f"{folder}: a run of {record['algorithm']}, not of {algorithm}")
        told = check.table_of(f"{folder / 'run.json'}: arguments", record.get("arguments"))
        values = {k: v for k, v in told.items() if k in check.names_of(self)}
        # a finished run can only be extended
        if record.get("finished"):
            done, begun = int(record.get("steps", 0)), f"{folder}: that run has finished"
            if self.n_timesteps is None:
                raise ValueError(f"{begun}; there is nothing to resume, but --n-timesteps N extends it to N steps")
            if self.n_timesteps <= done:
                raise ValueError(f"--n-timesteps {self.n_timesteps}: must be more than the {done} steps of {folder}")
            if not checkpoints(folder):
                raise ValueError(f"{begun} and has no checkpoint, so that it cannot be extended")
        for name, given in check.changed(self).items():
            own = name in values and name not in ("out", "resume", "n_timesteps", "config", "set", *kept)
            if own and given != {} and str(given) != str(values[name]):
                what = f"must be {values[name]!r} with --resume, or left out"
                raise check.InvalidValue(f"--{name.replace('_', '-')}", given, what)
        if self.set or self.config is not None:
            flag = "--set" if self.set else "--config"
            raise ValueError(f"{flag}: must be left out with --resume: {folder / 'config.yml'} holds")
        values |= {"config": folder / "config.yml", "out": folder, "resume": True, "set": ()}
        if self.n_timesteps is not None:
            values["n_timesteps"] = self.n_timesteps
        return type(self)(**values | {name: getattr(self, name) for name in kept})

    @property
    def folder(self) -> Path:
        """Folder of the run."""
        return self.out or Path("runs") / f"{self.name}-{self.env}-{self.seed}"

    @property
    def name(self) -> str:
        """Prefix of the names of run folders."""
        raise NotImplementedError


OF_POLICY = (
    "env_id", "env_kwargs", "asked", "layout", "scales", "torque_limits", "seed", "algorithm", "versions", "around",
)  # fmt: skip
"""Entries of a run's record that are copied into a policy's file."""


def new_record(arguments: Any, algorithm: str, env_kwargs: dict[str, Any], setup: Any, **more: Any) -> dict[str, Any]:
    """Return the content of run.json at the start of a run.

    setup: result of `Setup.of` for the training environment.
    """
    given = {k: str(v) if isinstance(v, Path) else v for k, v in dataclasses.asdict(arguments).items()}
    return {
        "algorithm": algorithm, "env_id": arguments.env, "env_kwargs": env_kwargs, "layout": setup.layout,
        "scales": dict(zip(setup.names, setup.scales, strict=True)), "torque_limits": list(setup.torque_limits),
        "seed": arguments.seed, "arguments": given, "versions": versions(), "finished": False, **more,
    }  # fmt: skip


def read_run(run: Path) -> dict[str, Any]:
    """Read the record (run.json) of a run folder. Raises ValueError if the folder has no run.json."""
    if not run.is_dir():
        raise ValueError(f"{run}: no such run folder")
    if not (run / "run.json").is_file():
        raise ValueError(f"{run}: not a run folder, it has no run.json")
    record = read_json(run / "run.json")
    for key in ("algorithm", "env_id", "env_kwargs", "layout"):
        if not isinstance(record, dict) or key not in record:
            raise ValueError(f"{run / 'run.json'}: damaged: it lacks {key}")
    check.table_of(f"{run / 'run.json'}: env_kwargs", record["env_kwargs"])
    return dict(record)


def checkpoints(folder: Path) -> list[Path]:
    """Return the complete checkpoints of the run, oldest first."""
    return sorted(p for p in (folder / "checkpoints").glob("[0-9]*") if (p / "state.pkl").is_file())


@contextlib.contextmanager
def new_checkpoint(folder: Path, steps: int, best: Iterable[str]) -> Iterator[Path]:
    """Yield an empty folder for a `with` block; at the block's end the folder atomically becomes a checkpoint.

    The last two checkpoints are kept. steps: environment steps so far. best: names of the files of the best model so
    far. The checkpoint contains copies of the best model's files, so that model and learning curve are restored
    together.
    """
    home = folder / "checkpoints"
    part, final = home / f".part-{os.getpid()}", home / f"{steps:012d}"
    shutil.rmtree(part, ignore_errors=True)
    try:
        # a renamed folder is complete: an interrupted save leaves no partial checkpoint
        part.mkdir(parents=True)
        for name in best:
            if (folder / name).is_file():
                shutil.copyfile(folder / name, part / f"best-{name}")
        yield part
        shutil.rmtree(final, ignore_errors=True)
        part.rename(final)
    except OSError as error:  # the message of a full disk does not name the file
        raise OSError(error.errno, error.strerror or str(error), os.fspath(home)) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    for old in checkpoints(folder)[:-2]:
        shutil.rmtree(old)


def restored(folder: Path, read: Callable[[Path, Any], T]) -> T:
    """Restore the last readable checkpoint and the best files; return the result of `read(folder, state)`."""
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
    """Load a folder's model and VecNormalize statistics (or None); raise ValueError if a file is unreadable."""
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
    """Load the VecNormalize statistics of a model from a file.

    Raises ValueError if the file contains no VecNormalize statistics, or the statistics of another model.
    """
    try:
        with path.open("rb") as file:
            found = pickle.load(file)
        taken, given = found.observation_space.shape, model.observation_space.shape
    except Exception as error:
        raise ValueError(f"{path}: damaged ({type(error).__name__})") from error
    if taken != given:
        raise ValueError(f"{path}: of observations of shape {taken}; the model's are {given}")
    return found
