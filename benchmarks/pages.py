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
    """A page's text with these lines in its blocks of a record; ValueError where it has none of that name."""
    for block, lines in blocks.items():
        before, mark, rest = text.partition(f"<!-- {name} {block} -->\n")
        if not mark:
            raise ValueError(f"the page has no block {name} {block}")
        text = "\n".join([before + mark, *lines, "", "<!-- end -->" + rest.partition("<!-- end -->")[2]])
    return text


def write_page(folder: Path, name: str, blocks: Blocks, page: str = "") -> None:
    """Fill a page's blocks of a record, of the page in docs/ or of its copy in another folder.

    page: below docs/, without .md; results/NAME where none is named.
    """
    source = DOCS / f"{page or 'results/' + name}.md"
    target = source if folder.resolve() in (DOCS / "results", DOCS) else folder / source.name
    write_text(target, filled((target if target.exists() else source).read_text(encoding="utf-8"), name, blocks))


def short(value: Any) -> Any:
    """A number in few digits; None as nothing."""
    return f"{value:.5g}" if isinstance(value, float) else "" if value is None else value


def options_of(case: Found) -> str:
    """A case's options in a cell."""
    return " ".join(f"{key}={short(value)}" for key, value in case["options"].items())


def write_csv(path: Path, heads: list[str], rows: Iterable[Iterable[Any]]) -> None:
    """Rows below their heads."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([heads, *([short(value) for value in row] for row in rows)])
    write_text(path, text.getvalue())


def kept(folder: Path, name: str) -> Found:
    """What a record in a folder has; nothing where it is not there."""
    record = folder / f"{name}.json"
    return json.loads(record.read_text(encoding="utf-8")) if record.is_file() else {}


def begun(folder: Path, name: str) -> Found:
    """What a run that was broken off has left in a record, to go on from, by the same code; a whole one is measured
    anew."""
    found = kept(folder, name)
    return {} if "machine" in found else found


def parts(options: argparse.Namespace, name: str, measures: Mapping[str, Callable[[], Any]]) -> Found:
    """What each part of a record is measured to be; where --only names some, the others are as they are kept, and the
    date is that of the oldest and today's."""
    wanted = options.only or measures
    known = kept(options.out, name) if options.only else {}
    missing = [part for part in measures if part not in wanted and part not in known]
    if missing:
        raise SystemExit(f"{options.out / name}.json has no {', '.join(missing)}, which --only leaves as they are")
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
    """The command of a benchmark: measure, keep NAME.json, write the page's blocks; 1 where a verdict does not hold.

    Args:
        name: of the record. page, packages: where the lines go (`write_page`), and versions that are told there.
        indent: of the record.
        measure: what was found. Where it has "verdicts" (what has to hold, whether it does) they are a block too.
        more: further flags, by their names: keywords of `add_argument`. numbers: flags of whole numbers, with defaults.
    """
    parser = command(description, **numbers)
    parser.add_argument("--page", action="store_true", help="measure nothing: the page from the numbers that are kept")
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
