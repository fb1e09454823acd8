"""The cell: five stages, one cycle, one machine, one command line."""
