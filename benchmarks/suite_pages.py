"""The pages of the suite's tasks, from their data: docs/suite.md and docs/suite/ID.md.

    python -m benchmarks.suite_pages

A task's page shows the player docs/players/ID.json where there is one.
"""

from pathlib import Path
from textwrap import fill

from benchmarks.machine import DOCS, table, write_text
from benchmarks.pages import filled
from flexarm_env import suite
from flexarm_env.envs.options import Plan
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
    every = suite.tasks(earlier=True)
    rows = table("# | task | what | environment | periods of training", map(row, suite.tasks()))
    tree = ["```{toctree}", ":hidden:", "", *(f"suite/{task.id}" for task in every), "```"]
    return filled((DOCS / "suite.md").read_text(encoding="utf-8"), "suite_pages", {"tasks": rows, "pages": tree})


def keywords(task: suite.Task) -> str:
    """As `gymnasium.make` takes them."""
    lines = [f"    {name}={value!r},".replace("'", '"') for name, value in task.keywords.items()]
    return "\n".join(["gym.make(", f'    "flexarm_env:{task.environment}",', *lines, ")"])


def facts(task: suite.Task, plan: Plan) -> list[list[str]]:
    """What the task's table has."""
    bands = ", ".join(
        f"{name} below {bound:.4g} {unit}".strip()
        for (name, (_, unit)), bound in zip(plan.kind.bands.items(), plan.record.bands, strict=True)
        if bound < float("inf")
    )
    once = ", and stays one" if plan.record.once is not None else ""
    price = [["price of a unit of cost", f"{task.price:g}"]] if task.price else []
    return [
        ["id for `gymnasium.make`", f"`{task.env_id}`"],
        ["environment", f"[`{task.environment}`](../environments/{PAGES[task.environment]}.md)"],
        ["arm", f"`{plan.arm.name}`"],
        ["actions", f"{plan.arm.n_links}, torques"],
        ["numbers in an observation", f"{len(plan.names) * plan.history} = {len(plan.names)} entries × {plan.history}"],
        ["control period, episode", f"{plan.period:g} s, {plan.limit} periods"],
        ["success", f"{bands}, for {(plan.record.hold - 1.0) * plan.period:g} s{once}"],
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
    latest = next(one for one in suite.tasks() if one.name == task.name)
    later = [] if latest == task else [f"Superseded by [`{latest.id}`]({latest.id}.md); kept as it was.", ""]
    lines = [
        f"# {task.title}" + (f" (version {task.version})" if later else ""), "", *later, fill(task.hard, WIDTH), "",
        *player, *table(f"`{task.id}` | ", facts(task, plan)), "",
        fill(f"The observation, {order}: {entries}.", WIDTH, break_on_hyphens=False), "",
        "It is the environment", "", "```python", "import gymnasium as gym", "", f"env = {keywords(task)}", "```", "",
        "Reward and success: [](../suite.md).",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def pages() -> dict[Path, str]:
    """All pages, by their places below docs/."""
    found = {Path("suite.md"): overview()}
    return found | {Path("suite") / f"{task.id}.md": page(task, DOCS / "players") for task in suite.tasks(earlier=True)}


def main() -> None:
    """Write them."""
    for path, text in pages().items():
        (DOCS / path).parent.mkdir(exist_ok=True)
        write_text(DOCS / path, text)
        print(path)


if __name__ == "__main__":
    main()
