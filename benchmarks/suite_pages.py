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
    """Of the overview."""
    link = f"[`{task.id}`](suite/{task.id}.md)"
    return [str(task.number), link, task.title, f"`{task.environment}`", f"{task.budget / 1e6:g} million"]


def overview() -> str:
    """docs/suite.md with its table and the list of pages; the rest stands there alone."""
    rows = table("# | task | title | environment | training budget (control periods)", map(row, suite.tasks()))
    latest = [f"suite/{task.id}" for task in suite.tasks()]
    tree = ["```{toctree}", ":hidden:", "", *latest, "suite/earlier", "```"]
    return filled((DOCS / "suite.md").read_text(encoding="utf-8"), "suite_pages", {"tasks": rows, "pages": tree})


def earlier() -> str:
    """docs/suite/earlier.md: the tasks in versions before the latest, apart from those in the sidebar."""
    latest = {task.id for task in suite.tasks()}
    before = [task for task in suite.tasks(earlier=True) if task.id not in latest]
    cells = ([f"[`{task.id}`]({task.id}.md)", task.title, f"`{task.environment}`"] for task in before)
    rows = table("task | title | environment", cells)
    head = "Superseded versions of the tasks. They never change, so results obtained on them stay valid."
    tree = ["```{toctree}", ":hidden:", "", *(task.id for task in before), "```"]
    return "\n".join(["# Earlier versions", "", head, "", *rows, "", *tree]) + "\n"


def keywords(task: suite.Task) -> str:
    """As `gymnasium.make` takes them."""
    lines = [f"    {name}={value!r},".replace("'", '"') for name, value in task.arguments.items()]
    return "\n".join(["gym.make(", f'    "flexarm_env:{task.environment}",', *lines, ")"])


def facts(task: suite.Task, plan: Plan) -> list[list[str]]:
    """What the task's table has."""
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
    """docs/suite/ID.md."""
    plan = resolved(task)
    entries = ", ".join(f"`{name}`" for name in plan.names)
    several = f"The observation contains the last {plan.history} readings, oldest first. Each has these entries"
    order = several if plan.history > 1 else "Observation entries, in order"
    player = [f"```{{player}} {task.id}", "```", ""] if (players / f"{task.id}.json").is_file() else []
    latest = next(one for one in suite.tasks() if one.name == task.name)
    later = [] if latest == task else [f"Superseded by [`{latest.id}`]({latest.id}.md).", ""]
    lines = [
        f"# {task.title}" + (f" (version {task.version})" if later else ""), "", *later, fill(task.hard, WIDTH), "",
        *player, *table(f"`{task.id}` | ", facts(task, plan)), "",
        fill(f"{order}: {entries}.", WIDTH, break_on_hyphens=False), "",
        "The task is this environment:", "",
        "```python", "import gymnasium as gym", "", f"env = {keywords(task)}", "```", "",
        "Reward and success are defined on [](../suite.md).",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def pages() -> dict[Path, str]:
    """All pages, by their places below docs/."""
    found = {Path("suite.md"): overview(), Path("suite") / "earlier.md": earlier()}
    return found | {Path("suite") / f"{task.id}.md": page(task, DOCS / "players") for task in suite.tasks(earlier=True)}


def main() -> None:
    """Write them."""
    for path, text in pages().items():
        (DOCS / path).parent.mkdir(exist_ok=True)
        write_text(DOCS / path, text)
        print(path)


if __name__ == "__main__":
    main()
