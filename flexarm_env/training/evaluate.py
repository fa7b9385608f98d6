"""Evaluate a policy or a classical controller on fixed episodes.

    flexarm evaluate --env FlexibleArm-v0 --policy lqr
    flexarm evaluate --env FlexibleArm-v0 --policy runs/ppo-FlexibleArm-v0-0 --json
    flexarm evaluate --env TwoLinkFlexArm-v0 --policy pd,zvd,lqr --randomized --out runs/table

--policy takes a controller, a run folder, a file (policy.npz, a .zip of Stable-Baselines3, .onnx), the name of a policy
of the package, or MODULE:NAME. MODULE:NAME is a Python function of observations, an object with reset and act, or its
class. Several policies, separated by commas, give one table with a row per policy.

The controllers are pd, zv, zvd, lqr, mpc and time_optimal. The controller lqg requires --env-kwargs
'{"observation": "measured"}'. The controllers hybrid_force, impedance, lqr_force and mpc_force require --env-kwargs
'{"task": "press"}' or "land". zv@FILE is zv with gains from a file of `flexarm tune`.

The settling time is the time after which the tip stays near its target until the episode ends. In the task slew, near
means within 2 % of the slew angle (at least 0.5 deg); in reach, within 2 % of the arm's length. A tip that never
settles counts with the episode's whole duration. Intervals are 95 % bootstrap intervals over the episodes. The folder
--out receives the table, the JSON and a figure of the tip error in the first episode; with --video also a film for each
policy.

A policy.npz contains only numbers. A .zip and the vecnormalize.pkl beside the .zip contain pickled objects: the command
reads only the numbers in the two files and executes no code from the files. A policy given as MODULE:NAME runs the code
of this module.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from flexarm_env.control import NamedPolicy, Setup
from flexarm_env.control.time_optimal import rigid_time, slew_plan
from flexarm_env.files import to_folder
from flexarm_env.training import episodes as fixed
from flexarm_env.training.policies import choose
from flexarm_env.training.runs import command, versions, write_json, write_text
from flexarm_env.training.statistics import markdown, summary


@dataclass(frozen=True)
class Arguments:
    """Arguments of `flexarm evaluate`.

    Args:
        policy: the policy in one of the forms above; several policies are separated by commas.
        env: id of the environment.
        episodes: number of episodes.
        first: seed of the first episode; each further episode's seed is larger by 1.
        formulation: beam formulation of the arm; default: the environment's formulation.
        env_kwargs: keywords of the environment, as JSON; they override the keywords with which a policy was trained.
        randomized: multiply the payload by a random factor from 0.5 to 2, and the bending stiffness by a random factor
            from 0.7 to 1.3, in each episode.
        json: print JSON instead of a table.
        out: folder for table, JSON and figure.
        video: write a film of episode 0 for each policy as well (needs --out).
    """

    policy: str
    env: str = "FlexibleArm-v0"
    episodes: int = 100
    first: int = fixed.TEST
    formulation: str | None = None
    env_kwargs: dict[str, Any] = field(default_factory=dict)
    randomized: bool = False
    json: bool = False
    out: Path | None = None
    video: bool = False


def evaluate(arguments: Arguments) -> tuple[dict[str, dict[str, Any]], dict[str, fixed.Episodes], dict[str, float]]:
    """Evaluate all policies; return summaries by policy, episodes by policy, and the result of `bounds`.

    Raises ValueError for invalid arguments.
    """
    if arguments.episodes < 1:
        raise ValueError(f"--episodes {arguments.episodes}: must be at least 1")
    rows: dict[str, dict[str, Any]] = {}
    results: dict[str, fixed.Episodes] = {}
    limits: dict[str, float] = {}
    for word in arguments.policy.split(","):
        # each policy on the same episodes, in an environment with its own keywords
        chosen = choose(word, arguments.env)
        env = fixed.make_episodes(arguments.env, arguments.episodes, **keywords(arguments, chosen))
        policy = chosen.make(env)
        result = fixed.run(env, policy, arguments.first)
        name = chosen.name if chosen.name not in rows else word
        rows[name], results[name] = summary(result), result
        limits = limits or bounds(env, result)
        env.close()
    return rows, results, limits


def keywords(arguments: Arguments, chosen: NamedPolicy) -> dict[str, Any]:
    """Return a policy's environment keywords: the keywords of its training, overridden by the user's keywords."""
    kwargs = dict(chosen.env_kwargs) | arguments.env_kwargs
    if arguments.formulation is not None:
        kwargs["formulation"] = arguments.formulation
    if arguments.randomized:
        kwargs["randomization"] = fixed.RANDOMIZED
    return kwargs


def bounds(env: Any, result: fixed.Episodes) -> dict[str, float]:
    """Return lower bounds of the settling time, s, for one-link slews (medians over the episodes); {} for other tasks.

    The first bound is the duration of the time-optimal slew of a rigid link. The second bound is the duration of the
    time-optimal slew that brings the flexible link to rest.
    """
    setup = Setup.of(env)
    if setup.task != "slew":
        return {}
    from flexarm_env.control.arm_model import arm_model

    inertia = float(arm_model(setup.arm).inertia[0, 0])
    # lower bounds of the settling time: rigid arm, and flexible arm to rest
    rigid = [rigid_time(inertia, float(way), setup.torque_limits[0]) for way in result.way]
    flexible = [slew_plan(setup, float(way)).periods * setup.control_dt for way in result.way]
    return {
        "rigid time-optimal slew": float(np.median(rigid)),
        "flexible time-optimal plan": float(np.median(flexible)),
    }


def report(arguments: Arguments, rows: Mapping[str, Any], limits: Mapping[str, float]) -> dict[str, Any]:
    """Return the JSON content: one policy's numbers at the top level, several policies' numbers under `policies`."""
    head = {
        "env": arguments.env, "episodes": arguments.episodes, "first_seed": arguments.first,
        "formulation": arguments.formulation, "randomized": arguments.randomized, "bounds": dict(limits),
        "versions": versions(),
    }  # fmt: skip
    if len(rows) == 1:
        ((name, row),) = rows.items()
        return {**head, "policy": name, **row}
    return {**head, "policies": dict(rows)}


def judge(arguments: Arguments) -> None:
    """Evaluate the policies, print the result, and write the requested files."""
    if arguments.out is not None:
        to_folder("--out", arguments.out)
    elif arguments.video:
        raise ValueError("--video: needs --out, the folder of films")
    rows, results, limits = evaluate(arguments)
    content = report(arguments, rows, limits)
    table = markdown(rows, limits)
    print(json.dumps(content, indent=2) if arguments.json else table, end="\n" if arguments.json else "")
    if arguments.out is not None:
        write_json(arguments.out / "table.json", content)
        write_text(arguments.out / "table.md", table)
        from flexarm_env.training.figures import tip_errors

        tip_errors(results, 0, arguments.out / "tip_error.png", f"{arguments.env}, episode {arguments.first}")
        if arguments.video:
            from flexarm_env.training.films import film

            for word in arguments.policy.split(","):
                chosen = choose(word, arguments.env)
                path = arguments.out / f"{chosen.name}.mp4"
                film(arguments.env, chosen, keywords(arguments, chosen), arguments.first, path)


def main(program: str = "flexarm evaluate", words: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    return command(Arguments, program, __doc__, judge, words)
