"""Evaluate policies and controllers: `python -m agents.evaluate` runs `flexarm_env.training.evaluate`."""

import sys

from flexarm_env.training.evaluate import main

if __name__ == "__main__":
    sys.exit(main("python -m agents.evaluate"))
