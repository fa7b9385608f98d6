"""Write a trained policy as policy.npz: `python -m agents.export_policy` runs `flexarm_env.training.export_policy`."""

import sys

from flexarm_env.training.export_policy import main

if __name__ == "__main__":
    sys.exit(main())
