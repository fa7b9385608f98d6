"""`make demo`: replay three scenes, train a first policy, and evaluate it together with classical controllers.

    python -m agents.demo [--out runs/demo] [--steps 600000] [--seed 0] [--fresh]

Two of the scenes are compared with their references; the third is in space. The output folder contains figures, the
trained run and report.md. Existing results are kept: a second call continues where the first call stopped (--fresh
starts again).
"""

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from flexarm_env.training.runs import command, own_folder, report

SCENES = ("robot_arm_motion", "robot_arm_motion_smooth")
FORMULATIONS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("floating frame, 1 segment of 5 elements", "floating_frame", {"segments": 1, "elements": 5}),
    ("floating frame, 8 segments", "floating_frame", {"segments": 8, "elements": 1, "dt": 0.025}),
    ("geometrically exact, 5 quadratic elements", "geometrically_exact", {"elements": 5, "dt": 0.005}),
    ("elastica, 8 nodes", "elastica", {"nodes": 8, "dt": 0.005}),
)
SPACE = "three_dof_slew"
ENV = "FlexibleArm-v0"
CONTROLLERS = ("pd", "zvd", "lqr", "time_optimal")


@dataclass(frozen=True)
class Arguments:
    """Arguments of `python -m agents.demo`.

    Args:
        out: folder of all results.
        steps: environment steps of the training run.
        seed: seed of the training run.
        fresh: remove the contents of the folder first.
    """

    out: Path = Path("runs/demo")
    steps: int = 600_000
    seed: int = 0
    fresh: bool = False


say = partial(print, flush=True)
"""Function that prints a line of progress."""


def replay(out: Path) -> list[str]:
    """Run the scenes under every formulation and draw them; return the report's lines."""
    from flexarm_env.comparison import tip_error
    from flexarm_env.plotting import plot_comparison, plot_trajectory
    from flexarm_env.scenes import named, reference
    from flexarm_env.simulation import simulate

    lines = [
        "## Scenes of the paper against references",
        "",
        "Largest and rms distance of the tip (arm of 10 m). One floating frame is known to be too few for such",
        "deflections, and the arm is too stubby for the elastica; both are here to show it.",
        "",
        "| scene | formulation | max, m | rms, m | CPU s per simulated s | Newton iterations a step | status |",
        "|---|---|---|---|---|---|---|",
    ]
    for name in SCENES:
        known = reference(name)
        runs = {}
        for label, formulation, options in FORMULATIONS:
            say(f"  {name}: {label}")
            run = simulate(named(name), formulation, **options)
            runs[label] = run
            error = tip_error(run.t, run.tip, known.columns)
            lines.append(
                f"| {name} | {label} | {error.max_tip_error:.4f} | {error.rms_tip_error:.4f} "
                f"| {run.cpu_seconds / run.t[-1]:.2g} | {run.iterations / max(1, run.steps):.1f} | {run.status} |"
            )
        plot_trajectory(runs[FORMULATIONS[2][0]], out / f"{name}.png", reference=known.columns)
        plot_comparison(runs, out / f"{name}_formulations.png", reference=known.columns, title=name)
        lines.append(f"| {name} | the reference itself is good to | {known.tip_tolerance:g} | | | | |")
    lines += ["", *(f"![{name}]({name}.png)\n\n![{name}]({name}_formulations.png)\n" for name in SCENES)]
    return lines


def in_space(out: Path) -> list[str]:
    """Simulate an arm that leaves the plane, and write a figure, a film and a player; return the report's lines."""
    from flexarm_env.envs.video import pictures, write_film
    from flexarm_env.plotting import plot_trajectory
    from flexarm_env.scenes import named
    from flexarm_env.simulation import simulate

    run = simulate(named(SPACE), sample=0.01)
    plot_trajectory(run, out / f"{SPACE}.png")
    write_film(out / f"{SPACE}.gif", pictures(run, 20.0, 1.0 / 3.0, (480, 480)), 20.0)
    run.view().save(out / f"{SPACE}.html")
    return [
        "## An arm in space",
        "",
        f"{SPACE} ({run.status}), three times as slow, and [to be turned and followed]({SPACE}.html). A blow about yaw",
        f"bends its links by up to {np.abs(run.tip_deflection).max():.0%} of their lengths and twists them by up to",
        f"{np.degrees(np.abs(run.twist).max()):.0f} degrees.",
        "",
        f"![film]({SPACE}.gif)\n\n![{SPACE}]({SPACE}.png)\n",
    ]


def train(arguments: Arguments) -> list[str]:
    """Train the policy; return the report's lines."""
    from flexarm_env.training import train as train_ppo
    from flexarm_env.training.progress import finished

    note = finished(
        train_ppo, arguments.out / "ppo", env=ENV, progress=sys.stderr.isatty(), seed=arguments.seed,
        n_timesteps=arguments.steps, tensorboard=False,
    )  # fmt: skip
    return ["## Training", "", f"PPO on {ENV}: {note}.", "", "![learning curve](ppo/learning_curve.png)", ""]


def judged(out: Path, controllers: Sequence[str], others: Mapping[str, Any] | None = None) -> tuple[Any, list[str]]:
    """Evaluate the trained policy and controllers on the evaluation episodes; return results and the report's lines.

    others: results of other policies, shown in the table's first rows.
    """
    from flexarm_env.training.evaluate import Arguments as Judged
    from flexarm_env.training.evaluate import evaluate
    from flexarm_env.training.figures import tip_errors
    from flexarm_env.training.statistics import markdown

    rows, results, limits = evaluate(Judged(policy=",".join((str(out / "ppo"), *controllers)), env=ENV))
    tip_errors(results, 0, out / "tip_error.png", f"{ENV}, one episode under each controller")
    said = "100 fixed episodes; medians with 95 % bootstrap intervals."
    return rows, [said, "", markdown({**(others or {}), **rows}, limits), "![tip error](tip_error.png)", ""]


def judge(out: Path) -> list[str]:
    """Evaluate the trained policy, an untrained one and controllers on the same episodes; return the report's lines."""
    from flexarm_env.episodes import Actions
    from flexarm_env.training import episodes
    from flexarm_env.training.statistics import summary

    env = episodes.make_episodes(ENV, 100)
    drawn = np.random.default_rng(0).uniform(-1.0, 1.0, (env.unwrapped.plan.limit, 100, 1))
    before = summary(episodes.run(env, Actions(drawn), episodes.TEST))
    env.close()
    return ["## The policy beside classical control", "", *judged(out, CONTROLLERS, {"random actions": before})[1]]


def demonstrate(arguments: Arguments) -> None:
    """Replay the scenes, train the policy, evaluate it, and write report.md."""
    out, clock = own_folder(arguments.out, arguments.fresh), time.perf_counter()
    say("1/3 replaying scenes (the first call compiles; later ones do not)")
    lines = [*replay(out), *in_space(out)]
    say(f"2/3 training PPO on {ENV}, {arguments.steps} steps")
    lines += train(arguments)
    say("3/3 judging it beside classical controllers")
    report(out, "Demonstration", clock, lines + judge(out))


main = partial(command, Arguments, "python -m agents.demo", __doc__, demonstrate)

if __name__ == "__main__":
    sys.exit(main())
