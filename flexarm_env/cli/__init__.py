"""The command `flexarm`. Each subcommand has a module, which is imported only if the subcommand is used."""

from flexarm_env.cli.parser import main

__all__ = ["main"]
