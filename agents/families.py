"""Train the policies that ship with the repository, and copy them to their folders.

    python -m agents.families                        # train and publish all missing runs: an hour on two cores
    python -m agents.families --only flexible_arm    # one family

Runs are written to runs/families/NAME-SEED. An interrupted run is continued; a finished run is kept. The essential
files of each run are copied to agents/trained/NAME-SEED. The policy.npz of the best seed, by the validation episodes,
is copied into the package as flexarm_env/data/policies/NAME/policy.npz. `python -m agents.table` evaluates these
policies.
"""

import os
import shutil
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from flexarm_env import validation as check
from flexarm_env.training.runs import command, load_model, read_run, write_json, write_whole

ROOT = Path(__file__).resolve().parents[1]
TRAINED = ROOT / "agents" / "trained"
PACKAGED = ROOT / "flexarm_env" / "data" / "policies"
CONTROL = ("pd", "zv", "zvd", "lqr", "mpc")
RECORDED = {"rules": 1}
"""Keywords of the episodes in which the pages of results are recorded: starts and rewards of rules 1."""


@dataclass(frozen=True)
class Family:
    """Training runs that differ only in their seed.

    Args:
        name: name of the policy. env: id of the environment. config: file in configs/ppo. seeds: number of runs.
        test: number of test episodes. controllers: controllers in the same table. every: environment steps from one
            evaluation to the next. published: whether the package contains the best policy of the runs.
    """

    name: str
    env: str
    config: str
    seeds: int
    test: int = 100
    controllers: tuple[str, ...] = CONTROL
    every: int = 32_768
    published: bool = True

    @property
    def task(self) -> str:
        """Task of the environment: "slew" or "reach"."""
        return {"FlexibleArm-v0": "slew", "TwoLinkFlexArm-v0": "reach"}[self.env]

    def runs(self, home: Path) -> list[Path]:
        """Return the existing run folders, ordered by seed."""
        folders = [home / f"{self.name}-{seed}" for seed in range(self.seeds)]
        return [folder for folder in folders if (folder / "policy.npz").is_file()]

    def best(self, home: Path) -> Path:
        """Return the run folder of the seed with the best result on the validation episodes.

        Raises ValueError if the family has no run.
        """
        found = self.runs(home)
        if not found:
            raise ValueError(f"{home}: no run of {self.name}; python -m agents.families --only {self.name} trains it")
        return min(found, key=lambda folder: float(read_run(folder)["best"]))


FAMILIES = (
    Family("flexible_arm", "FlexibleArm-v0", "default.yml", 5, controllers=(*CONTROL, "time_optimal")),
    Family("flexible_arm_robust", "FlexibleArm-v0", "robust.yml", 1),
    Family("two_link", "TwoLinkFlexArm-v0", "residual.yml", 5, test=200, every=131_072),
    Family("two_link_torque", "TwoLinkFlexArm-v0", "default.yml", 1, test=200, every=65_536),
    Family("two_link_robust", "TwoLinkFlexArm-v0", "robust.yml", 1, test=200, every=131_072),
    Family("flexible_arm_measured", "FlexibleArm-v0", "measured.yml", 1, published=False),
    Family("flexible_arm_geared", "FlexibleArm-v0", "geared.yml", 1, published=False),
    Family("two_link_geared", "TwoLinkFlexArm-v0", "geared.yml", 2, published=False, every=131_072),
)


def named(name: str) -> Family:
    """Return the family with the given name."""
    known = {family.name: family for family in FAMILIES}
    return known[check.choice("--only", name, tuple(known))]


@dataclass(frozen=True)
class Arguments:
    """Arguments of `python -m agents.families`.

    Args:
        only: names of families, separated by commas; default all families.
        home: folder of the runs.
        progress: show progress bars.
    """

    only: str | None = None
    home: Path = Path("runs/families")
    progress: bool = True


def train(family: Family, seed: int, home: Path, progress: bool) -> None:
    """Train a run unless it is finished."""
    from flexarm_env.training import train as train_ppo
    from flexarm_env.training.progress import finished

    folder, config = home / f"{family.name}-{seed}", Path(os.path.relpath(ROOT / "configs" / "ppo" / family.config))
    given = {"env": family.env, "config": config, "seed": seed, "tensorboard": False, "progress": progress}
    print(f"{folder}: {finished(train_ppo, folder, evaluate_every=family.every, **given)}", flush=True)


def publish(folder: Path, with_model: bool = False) -> None:
    """Copy a run's essential files to agents/trained; with_model: also model.zip, without the optimizer's state."""
    final = TRAINED / folder.name
    shutil.rmtree(final, ignore_errors=True)
    final.mkdir(parents=True)
    for name in ("policy.npz", "config.yml", "learning_curve.csv"):
        shutil.copyfile(folder / name, final / name)
    record = read_run(folder)
    record["arguments"] = {k: v for k, v in record["arguments"].items() if k != "out"}
    write_json(final / "run.json", record)
    if with_model:
        model, normaliser = load_model(folder, record["algorithm"])
        if normaliser is not None:
            shutil.copyfile(folder / "vecnormalize.pkl", final / "vecnormalize.pkl")
        model.policy.optimizer.state.clear()
        write_whole(final / "model.zip", model.save)


def publish_family(family: Family, home: Path) -> None:
    """Copy all runs of a family to agents/trained, and its best policy into the package."""
    best = family.best(home)
    for folder in family.runs(home):
        publish(folder, with_model=folder == best)
    if family.published:
        target = PACKAGED / family.name / "policy.npz"
        write_whole(target, lambda part: shutil.copyfile(best / "policy.npz", part))


def train_all(arguments: Arguments) -> None:
    """Train all missing runs and copy all policies to their folders."""
    chosen = FAMILIES if arguments.only is None else [named(name) for name in arguments.only.split(",")]
    for family in chosen:
        for seed in range(family.seeds):
            train(family, seed, arguments.home, arguments.progress)
        publish_family(family, arguments.home)


main = partial(command, Arguments, "python -m agents.families", __doc__, train_all)

if __name__ == "__main__":
    sys.exit(main())
