"""`flexarm identify`: from logs to an arm."""

from __future__ import annotations

import argparse
from contextlib import closing

from flexarm_env.cli.codes import DONE, FAILED
from flexarm_env.cli.progress import ProgressBar, show
from flexarm_env.identification import identify


def run(args: argparse.Namespace) -> int:
    """Fit, judge, print, write; 1 where the fit is not good."""
    names = None if args.fit is None else [name.strip() for name in args.fit.split(",") if name.strip()]
    held = [path for path in (args.hold_out or "").split(",") if path]
    data = [path for path in args.data.split(",") if path]
    with closing(ProgressBar("identify")) as bar:
        found = identify(args.arm, args.config, data, fit=names, hold_out=held, out=args.out, progress=bar)
    show(found.lines(), args.json)
    return DONE if found.good else FAILED
