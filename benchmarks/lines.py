"""Count the lines of Python by folder, in commits and in the working tree, as a Markdown table.

python -m benchmarks.lines [--kinds] [COMMIT ...]

--kinds: separate lines of code, docstrings and own-line comments, and comments as a share of code.
"""

import ast
import io
import subprocess
import sys
import tokenize
from collections import Counter
from pathlib import Path, PurePath

ROOT = Path(__file__).resolve().parents[1]

LAYOUT = {tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER, tokenize.COMMENT}
"""Types of tokens that do not count as code."""


def sources(commit: str | None) -> dict[str, str]:
    """Return the text of each Python file by its path. commit: None for the working tree without ignored files."""
    words = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.py"]
    if commit is not None:
        words = ["git", "ls-tree", "-r", "--name-only", commit]
    names = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split("\n")
    names = [name for name in names if name.endswith(".py")]
    if commit is None:
        return {name: (ROOT / name).read_text(encoding="utf-8") for name in names if (ROOT / name).is_file()}
    asked = "".join(f"{commit}:{name}\n" for name in names)
    answer = subprocess.run(
        ["git", "cat-file", "--batch"], cwd=ROOT, input=asked.encode(), capture_output=True, check=True
    ).stdout
    found, at = {}, 0
    for name in names:
        end = answer.index(b"\n", at)
        size = int(answer[at:end].split()[-1])
        found[name] = answer[end + 1 : end + 1 + size].decode("utf-8")
        at = end + size + 2  # the text, and a newline after it
    return found


def kinds(text: str) -> Counter[str]:
    """Return the numbers of lines: "all", "code", "docstrings" and own-line "comments"."""
    found: Counter[str] = Counter({"all": len(text.splitlines())})
    code: set[int] = set()
    lines = text.splitlines()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        first, last = token.start[0], token.end[0]
        if token.type == tokenize.COMMENT:
            found["comments"] += lines[first - 1].lstrip().startswith("#")
        elif token.type not in LAYOUT:
            code.update(range(first, last + 1))
    documented: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            documented.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    found["docstrings"] = len(documented)
    found["code"] = len(code - documented)
    return found


def lines(commit: str | None) -> dict[str, Counter[str]]:
    """Return the number of lines of each kind (`kinds`) by subpackage and in total. commit: None for the working
    tree."""
    found: dict[str, Counter[str]] = {"in all": Counter()}
    for name, text in sources(commit).items():
        own, rooms = kinds(text), PurePath(name).with_suffix("").parts
        inside = ["/".join(rooms[:2])] if rooms[0] == "flexarm_env" else []
        for room in (rooms[0], *inside, "in all"):
            found.setdefault(room, Counter()).update(own)
    return found


def cells(own: Counter[str], apart: bool) -> list[str]:
    """Return a table row's cells for one commit: the number of lines, or (`apart`) each kind and the share of
    comments."""
    if not apart:
        return [f"{own['all']:,}"]
    share = f"{100.0 * own['comments'] / own['code']:.1f} %" if own["code"] else ""
    return [*(f"{own[kind]:,}" for kind in ("code", "docstrings", "comments")), share]


def main(words: list[str]) -> None:
    """Print a table of line counts with a column for each commit and for the working tree."""
    apart = "--kinds" in words
    commits = [word for word in words if word != "--kinds"]
    columns = {**{commit: lines(commit) for commit in commits}, "working tree": lines(None)}
    rooms = sorted({room for column in columns.values() for room in column} - {"in all"})
    names = [f"{name}: {kind}" for name in columns for kind in ("code", "docstrings", "comments", "comments / code")]
    rows = [["room", *(names if apart else columns)]]
    rows += [["---", *["---:"] * (len(rows[0]) - 1)]]
    for room in [*rooms, "in all"]:
        rows.append(
            [room, *(cell for column in columns.values() for cell in cells(column.get(room, Counter()), apart))]
        )
    print("\n".join(f"| {' | '.join(row)} |" for row in rows))


if __name__ == "__main__":
    main(sys.argv[1:])
