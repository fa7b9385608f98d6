"""Train a policy: `python -m agents.train_ppo` runs `flexarm_env.training.train`."""

import sys

from flexarm_env.training.train import main

if __name__ == "__main__":
    sys.exit(main("python -m agents.train_ppo"))
