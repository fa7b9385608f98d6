"""Tune the gains of the package's controllers: `python -m agents.tune` runs the program of `flexarm tune`."""

import sys
from pathlib import Path

from flexarm_env.training.tune import main

HOME = Path(__file__).resolve().parents[1] / "flexarm_env" / "data" / "control"

if __name__ == "__main__":
    sys.exit(main("python -m agents.tune", ["--home", str(HOME), *sys.argv[1:]]))
