"""The tables of README.md, from docs/results/*.json: between `<!-- table: NAME -->` and `<!-- end -->`.

python -m benchmarks.readme_tables [--check]

With --check nothing is written, and the exit code is 1 where a table is not what the results say.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.machine import table, write_text
from benchmarks.work_precision import front

ROOT = Path(__file__).resolve().parents[1]
README, RESULTS = ROOT / "README.md", ROOT / "docs" / "results"

MARKED = re.compile(r"(<!-- table: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)

CASES = {
    "floating frame, 5 segments x 1": "floating frame, 5 segments",
    "floating frame, 16 segments x 1": "16 segments",
    "geometrically exact, 5 quadratic elements": "exact beam, 5 elements",
    "geometrically exact, 16 quadratic elements": "16 elements",
    "elastica, 8 nodes": "elastica, 8 nodes",
}
"""Cases of agreement.json that the table shows, and their headings."""

ENVS = {"FlexibleArm-v0": "slew of one link", "TwoLinkFlexArm-v0": "reach of two links"}


def lines(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table as text."""
    return "\n".join(table(" | ".join(head), rows, numbers=True)) + "\n"


def measured(content: Mapping[str, Any], page: str) -> str:
    """Where and when, and where the whole page is."""
    machine = content.get("machine") or content.get("versions") or {}
    told = [machine.get("date"), machine.get("processor"), f"{machine['cores']} cores" if "cores" in machine else None]
    where = ", ".join(str(word) for word in told if word)
    return f"\n{'Measured: ' + where + '. ' if where else ''}All of it: [{page}](docs/results/{page}).\n"


def accuracy(contents: Mapping[str, Any]) -> str:
    """Tip errors of every scene under every formulation."""
    content = contents["agreement"]
    scenes = list(dict.fromkeys(row["scene"] for row in content["rows"]))
    found = {(row["scene"], row["case"]): row for row in content["rows"]}
    rows = [[f"`{scene}`", *(_error(found.get((scene, case))) for case in CASES)] for scene in scenes]
    text = "Largest distance of the tip from the converged solution over a whole run, in % of the arm's length.\n\n"
    return text + lines(["scene", *CASES.values()], rows) + measured(content, "agreement.md")


def _error(row: Mapping[str, Any] | None) -> str:
    if row is None:
        return ""
    if row["status"] != "ok":
        return f"{row['status']}, {row['reached']:.2g} s"
    return f"{row['max_tip_error_percent']:.2g}"


def control(contents: Mapping[str, Any]) -> str:
    """Success and settling times of policies and controllers, environment by environment."""
    pages = {name: content for name, content in contents.items() if name.startswith("control")}
    return "\n".join(
        _controlled(part) + measured(content, f"{name}.md")
        for name, content in pages.items()
        for part in content.get("tables", {"": content}).values()
    )


def _controlled(part: Mapping[str, Any]) -> str:
    """One environment's table."""
    rows = [
        [
            who,
            f"{row['success_rate']:.0%}",
            f"{row['settling_time_median']:.2f}",
            f"{row['residual_vibration_median']:.2g}",
            f"{row['overshoot_median']:.1f}",
        ]
        for who, row in part["policies"].items()
    ]
    rows += [[f"*{bound}*", "", f"{value:.2f}", "", ""] for bound, value in part.get("bounds", {}).items()]
    head = ["policy", "success", "settling, s", "residual vibration, mm", "overshoot, %"]
    kind = ", payload and stiffness drawn at random" if part.get("randomized") else ""
    what = f"`{part['env']}`, {ENVS.get(part['env'], '')}{kind}"
    return f"{what}: medians of {part['episodes']} episodes.\n\n{lines(head, rows)}"


def speed(contents: Mapping[str, Any]) -> str:
    """Environment steps a second, and CPU time of scenes at equal error, as far as there are results."""
    makers = {"throughput": steps_a_second, "work_precision": race}
    return "\n".join(make(contents[name]) for name, make in makers.items() if name in contents)


def race(content: Mapping[str, Any]) -> str:
    """CPU time at equal error beside another program, scene by scene: its best runs, our exact beam's cheapest."""
    done = [row for row in content["rows"] if row["status"] == "ok"]
    told = []
    for scene in dict.fromkeys(row["case"]["scene"] for row in done if row["case"]["label"] == "Exudyn"):
        rows = [row for row in done if row["case"]["scene"] == scene]
        ours = [row for row in rows if row["case"]["formulation"] == "geometrically_exact"]
        ratios = []
        for other in front([row for row in rows if row["case"]["label"] == "Exudyn"]):
            able = [row["cpu"] for row in ours if row["max_error"] <= other["max_error"]]
            ratios += [other["cpu"] / min(able)] if able else []
        told += [f"{min(ratios):.0f} to {max(ratios):.0f} times on `{scene}`"] if ratios else []
    why = "Where a hub angle is prescribed, Exudyn calls a Python function for it in every step."
    text = f"CPU time of Exudyn over our exact beam's, at equal error: {', '.join(told)}."
    return f"{text}\n{why}\n{measured(content, 'work_precision.md')}"


def steps_a_second(content: Mapping[str, Any]) -> str:
    """Environment steps a second: one arm, many on one thread, many on all."""
    rates = content["rates"]
    yardstick = next(row["steps_per_second"] for row in rates if row["case"] == "Pendulum-v1")
    own = [row for row in rates if "formulation" in row]
    most = max((row["n_envs"] for row in own if row["n_envs"] <= 1024), default=1)
    threads = max(row["threads"] for row in own)
    rows = []
    for env_id, formulation in dict.fromkeys((row["id"], row["formulation"]) for row in own):
        wanted = (("single", 1, 1), ("vector", most, 1), ("vector", most, threads))
        found = [
            next(
                (
                    row["steps_per_second"]
                    for row in own
                    if (row["id"], row["formulation"]) == (env_id, formulation)
                    and (row["api"], row["n_envs"], row["threads"]) == case
                ),
                None,
            )
            for case in wanted
        ]
        rows.append([f"`{env_id}`, {formulation}", *("" if rate is None else f"{rate:,.0f}" for rate in found)])
    others = [row for row in rates if "formulation" not in row]
    rows += [[f"*{row['case']}*", *(_at(row, case) for case in ("single", "vector", ""))] for row in others]
    head = ["environment", "one", f"{most}, one thread", f"{most}, {threads} threads"]
    text = f"Environment steps a second; `Pendulum-v1` of Gymnasium, at {yardstick:,.0f}, is the yardstick.\n\n"
    return text + lines(head, rows) + measured(content, "throughput.md")


def _at(row: Mapping[str, Any], api: str) -> str:
    """The rate of another environment, in the column that it was measured for."""
    return f"{row['steps_per_second']:,.0f}" if row.get("api") == api else ""


TABLES = {
    "accuracy": (accuracy, ("agreement",)),
    "speed": (speed, ("throughput", "work_precision")),
    "control": (control, ("control",)),
}
"""Name -> what makes it, and how the names of the results begin of which it needs one."""


def filled(text: str, contents: Mapping[str, Any]) -> str:
    """README's text with its tables; a table whose results are not there says so."""

    def one(found: re.Match[str]) -> str:
        make, needed = TABLES[found.group(2)]
        there = any(name.startswith(needed) for name in contents)
        body = make(contents) if there else f"Not measured yet (docs/results/{needed[0]}*.json).\n"
        return f"{found.group(1)}{body}{found.group(3)}"

    return MARKED.sub(one, text)


def results() -> dict[str, Any]:
    """The content of every results file, by its name."""
    return {path.stem: json.loads(path.read_text("utf-8")) for path in sorted(RESULTS.glob("*.json"))}


def main() -> int:
    """Write the tables, or look whether they are what they should be."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.readme_tables", description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; 1 where a table is out of date")
    arguments = parser.parse_args()
    old = README.read_text("utf-8")
    new = filled(old, results())
    if arguments.check:
        return int(new != old)
    write_text(README, new)
    return 0


if __name__ == "__main__":
    sys.exit(main())
