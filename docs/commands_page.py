"""The whole command line, for ``just docs``."""

from cell.commands import command_line

app = command_line()
