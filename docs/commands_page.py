"""The application ``cell`` for the generated page docs/commands.md (``just docs``)."""

from cell.cli.commands import command_line

app = command_line()
