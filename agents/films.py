"""Films of episodes: `python -m agents.films` runs `flexarm_env.training.films`."""

import sys

from flexarm_env.training.films import main

if __name__ == "__main__":
    sys.exit(main())
