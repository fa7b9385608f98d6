"""`flexarm scenes`: list the scenes of the package."""

import argparse
import json

from flexarm_env import scenes
from flexarm_env.cli.codes import DONE


def run(args: argparse.Namespace) -> int:
    """List the named scenes, or print one as TOML."""
    if args.name is not None:
        scene = scenes.named(args.name)
        if args.json:
            print(json.dumps(_entry(args.name), indent=2))
        else:
            print(scene.to_toml(), end="")
        return DONE
    entries = [_entry(name) for name in scenes.names(parameter_sets=True, space=True)]
    if args.json:
        print(json.dumps({"scenes": entries}, indent=2))
        return DONE
    width = max(len(str(entry["name"])) for entry in entries)
    print(f"{'name':{width}}  links  run, s   dt, s  reference  description")
    for entry in entries:
        mark = "yes" if entry["reference"] else "-"
        printed = str(entry["name"]).endswith("@as_printed")
        what = "the same scene with the parameters printed in the paper" if printed else entry["description"]
        print(
            f"{entry['name']:{width}}  {entry['links']:5d}  {entry['duration']:6g}  {entry['dt']:6g}  {mark:9}  {what}"
        )
    return DONE


def _entry(name: str) -> dict[str, object]:
    """Return the entry of a scene in the output of `flexarm scenes`."""
    scene = scenes.named(name)
    return {
        "name": name,
        "links": scene.arm.n_links,
        **{key: getattr(scene, key) for key in ("root", "duration", "dt", "sample")},
        "reference": name in scenes.reference_names(),
        **{key: getattr(scene, key) for key in ("description", "source")},
        "note": " ".join(scene.note.split()),
    }
