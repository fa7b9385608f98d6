"""`flexarm schema`: print the JSON schema of arm files or of scene files."""

import argparse
import json

from flexarm_env import arms
from flexarm_env.cli.codes import DONE
from flexarm_env.scene import Scene


def run(args: argparse.Namespace) -> int:
    """Print the JSON schema of arm files or of scene files; return the exit code."""
    print(json.dumps(Scene.schema() if args.of == "scene" else arms.schema(), indent=2))
    return DONE
