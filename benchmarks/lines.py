"""Lines of Python by room, of commits and of the working tree, as a table in Markdown.

python -m benchmarks.lines [COMMIT ...]
"""

import subprocess
import sys
from collections import Counter
from pathlib import Path, PurePath

ROOT = Path(__file__).resolve().parents[1]


def lines(commit: str | None) -> Counter[str]:
    """Lines by room, blank ones and comments too; None: of the working tree, what git does not ignore."""
    where = ["--untracked"] if commit is None else [commit]
    words = ["git", "grep", "--count", "-e", "", *where, "--", "*.py"]
    found: Counter[str] = Counter()
    for line in subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines():
        name, count = line.rsplit(":", 1)
        path = PurePath(name if commit is None else name.partition(":")[2])
        rooms = path.with_suffix("").parts
        found[rooms[0]] += int(count)
        if rooms[0] == "flexarm_env":
            found["/".join(rooms[:2])] += int(count)
        found["in all"] += int(count)
    return found


def main(commits: list[str]) -> None:
    """Print a column for each commit, and one for the working tree."""
    columns = {**{commit: lines(commit) for commit in commits}, "working tree": lines(None)}
    rooms = sorted({room for column in columns.values() for room in column} - {"in all"})
    rows = [["room", *columns], ["---", *["---:"] * len(columns)]]
    rows += [[room, *(f"{column[room]:,}" for column in columns.values())] for room in [*rooms, "in all"]]
    print("\n".join(f"| {' | '.join(row)} |" for row in rows))


if __name__ == "__main__":
    main(sys.argv[1:])
