"""The command `flexarm`. Each subcommand is a module, which is imported only when the subcommand is used."""

from flexarm_env.cli.parser import main

__all__ = ["main"]
