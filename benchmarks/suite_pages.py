"""The pages of the suite's tasks, from their data: docs/suite.md and docs/suite/ID.md.

    python -m benchmarks.suite_pages

A task's page shows the player docs/players/ID.json where there is one.
"""

from __future__ import annotations

from pathlib import Path
from textwrap import fill

import numpy as np

from benchmarks.machine import DOCS, table, write_text
from flexarm_env import suite
from flexarm_env.envs.options import Plan
from flexarm_env.suite.frozen import resolved

WIDTH = 120

PAGES = {"FlexibleArm-v0": "flexible_arm", "TwoLinkFlexArm-v0": "two_link", "MultiLinkFlexArm-v0": "multi_link"}

OVERVIEW = """\
# The suite's tasks

Twelve tasks, each with one difficulty that real flexible arms have. A task is data: a file in `flexarm_env/data/suite`
names the environment and its keywords, and a digest of the resolved arm, solver, keywords, reward weights, starts and
observation, which a test compares. A task that changes gets another version and another id. Keywords of one's own
make another task of it, which a warning says once; `duration` and `reward`, free in training, pass without.

```python
import gymnasium as gym

from flexarm_env import suite

env = gym.make("flexarm_env:flexarm/slew-limited-v1")
vector = gym.make_vec("flexarm_env:flexarm/slew-limited-v1", num_envs=4)
assert [task.id for task in suite.tasks()][0] == "slew-measured-v1"
assert suite.digest(suite.task("slew-limited-v1")) == suite.task("slew-limited-v1").digest
```

{table}

How policies are judged and what methods reach: [](tutorials/suite.md), [](results/suite.md). How fast the tasks run
beside the plain environments: [](results/suite_speed.md). This page and those of the tasks are made from the data by
`python -m benchmarks.suite_pages`.

## Reward and success

The reward of a control period is the sum of

| name | weight | one link, target an angle | more links, target a point |
|---|---|---|---|
| accuracy | 0.5 | exp(−(e/0.1)²) | exp(−(e/0.1)²) |
| settle | 1 | exp(−(e/0.02)² − (s/0.2)²) | exp(−(e/0.02)² − (s/0.1)²) |
| distance | 0.5 | −min(\\|e\\|/u, 1) | −min(e, 1) |
| effort | 0.01 | −a² | −Σ aₖ² |
| vibration | 0.02, 0 | −min(d'², 1) | −min(Σ dₖ'², 1) |
| failure | 5 | −1 in the step that ends an episode by failure | likewise |

For one link e is the target less the tip's polar angle about the hub, unwrapped (rad), s the rate of that angle less
the target's (rad/s), u 1 rad. Where a target is met at any number of turns, e lies within half a turn and u is π. For
more links e is the distance from tip to target over the arm's length L, s the tip's velocity less the target's, its
magnitude over L (1/s). d' is the rate of a link's tip deflection over its length (1/s), a the action, clipped to ±1;
all at the end of the period.

Success is that the error and the speed have been within bounds at every control instant of the trailing `hold` = 0.5
s: for one link |e| < 1° and |d'| < 0.01 /s, for more e < 0.01 and s < 0.05 /s, or as the task says; with `once` it
stays. An episode's success is that of its last step; failure is none. `tests/test_suite_rewards.py` computes both from
recorded episodes by these formulas alone.

A task with a price has a cost, `info["cost"]` of a period and `info["episode_cost"]` up to now: what is judged is the
return less the price times the cost of the episode, which the reward does not contain.

## What changes an arm in mid-episode

A payload that comes to rest on the arm in no time leaves positions as they are. Torques, springs, dampers and friction
are finite and have no impulse, so that the momentum stays,

$$ \\mathbf M^+ \\mathbf v^+ + \\boldsymbol\\Phi_q^{{\\mathsf T}} \\boldsymbol\\Lambda = \\mathbf M^- \\mathbf v^-, $$

and of the jump Δv what damping ends before a step could see it is taken out, as where a motion jumps ([](theory.md),
section 6). The kinetic energy T⁻ − T⁺ that the impact takes is dissipated; what the payload brings of its weight's
potential is work. A payload that is let go leaves the velocities as they are and takes its energy along, which is
(negative) work. A push is a dead force, held over whole control periods; its work is force times way. With these the
books of an arm close: kinetic, strain and gravity energy are those of the start plus work less what is dissipated, but
for the integrator's error. All formulations do so by the same function (`flexarm_env/physics/integrator/impact.py`).

```{{toctree}}
:hidden:

{pages}
```
"""


def row(task: suite.Task) -> list[str]:
    """Of the overview."""
    link = f"[`{task.id}`](suite/{task.id}.md)"
    return [str(task.number), link, task.title, f"`{task.environment}`", f"{task.budget / 1e6:g} million"]


def overview() -> str:
    """docs/suite.md."""
    rows = table("# | task | what | environment | periods of training", map(row, suite.tasks()))
    return OVERVIEW.format(table="\n".join(rows), pages="\n".join(f"suite/{task.id}" for task in suite.tasks()))


def keywords(task: suite.Task) -> str:
    """As `gymnasium.make` takes them."""
    lines = [f"    {name}={value!r},".replace("'", '"') for name, value in task.keywords.items()]
    return "\n".join(["gym.make(", f'    "flexarm_env:{task.environment}",', *lines, ")"])


def facts(task: suite.Task, plan: Plan) -> list[list[str]]:
    """What the task's table has."""
    built = plan.kind.build(plan.arm, np.array(plan.rewards), plan.period, plan.aims)
    bands = ", ".join(
        f"{name} below {bound:.4g} {unit}".strip()
        for (name, (_, unit)), bound in zip(plan.kind.bands.items(), built.bands, strict=True)
        if bound < float("inf")
    )
    once = ", and stays one" if built.once is not None else ""
    price = [["price of a unit of cost", f"{task.price:g}"]] if task.price else []
    return [
        ["id for `gymnasium.make`", f"`{task.env_id}`"],
        ["environment", f"[`{task.environment}`](../environments/{PAGES[task.environment]}.md)"],
        ["arm", f"`{plan.arm.name}`"],
        ["actions", f"{plan.arm.n_links}, torques"],
        ["numbers in an observation", f"{len(plan.names) * plan.history} = {len(plan.names)} entries × {plan.history}"],
        ["control period, episode", f"{plan.period:g} s, {plan.limit} periods"],
        ["success", f"{bands}, for {(built.hold - 1.0) * plan.period:g} s{once}"],
        ["training", f"at most {task.budget:,} control periods"],
        *price,
        ["digest", f"`{task.digest}`"],
    ]


def page(task: suite.Task, players: Path) -> str:
    """docs/suite/ID.md."""
    plan = resolved(task)
    entries = ", ".join(f"`{name}`" for name in plan.names)
    order = f"{plan.history} in a row, the oldest first" if plan.history > 1 else "in order"
    player = [f"```{{player}} {task.id}", "```", ""] if (players / f"{task.id}.json").is_file() else []
    lines = [
        f"# {task.title}", "", fill(task.hard, WIDTH), "",
        *player, *table(f"`{task.id}` | ", facts(task, plan)), "",
        fill(f"The observation, {order}: {entries}.", WIDTH, break_on_hyphens=False), "",
        "It is the environment", "", "```python", "import gymnasium as gym", "", f"env = {keywords(task)}", "```", "",
        "Reward and success: [](../suite.md).",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def pages() -> dict[Path, str]:
    """All pages, by their places below docs/."""
    found = {Path("suite.md"): overview()}
    return found | {Path("suite") / f"{task.id}.md": page(task, DOCS / "players") for task in suite.tasks()}


def main() -> None:
    """Write them."""
    for path, text in pages().items():
        (DOCS / path).parent.mkdir(exist_ok=True)
        write_text(DOCS / path, text)
        print(path)


if __name__ == "__main__":
    main()
