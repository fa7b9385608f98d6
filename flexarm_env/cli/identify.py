"""`flexarm excite` and `flexarm identify`: design torques for an experiment, and fit an arm to its log."""

import argparse
import math
from contextlib import closing

from flexarm_env.cli.codes import DONE, FAILED
from flexarm_env.cli.parser import EXCITED
from flexarm_env.cli.progress import ProgressBar, show
from flexarm_env.files import to_file, to_folder
from flexarm_env.identification import excite, identify


def run(args: argparse.Namespace) -> int:
    """Run `flexarm excite` or `flexarm identify`; return the exit code."""
    return _excite(args) if args.command == "excite" else _identify(args)


def _excite(args: argparse.Namespace) -> int:
    """Design torques, write them, and print the simulated motion of the arm."""
    names = [flag.removeprefix("--").replace("-", "_") for flag, *_ in EXCITED]
    to_file("--out", args.out, (".csv",))
    found = excite(args.arm, **{name: getattr(args, name) for name in names})
    found.write(args.out)
    low, high = (x / (2.0 * math.pi) for x in found.band)
    values: dict[str, object] = {"excite": args.out, "periods": len(found.t), "band_hz": [low, high]}
    values |= {"modes_hz": [float(w) / (2.0 * math.pi) for w in found.modes], "angle": found.angle}
    values |= {"torque": [float(x) for x in abs(found.torques).max(axis=0)], "deflection": found.deflection}
    show(values, args.json)
    return DONE


def _identify(args: argparse.Namespace) -> int:
    """Fit an arm to logs, and print and write the result; return 1 unless the fit is good."""
    names = None if args.fit is None else [name.strip() for name in args.fit.split(",") if name.strip()]
    held = [path for path in (args.hold_out or "").split(",") if path]
    data = [path for path in args.data.split(",") if path]
    if args.out is not None:
        to_folder("--out", args.out)
    with closing(ProgressBar("identify")) as bar:
        found = identify(args.arm, args.config, data, fit=names, hold_out=held, out=args.out, progress=bar)
    show(found.lines(), args.json)
    return DONE if found.good else FAILED
