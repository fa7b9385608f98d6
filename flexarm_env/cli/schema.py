"""`flexarm schema`: JSON schema of arm files."""

import argparse
import json

from flexarm_env import arms
from flexarm_env.cli.codes import DONE


def run(args: argparse.Namespace) -> int:
    """Print the JSON schema of arm files; returns the exit code."""
    print(json.dumps(arms.schema(), indent=2))
    return DONE
