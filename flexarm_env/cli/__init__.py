"""The command `flexarm`. Each subcommand is a module that is imported only when it is used."""

from flexarm_env.cli.parser import main

__all__ = ["main"]
