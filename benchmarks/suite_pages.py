"""Write the pages of the suite's tasks from the tasks' data: docs/suite.md and docs/suite/ID.md.

    python -m benchmarks.suite_pages

A task's page shows the player docs/players/ID.json if this file exists.
"""

from pathlib import Path
from textwrap import fill

from benchmarks.machine import DOCS, table, write_text
from benchmarks.pages import filled
from flexarm_env import suite
from flexarm_env.envs.options import Plan
from flexarm_env.envs.task import PRESS
from flexarm_env.suite.frozen import resolved

WIDTH = 120

PAGES = {
    "FlexibleArm-v0": "flexible_arm", "TwoLinkFlexArm-v0": "two_link", "MultiLinkFlexArm-v0": "multi_link",
    "SpatialFlexArm-v0": "spatial",
}  # fmt: skip


def row(task: suite.Task) -> list[str]:
    """Return a task's row in the overview table."""
    link = f"[`{task.id}`](suite/{task.id}.md)"
    return [str(task.number), link, task.title, f"`{task.environment}`", f"{task.budget / 1e6:g} million"]


def overview() -> str:
    """Return docs/suite.md with a new table and list of pages; the other text is unchanged."""
    rows = table("# | task | title | environment | training budget (control periods)", map(row, suite.tasks()))
    latest = [f"suite/{task.id}" for task in suite.tasks()]
    tree = ["```{toctree}", ":hidden:", "", *latest, "suite/earlier", "```"]
    return filled((DOCS / "suite.md").read_text(encoding="utf-8"), "suite_pages", {"tasks": rows, "pages": tree})


def earlier() -> str:
    """Return docs/suite/earlier.md, the list of superseded versions of tasks."""
    latest = {task.id for task in suite.tasks()}
    before = [task for task in suite.tasks(earlier=True) if task.id not in latest]
    cells = ([f"[`{task.id}`]({task.id}.md)", task.title, f"`{task.environment}`"] for task in before)
    rows = table("task | title | environment", cells)
    head = "Superseded versions of the tasks never change, so results obtained on these versions stay valid."
    tree = ["```{toctree}", ":hidden:", "", *(task.id for task in before), "```"]
    return "\n".join(["# Earlier versions", "", head, "", *rows, "", *tree]) + "\n"


def keywords(task: suite.Task) -> str:
    """Return the call of `gymnasium.make` that makes a task's environment."""
    lines = [f"    {name}={value!r},".replace("'", '"') for name, value in task.arguments.items()]
    return "\n".join(["gym.make(", f'    "flexarm_env:{task.environment}",', *lines, ")"])


def facts(task: suite.Task, plan: Plan) -> list[list[str]]:
    """Return the rows of a task's table: name and value."""
    bands = ", ".join(
        f"{name} below {bound:.4g} {unit}".strip()
        for (name, (_, unit)), bound in zip(plan.kind.bands.items(), plan.record.bands, strict=True)
        if bound < float("inf")
    )
    once = ", and lasts to the end of the episode" if plan.record.once is not None else ""
    lasting = f"for {(plan.record.hold - 1.0) * plan.period:g} s"
    if plan.kind.task == PRESS:
        lasting = (
            "in the last two thirds of the episode (root mean square of the relative force error; path in all periods)"
        )
    price = [["[price](../suite.md#price) of a unit of cost", f"{task.price:g}"]] if task.price else []
    return [
        ["id for `gymnasium.make`", f"`{task.env_id}`"],
        ["environment", f"[`{task.environment}`](../environments/{PAGES[task.environment]}.md)"],
        ["arm", f"`{plan.arm.name}`"],
        ["actions", f"{plan.arm.n_links}, torques"],
        ["size of an observation", f"{len(plan.names) * plan.history} = {len(plan.names)} entries × {plan.history}"],
        ["control period, episode", f"{plan.period:g} s, {plan.limit} periods"],
        ["success", f"{bands}, {lasting}{once}"],
        ["training budget", f"{task.budget:,} control periods"],
        *price,
        ["digest", f"`{task.digest}`"],
    ]


def page(task: suite.Task, players: Path) -> str:
    """Return the page docs/suite/ID.md of a task."""
    plan = resolved(task)
    entries = ", ".join(f"`{name}`" for name in plan.names)
    several = f"The observation contains the last {plan.history} readings, oldest first. Each reading has these entries"
    order = several if plan.history > 1 else "Observation entries, in order"
    player = [f"```{{player}} {task.id}", "```", ""] if (players / f"{task.id}.json").is_file() else []
    latest = next(one for one in suite.tasks() if one.name == task.name)
    newer = f"This version of the task is superseded by [`{latest.id}`]({latest.id}.md)."
    later = [] if latest == task else [newer, ""]
    lines = [
        f"# {task.title}" + (f" (version {task.version})" if later else ""), "", *later,
        fill(task.hard, WIDTH, break_on_hyphens=False), "",
        *player, *table(f"`{task.id}` | ", facts(task, plan)), "",
        fill(f"{order}: {entries}.", WIDTH, break_on_hyphens=False), "",
        "This code makes the environment of the task:", "",
        "```python", "import gymnasium as gym", "", f"env = {keywords(task)}", "```", "",
        "The page [](../suite.md) defines reward and success.",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def pages() -> dict[Path, str]:
    """Return all pages by their paths below docs/."""
    found = {Path("suite.md"): overview(), Path("suite") / "earlier.md": earlier()}
    return found | {Path("suite") / f"{task.id}.md": page(task, DOCS / "players") for task in suite.tasks(earlier=True)}


def main() -> None:
    """Write all pages."""
    for path, text in pages().items():
        (DOCS / path).parent.mkdir(exist_ok=True)
        write_text(DOCS / path, text)
        print(path)


if __name__ == "__main__":
    main()
