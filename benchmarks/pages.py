"""Pages of results: the prose is written in Markdown by hand; scripts write numbers between marks of the page.

    <!-- RECORD BLOCK -->
    lines made from RECORD.json by the script RECORD.py, or by another script that the page names
    <!-- end -->

A script provides its measurements, and the lines of each block. `--page` writes the blocks again from the record alone.
"""

import argparse
import csv
import io
import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from benchmarks.machine import DOCS, command, describe_machine, table, told, write_text

Found = dict[str, Any]
Blocks = Mapping[str, list[str]]


def filled(text: str, name: str, blocks: Blocks) -> str:
    """Return a page's text with new lines in the blocks of a record. ValueError if the page lacks a block."""
    for block, lines in blocks.items():
        before, mark, rest = text.partition(f"<!-- {name} {block} -->\n")
        if not mark:
            raise ValueError(f"the page has no block {name} {block}")
        text = "\n".join([before + mark, *lines, "", "<!-- end -->" + rest.partition("<!-- end -->")[2]])
    return text


def write_page(folder: Path, name: str, blocks: Blocks, page: str = "") -> None:
    """Write the blocks of a record into a page of docs/, or into a copy of the page in another folder.

    page: path below docs/, without .md; default results/NAME.
    """
    source = DOCS / f"{page or 'results/' + name}.md"
    target = source if folder.resolve() in (DOCS / "results", DOCS) else folder / source.name
    write_text(target, filled((target if target.exists() else source).read_text(encoding="utf-8"), name, blocks))


def short(value: Any) -> Any:
    """Format a float with five digits; None becomes an empty text."""
    return f"{value:.5g}" if isinstance(value, float) else "" if value is None else value


def options_of(case: Found) -> str:
    """Format the options of a case for a table cell."""
    return " ".join(f"{key}={short(value)}" for key, value in case["options"].items())


def write_csv(path: Path, heads: list[str], rows: Iterable[Iterable[Any]]) -> None:
    """Write a CSV file with a header line."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([heads, *([short(value) for value in row] for row in rows)])
    write_text(path, text.getvalue())


def kept(folder: Path, name: str) -> Found:
    """Return the contents of a record in a folder; an empty dictionary if the file is missing."""
    record = folder / f"{name}.json"
    return json.loads(record.read_text(encoding="utf-8")) if record.is_file() else {}


def begun(folder: Path, name: str) -> Found:
    """Return the results of an interrupted run from its record; an empty dictionary if that run was finished."""
    found = kept(folder, name)
    return {} if "machine" in found else found


def parts(options: argparse.Namespace, name: str, measures: Mapping[str, Callable[[], Any]]) -> Found:
    """Measure the parts of a record.

    With --only the other parts keep their recorded values, and the date becomes the range from the oldest part to
    today.
    """
    wanted = options.only or measures
    known = kept(options.out, name) if options.only else {}
    missing = [part for part in measures if part not in wanted and part not in known]
    if missing:
        raise SystemExit(f"{options.out / name}.json has no {', '.join(missing)}, which --only does not measure")
    found = {part: measure() if part in wanted else known[part] for part, measure in measures.items()}
    if options.only:
        today = describe_machine()["date"]
        first = known["machine"]["date"].split()[0]
        found["machine"] = known["machine"] | {"date": today if first == today else f"{first} to {today}"}
    return found


def run(
    name: str,
    description: str | None,
    measure: Callable[[argparse.Namespace], Found],
    blocks: Callable[[Found], Blocks],
    arguments: list[str] | None = None,
    *,
    page: str = "",
    packages: tuple[str, ...] = (),
    indent: int | None = 1,
    more: Mapping[str, Mapping[str, Any]] | None = None,
    **numbers: int,
) -> int:
    """Run the command of a benchmark: measure, write NAME.json, and fill the page's blocks.

    Return the exit code, which is 1 if a verdict does not hold.

    Args:
        name: name of the record.
        measure: function that returns the results. The results' entry "verdicts" (requirement -> whether it holds)
            becomes a block.
        page: page of the blocks, see `write_page`. packages: packages whose versions the page lists.
        indent: indentation of the record's JSON.
        more: further flags: name -> keywords of `add_argument`. numbers: integer flags with their defaults.
    """
    parser = command(description, **numbers)
    parser.add_argument("--page", action="store_true", help="write the page from the record, measure nothing")
    for flag, keywords in (more or {}).items():
        parser.add_argument(f"--{flag}", **keywords)
    options = parser.parse_args(arguments)
    if options.page:
        found = kept(options.out, name)
        if "machine" not in found:
            parser.error(f"{options.out / name}.json: no record of a whole run, which --page needs")
    else:
        found = {"machine": describe_machine(*packages), **measure(options)}
        write_text(options.out / f"{name}.json", json.dumps(found, indent=indent) + "\n")
    verdicts: dict[str, bool] = found.get("verdicts", {})
    lines = {"machine": [told(found["machine"])], **blocks(found)}
    if verdicts:
        rows = [(what, "yes" if passed else "**no**") for what, passed in verdicts.items()]
        lines["verdicts"] = table("check | passed", rows)
    write_page(options.out, name, lines, page)
    print("\n".join(f"{'ok ' if holds else 'NO '} {what}" for what, holds in verdicts.items()))
    return 0 if all(verdicts.values()) else 1
