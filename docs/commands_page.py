"""The whole command line, for ``just docs``."""

from cell.cli.commands import command_line

app = command_line()
