"""A trained policy as policy.npz: `python -m agents.export_policy`, which is `flexarm_env.training.export_policy`."""

import sys

from flexarm_env.training.export_policy import main

if __name__ == "__main__":
    sys.exit(main())
