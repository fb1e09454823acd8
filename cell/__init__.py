"""The cell: five stages, one cycle, one machine, one command line."""

LOG_FORMAT = "%(levelname)s %(name)s: %(message)s"
