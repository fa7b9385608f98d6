"""`flexarm import`, and `flexarm export` of arms as MJCF and URDF."""

import argparse
import tomllib
from pathlib import Path
from typing import Any

from flexarm_env import arms
from flexarm_env import validation as check
from flexarm_env.cli.codes import DONE
from flexarm_env.cli.progress import show
from flexarm_env.envs.space import kind_for
from flexarm_env.exchange import calibrated, chain_of, choose_integrator, differences, import_arm, mjcf, urdf
from flexarm_env.files import to_file, write_text
from flexarm_env.parameters import Arm
from flexarm_env.sections import Section

FLAGS = ("segments", "placement", "gravity")
"""Flags that apply only to --to mjcf."""
_OF_OTHERS = ("name", "cpu", "env", "env_kwargs", "slew", "elbows", "targets", "fmi")
SEGMENTS = 4
"""Default number of springs per link."""


def export(args: argparse.Namespace, out: Path) -> int:
    """Write an arm as MJCF or URDF, and print the errors of this approximation."""
    arm = arms.resolve(args.what)
    for word in (*_OF_OTHERS, *(FLAGS if args.to == "urdf" else ())):
        if getattr(args, word) is not None:
            flag = f"--{word.replace('_', '-')}"
            raise check.InvalidValue(flag, getattr(args, word), f"must not be given with --to {args.to}")
    values: dict[str, Any] = {"export": str(out)}
    gravity = _gravity(args.gravity, arm)
    comments = [f"{arm.name}: written by flexarm_env, flexarm export --to {args.to}"]
    if args.to == "urdf":
        chain = chain_of(arm, 0)
        text = urdf(chain, [*comments, "Links are rigid; velocity limits are placeholders"])
    else:
        segments = SEGMENTS if args.segments is None else check.integer("--segments", args.segments, minimum=1)
        chain, factor = calibrated(chain_of(arm, segments, args.placement or "gauss"))
        integrator, step = choose_integrator(chain)
        text = mjcf(chain, gravity=gravity, timestep=step, integrator=integrator, comments=comments)
        values |= {"hinges": len(chain.hinges), "calibration": factor, "integrator": integrator, "timestep_s": step}
    write_text(out, text)
    show(values | differences(chain, gravity), args.json)
    return DONE


def _gravity(text: str | None, arm: Arm) -> tuple[float, float, float]:
    """Read --gravity; the default is that of the environment with such arms, 0 in the plane."""
    if text is None:
        x, y, z = (*(kind_for(arm).gravity or ()), 0.0, 0.0, 0.0)[:3]
        return x, y, z
    try:
        x, y, z = (check.number("--gravity", float(word), "m/s^2") for word in text.split(":"))
    except ValueError:
        raise check.InvalidValue("--gravity", text, "must be X:Y:Z, three numbers (m/s^2)") from None
    return x, y, z


def run(args: argparse.Namespace) -> int:
    """Convert a robot's file to an arm's TOML file, and print links, joints and omitted features."""
    out = to_file("--out", args.out, (".toml",))
    found = import_arm(
        args.file, root=args.root, tip=args.tip, flexible=dict(_flexible(text) for text in args.flexible or ()),
        tau_d=check.number("--tau-d", args.tau_d, "s", minimum=0.0), gear_ratio=args.gear_ratio,
    )  # fmt: skip
    arm = found.arm
    write_text(out, arms.to_toml(arm))
    values: dict[str, Any] = {"import": args.file, "arm": str(out), "links": list(found.links)}
    values |= {"joints": list(found.joints), "mass_kg": arm.mass, "length_m": arm.total_length}
    values |= {"root_m": list(found.root), "tip": found.tip or "center of mass of the last link"}
    values |= {"gravity_m_s2": list(found.gravity), "torque_limits": list(arm.torque_limits or ()) or "none"}
    for name, change in found.flexible.items():
        values |= {f"{name}.{key}": value for key, value in change.items()}
    show(values | {"left_out": list(found.left_out)}, args.json)
    return DONE


def _flexible(text: str) -> tuple[str, Section]:
    """Parse an argument of the form BODY=SECTION."""
    name, mark, table = text.partition("=")
    try:
        given = tomllib.loads(f"section = {table}")["section"] if mark else None
    except tomllib.TOMLDecodeError:
        given = None
    if not isinstance(given, dict) or not name.strip():
        what = "must be BODY={...}, an inline table of TOML with a section's keys"
        raise check.InvalidValue("--flexible", text, what)
    with check.under("--flexible"):
        return name.strip(), arms.section_of(name.strip(), given)
