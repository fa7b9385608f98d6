"""`python -m flexarm_env` is the command `flexarm`."""

import sys

from flexarm_env.cli import main

if __name__ == "__main__":
    sys.exit(main())
