"""`flexarm train`, `evaluate` and `tune`: programs of `flexarm_env.training`, which read their flags themselves."""

import argparse
import importlib


def run(args: argparse.Namespace) -> int:
    """Run the program; the exit code is its own."""
    program = importlib.import_module(f"flexarm_env.training.{args.command}")
    code: int = program.main(f"flexarm {args.command}", args.words)
    return code
