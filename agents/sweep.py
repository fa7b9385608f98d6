"""Train one policy for each combination of reward weights or arm parameters, with Ray Tune, and compare the policies.

    python -m agents.sweep --space '{"reward.vibration": [0.0, 0.02, 0.2, 2.0]}'
    python -m agents.sweep --space '{"payload": [0.5, 1.0, 2.0], "reward.effort": [0.01, 0.1]}' --out runs/sweep-arm
    python -m agents.sweep --out runs/sweep-arm --resume

A key of --space is a keyword of the environment, with dots for keys of its tables (reward.effort), or a parameter of
the arm: payload, EI or damping. A parameter is a factor on the nominal value in training and in evaluation. All
combinations are trained, each in its own process; the number of simultaneous trials is the number of processors. The
output folder contains trials/NAME, which are run folders like those of `agents.train_rllib`, and results.csv,
results.md and results.png. All policies are evaluated on the same episodes, by the environment's default reward. With
--resume an interrupted sweep continues, each trial from its last checkpoint.
"""

import dataclasses
import itertools
import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from agents.rllib import cluster
from flexarm_env.files import table
from flexarm_env.training import episodes
from flexarm_env.training.runs import INTERRUPTED, command, read_json, read_run, write_json, write_rows, write_text

ARM = ("payload", "EI", "damping")
SHOWN = {
    "success_rate": "success", "settling_time_median": "settling (s)", "residual_vibration_median": "vibration (mm)",
    "overshoot_median": "overshoot (%)", "effort_median": "effort (s)", "return_mean": "return",
}  # fmt: skip
"""Columns of the results, see `training.statistics`: medians over the episodes, but means for success and return."""

DRAWN = ("success_rate", "settling_time_median", "residual_vibration_median", "effort_median")


@dataclass(frozen=True)
class Arguments:
    """Arguments of `python -m agents.sweep`.

    Args:
        space: varied keywords and parameters, as JSON: key -> list of values.
        env: id of the environment.
        config: file of hyper-parameters, RL Zoo format; default configs/ppo/default.yml.
        env_kwargs: further keywords of the environment in every trial, as JSON.
        seeds: number of runs of each combination, with seeds 0, 1, ...
        n_timesteps: environment steps of each trial; default the config's.
        eval_episodes: number of episodes on which every policy is evaluated.
        out: folder of all results.
        resume: continue the sweep in that folder (with its own flags, except --address).
        address: address of a Ray cluster, whose nodes must share the folder; default a Ray of its own on this machine.
        at_once: number of trials that run at the same time; default the number of processors.
    """

    space: dict[str, Any] = field(default_factory=dict)
    env: str = "FlexibleArm-v0"
    config: Path | None = None
    env_kwargs: dict[str, Any] = field(default_factory=dict)
    seeds: int = 1
    n_timesteps: int | None = None
    eval_episodes: int = 100
    out: Path = Path("runs/sweep")
    resume: bool = False
    address: str | None = None
    at_once: int | None = None


# ------------------------------------------------------------------ what is run
def choices(space: Mapping[str, Any], seeds: int) -> list[dict[str, Any]]:
    """Return all combinations of the varied values and seeds. ValueError names an invalid key."""
    if not space:
        raise ValueError("--space: must name something to vary, such as '{\"reward.effort\": [0.01, 0.1]}'")
    for key, values in space.items():
        if not isinstance(values, list) or not values:
            raise ValueError(f"--space {key} = {values!r}: must be a list of values")
    if seeds < 1:
        raise ValueError(f"--seeds {seeds}: must be a whole number from 1")
    combined = itertools.product(*space.values(), range(seeds))
    return [dict(zip((*space, "seed"), values, strict=True)) for values in combined]


def keywords(choice: Mapping[str, Any], common: Mapping[str, Any]) -> dict[str, Any]:
    """Return the environment's keywords for a combination."""
    kwargs: dict[str, Any] = json.loads(json.dumps(common))
    for key, value in choice.items():
        if key == "seed":
            continue
        if key in ARM:
            kwargs.setdefault("randomization", {})[key] = [value, value]
            continue
        *tables, last = key.split(".")
        place = kwargs
        for name in tables:
            place = place.setdefault(name, {})
        place[last] = value
    return kwargs


def name_of(choice: Mapping[str, Any]) -> str:
    """Return the folder name of a combination."""
    words = [f"{key.rpartition('.')[2]}={value}" for key, value in choice.items()]
    return "".join(c if c.isalnum() or c in "=.,-_" else "_" for c in ",".join(words))


def check(arguments: Arguments, wanted: list[dict[str, Any]]) -> None:
    """Make each trial's environment once, so that an unknown key or invalid value raises ValueError before training."""
    for choice in wanted:
        try:
            episodes.make_episodes(arguments.env, 1, **keywords(choice, arguments.env_kwargs)).close()
        except TypeError as error:
            raise ValueError(f"--space: {error}") from error


def trial(config: Mapping[str, Any], told: Mapping[str, Any]) -> None:
    """Run one trial in its own process: train, resume or keep the run, evaluate the policy, and report the result."""
    from ray import tune

    from agents.train_rllib import Arguments as Training
    from agents.train_rllib import train

    given = told[config["choice"]]
    folder = Path(given["run"]["out"])
    if not (folder / "judged.json").is_file():
        if not (folder / "run.json").is_file():
            train(Training(**given["run"] | {"out": folder}))
        elif not read_run(folder).get("finished"):
            train(Training(out=folder, resume=True, runners=0, progress=False))
        write_json(folder / "judged.json", judge(folder, given["env"], given["kwargs"], given["episodes"]))
    row = read_json(folder / "judged.json")
    tune.report({key: row[key] for key in SHOWN})


def judge(folder: Path, env_id: str, kwargs: Mapping[str, Any], n: int) -> dict[str, Any]:
    """Evaluate a run's policy on test episodes with its training's arm and the default reward; return the summary."""
    from flexarm_env.control import load_policy
    from flexarm_env.training.statistics import summary

    own = {k: v for k, v in kwargs.items() if k not in episodes.TRAINING_ONLY}
    env = episodes.make_episodes(env_id, n, **own)
    found = summary(episodes.run(env, load_policy(folder), episodes.TEST))
    env.close()
    return found


# ------------------------------------------------------------------ the sweep
def sweep(arguments: Arguments) -> list[dict[str, Any]]:
    """Run the missing trials of the sweep; return the rows of its results. ValueError describes invalid arguments."""
    out = arguments.out.absolute()
    if arguments.resume:
        arguments = _resumed(arguments)
    elif (out / "sweep.json").exists():
        raise ValueError(f"{arguments.out}: holds a sweep already; go on with it by --resume, or choose another --out")
    wanted = choices(arguments.space, arguments.seeds)
    check(arguments, wanted)
    from agents.rllib import setup

    cluster.need_ray()
    setup.load(arguments.config, arguments.env)
    cluster.connect(arguments.address, 1)
    if not arguments.resume:
        text = {k: str(v) if isinstance(v, Path) else v for k, v in dataclasses.asdict(arguments).items()}
        write_json(out / "sweep.json", text)
    given = [_given(arguments, choice, out) for choice in wanted]
    failed = _tuned(arguments, given, out)
    rows = [
        {**choice, **{key: found[key] for key in SHOWN}}
        for choice, each in zip(wanted, given, strict=True)
        if (path := Path(each["run"]["out"]) / "judged.json").is_file()
        for found in [read_json(path)]
    ]
    if rows:
        write(out, rows, list(arguments.space), arguments.env)
    if failed:
        raise ValueError(f"{arguments.out}: {failed} of {len(wanted)} trials failed; go on by --resume")
    return rows


def _given(arguments: Arguments, choice: dict[str, Any], out: Path) -> dict[str, Any]:
    """Return the arguments of a trial."""
    kwargs = keywords(choice, arguments.env_kwargs)
    run: dict[str, Any] = {
        "env": arguments.env, "config": None if arguments.config is None else arguments.config.absolute(),
        "env_kwargs": kwargs, "seed": choice["seed"], "n_timesteps": arguments.n_timesteps, "runners": 0,
        "out": out / "trials" / name_of(choice), "progress": False,
    }  # fmt: skip
    return {"run": run, "env": arguments.env, "kwargs": kwargs, "episodes": arguments.eval_episodes}


def _tuned(arguments: Arguments, given: list[dict[str, Any]], out: Path) -> int:
    """Let Tune run all trials, or the missing ones; return the number of failed trials."""
    import os

    from ray import tune

    os.environ.setdefault("RAY_CHDIR_TO_TRIAL_DIR", "0")
    kept = out / "tune"
    told = {each["run"]["out"].name: each for each in given}
    trainable = tune.with_resources(tune.with_parameters(trial, told=told), {"cpu": 1})
    if arguments.resume and tune.Tuner.can_restore(str(kept)):
        tuner = tune.Tuner.restore(str(kept), trainable, resume_unfinished=True, restart_errored=True)
    else:
        tuner = tune.Tuner(
            trainable,
            param_space={"choice": tune.grid_search(list(told))},
            tune_config=tune.TuneConfig(
                max_concurrent_trials=arguments.at_once, trial_dirname_creator=_folder, trial_name_creator=_folder
            ),
            run_config=tune.RunConfig(name="tune", storage_path=str(out), verbose=0),
        )
    return int(tuner.fit().num_errors)


def _folder(trial: Any) -> str:
    """Return the name of Tune's own folder for a trial."""
    return str(trial.config.get("choice", trial.trial_id))


def _resumed(arguments: Arguments) -> Arguments:
    """Return the arguments with which the sweep was started."""
    path = arguments.out / "sweep.json"
    if not path.is_file():
        raise ValueError(f"{arguments.out}: holds no sweep, it has no sweep.json")
    known = {f.name for f in dataclasses.fields(Arguments)}
    values = {k: v for k, v in read_json(path).items() if k in known}
    values["config"] = None if values["config"] is None else Path(values["config"])
    return Arguments(**values | {"out": arguments.out, "resume": True, "address": arguments.address})


# ------------------------------------------------------------------ results
def write(out: Path, rows: list[dict[str, Any]], varied: list[str], env_id: str) -> None:
    """Write results.csv, results.md and results.png."""
    write_rows(out / "results.csv", list(rows[0]), rows)
    cells = []
    for row in rows:
        shown = (f"{row[key]:.0%}" if key == "success_rate" else f"{row[key]:.3g}" for key in SHOWN)
        cells.append([*(row[key] for key in (*varied, "seed")), *shown])
    lines = table(" | ".join([*varied, "seed", *SHOWN.values()]), cells, numbers=True)
    write_text(out / "results.md", "\n".join(lines) + "\n")
    from flexarm_env.training.figures import compared

    drawn = {key: SHOWN[key] for key in DRAWN}
    compared(rows, varied, drawn, out / "results.png", env_id)


def run(arguments: Arguments) -> int:
    """Run the missing trials and print the path of the results."""
    try:
        rows = sweep(arguments)
    except KeyboardInterrupt:
        sys.stderr.write(f"interrupted; go on with: python -m agents.sweep --out {arguments.out} --resume\n")
        return INTERRUPTED
    print((arguments.out / "results.md").read_text("utf-8"), end="")
    print(f"{len(rows)} trials: {arguments.out / 'results.md'}, results.csv, results.png")
    return 0


main = partial(command, Arguments, "python -m agents.sweep", __doc__, run)

if __name__ == "__main__":
    sys.exit(main())
